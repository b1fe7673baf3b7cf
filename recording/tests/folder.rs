//! Recordings as folders, as `ros2 bag record` makes them.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use tokio_scip::Rate;
use urg_recording::{Recorder, Recording, RecordingError, cut, recording_files};

use super::sink::{next, observed, sensor, values, window};
use crate::common::random::{Random, seeds};
use crate::file::Folder;

/// Records 40 scans, 4 s, into some files in a folder. Returns the values, and the files' names.
async fn split(folder: &Path) -> (Vec<Vec<u32>>, Vec<PathBuf>) {
    let builder = Recorder::builder().split_duration(Duration::from_secs(1));
    let mut recorder = builder.create(folder.join("run.mcap")).unwrap();
    let (sensor, mut scans) =
        observed(&recorder, sensor(), window(300, 310, 1), Rate::hz(10.0)).await;
    recorder.describe(&sensor, &scans).await.unwrap();
    let delivered = values(&next(&mut recorder, &mut scans, 40).await);
    let files = recorder.finish().await.unwrap().files;
    assert!(files >= 4, "{files}");
    let name = |number| folder.join(format!("run_{number:04}.mcap"));
    (delivered, [folder.join("run.mcap")].into_iter().chain((2..=files).map(name)).collect())
}

fn describe(folder: &Path, files: &[&str]) {
    let list: String = files.iter().map(|file| format!("    - {file}\n")).collect();
    let text =
        format!("rosbag2_bagfile_information:\n  relative_file_paths:\n{list}  version: 5\n");
    fs::write(folder.join("metadata.yaml"), text).unwrap();
}

/// Values of all scans, and whether an end was missing.
fn read(recording: Recording) -> (Vec<Vec<u32>>, bool) {
    let mut scans = recording.scans();
    let values =
        scans.by_ref().map(|scan| scan.unwrap().raw_values().collect::<Vec<_>>()).collect();
    (values, scans.recording().is_truncated())
}

#[tokio::test(start_paused = true)]
async fn a_folder_is_read_file_by_file() {
    let folder = Folder::new("folder");
    let (delivered, names) = split(folder.path()).await;
    let open = || Recording::open(folder.path()).unwrap();
    assert_eq!(read(open()), (delivered.clone(), false));
    let files = || recording_files(folder.path()).unwrap();
    assert_eq!(files(), names);
    // A part is the same one as of the joined files, although their indexes are used.
    for (from, to) in [(0, 500), (900, 1100), (1500, 3200), (3900, 9000)] {
        let range = Duration::from_millis(from)..Duration::from_millis(to);
        let (inputs, mut part) = (files().into_iter().map(|f| fs::File::open(f).unwrap()), vec![]);
        cut(inputs, range.clone(), None, &mut part).unwrap();
        let part = Recording::read(std::io::Cursor::new(part)).unwrap();
        assert_eq!(read(open().range(range)), read(part), "{from}..{to}");
    }
    // What `metadata.yaml` says counts more than names.
    describe(folder.path(), &["run_0003.mcap", "run.mcap"]);
    assert_eq!(files(), [&names[2], &names[0]].map(PathBuf::clone));
    let (listed, _) = read(open());
    assert!(listed.iter().all(|scan| delivered.contains(scan)) && listed.len() < 25);
    // A file without its end is told, although others follow.
    let first = folder.path().join("run.mcap");
    let bytes = fs::read(&first).unwrap();
    fs::write(&first, &bytes[..bytes.len() - 10]).unwrap();
    fs::remove_file(folder.path().join("metadata.yaml")).unwrap();
    assert_eq!(read(open()), (delivered, true));
}

#[test]
fn a_list_of_files_is_read_in_each_form() {
    let folder = Folder::new("list");
    for (name, expected) in [
        ("part/a.mcap", "part/a.mcap"),
        ("'it''s.mcap'", "it's.mcap"),
        ("\"a\\\": \\xFC\\u00fc.mcap\"", "a\": \u{fc}\u{fc}.mcap"),
        ("a long\n      name.mcap", "a long name.mcap"),
        ("\"a:\\\n      \\ b.mcap\"", "a: b.mcap"),
    ] {
        describe(folder.path(), &[name, "b.mcap"]);
        let expected = [expected, "b.mcap"].map(|name| folder.path().join(name));
        assert_eq!(recording_files(folder.path()).unwrap(), expected);
    }
}

#[test]
fn any_description_is_read_or_refused() {
    let folder = Folder::new("any-list");
    describe(folder.path(), &["'a''b.mcap'", "\"c\\xFC\"", "d e\n      f", "[&g *g, {h: i}]"]);
    let path = folder.path().join("metadata.yaml");
    let text = fs::read(&path).unwrap();
    for seed in seeds("URG_LISTS", 300) {
        let (mut random, mut text) = (Random::new(seed), text.clone());
        for _ in 0..1 + random.below(6) {
            let at = random.below(text.len() as u64) as usize;
            let end = (at + random.below(3) as usize).min(text.len());
            let part = *random.pick(b"-:'\"\\[]{}&*!|>%@#?,~\n\t 0\xc3\xff");
            text.splice(at..end, [part; 2]);
        }
        fs::write(&path, text).unwrap();
        drop(recording_files(folder.path()));
    }
}

#[tokio::test(start_paused = true)]
async fn a_file_that_cannot_be_read_is_the_last() {
    let folder = Folder::new("unreadable-file");
    split(folder.path()).await;
    let first = Recording::open(folder.path().join("run.mcap")).unwrap().count();
    let other = folder.path().join("other.mcap");
    describe(folder.path(), &["run.mcap", "other.mcap", "run_0002.mcap"]);
    let last = || {
        let items: Vec<_> = Recording::open(folder.path()).unwrap().take(first + 9).collect();
        assert_eq!(items.len(), first + 1, "{:?}", items.get(first..));
        items.into_iter().next_back().unwrap().unwrap_err()
    };
    assert!(matches!(last(), RecordingError::Open { path, .. } if path == other));
    fs::write(&other, "a text").unwrap();
    assert!(matches!(last(), RecordingError::NotMcap));
    #[cfg(unix)]
    {
        fs::remove_file(&other).unwrap();
        // Opens, but cannot be read.
        fs::create_dir(&other).unwrap();
        assert!(matches!(last(), RecordingError::Read { .. }));
    }
}

/// `ros2 bag play` decompresses file by file, and the description keeps the names of the compressed ones.
#[tokio::test(start_paused = true)]
async fn a_decompressed_file_is_read_in_place_of_the_compressed_one() {
    let folder = Folder::new("decompressed");
    let (delivered, names) = split(folder.path()).await;
    let names = names.iter().map(|path| path.file_name().unwrap().to_str().unwrap());
    let compressed: Vec<String> = names.map(|name| format!("{name}.zstd")).collect();
    for name in &compressed {
        fs::write(folder.path().join(name), "").unwrap();
    }
    let open = || Recording::open(folder.path());
    assert_eq!(read(open().unwrap()), (delivered.clone(), false));
    describe(folder.path(), &compressed.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(read(open().unwrap()), (delivered, false));
    fs::remove_file(folder.path().join("run_0002.mcap")).unwrap();
    let check = |error: RecordingError| {
        let error = error.to_string();
        assert!(error.contains("zstd -d") && error.contains("run_0002.mcap.zstd"), "{error}");
    };
    check(open().unwrap_err());
    fs::remove_file(folder.path().join("metadata.yaml")).unwrap();
    check(open().unwrap_err());
}

#[test]
fn files_without_a_description_are_numbered() {
    let folder = Folder::new("numbered");
    let names = ["bag_0.mcap", "bag_1.mcap", "bag_2.mcap", "bag_10.mcap"];
    names.iter().rev().for_each(|name| fs::write(folder.path().join(name), "").unwrap());
    fs::write(folder.path().join("notes.txt"), "").unwrap();
    fs::create_dir(folder.path().join("bag_3.mcap")).unwrap();
    let expected = names.map(|name| folder.path().join(name));
    assert_eq!(recording_files(folder.path()).unwrap(), expected);
}

#[test]
fn a_bag_in_another_format_is_named() {
    let folder = Folder::new("other-formats");
    let open = |path: &Path| Recording::open(path).unwrap_err().to_string();
    for (name, format, command) in [
        ("a.db3", "a ROS 2 bag in SQLite", "rosbags-convert --src"),
        ("a.db3.zstd", "a ROS 2 bag in SQLite", "rosbags-convert --src"),
        ("a.BAG", "a ROS 1 bag", "rosbags-convert --src"),
        ("a.mcap.zstd", "compressed as a whole", "zstd -d"),
    ] {
        let path: PathBuf = folder.path().join(name);
        assert!(open(&path).contains("cannot open"), "it is not there yet");
        fs::write(&path, "").unwrap();
        // In a folder, with a description and without one.
        for path in [&*path, folder.path()] {
            let error = open(path);
            assert!(error.contains(format) && error.contains(command), "{error}");
            assert!(error.contains(name), "{error}");
        }
        describe(folder.path(), &[name]);
        assert!(open(folder.path()).contains(format));
        fs::remove_file(&path).unwrap();
        fs::remove_file(folder.path().join("metadata.yaml")).unwrap();
    }
    assert!(open(folder.path()).contains("neither a metadata.yaml nor .mcap files"));
    for list in
        [&["../a.mcap"][..], &["/a.mcap"], &["a/../../b.mcap"], &["''"], &["\"a"], &["[a]"], &[]]
    {
        describe(folder.path(), list);
        assert!(open(folder.path()).contains("lists no files in it"), "{list:?}");
    }
}
