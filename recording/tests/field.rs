//! What other programs do to the file of a recorder, and recorders to each other.

use std::fs::{self, File};
use std::path::PathBuf;
use std::time::Duration;

use tokio_scip::{Rate, Sensor, Window};
use urg_emulator::Emulator;
use urg_recording::{Entry, Recorder, Recording, RecordingError, RecordingFile, cut};

use super::file::Folder;
use super::sink::{Sink, next, observed, record, sensor};

fn path(folder: &Folder) -> PathBuf {
    folder.write(b"")
}

#[test]
fn two_recorders_never_write_one_file() {
    let folder = Folder::new("two-recorders");
    let path = path(&folder);
    // An empty file is what is left of a recording that was killed before it began.
    let first = Recorder::create(&path).unwrap();
    for overwrite in [false, true] {
        let error = Recorder::builder().overwrite(overwrite).create(&path).unwrap_err();
        let is_right = match error {
            RecordingError::Busy { .. } => overwrite,
            RecordingError::Exists { .. } => !overwrite,
            _ => false,
        };
        assert!(is_right);
    }
    drop(first);
}

#[test]
fn a_file_stays_as_it_is_until_its_recording_begins() {
    let folder = Folder::new("begins");
    let path = folder.write(b"precious");
    assert!(matches!(RecordingFile::open(&path, false), Err(RecordingError::Exists { .. })));
    let file = RecordingFile::open(&path, true).unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"precious");
    let recorder = Recorder::builder().record_into(file).unwrap();
    assert!(fs::read(&path).unwrap().starts_with(b"\x89MCAP0\r\n"));
    drop(recorder);
    // A new one that never began is removed.
    fs::remove_file(&path).unwrap();
    drop(RecordingFile::open(&path, false).unwrap());
    assert!(!path.exists());
}

/// In real time, because a chunk is written after a second.
#[tokio::test]
async fn a_file_that_vanishes_ends_the_recording() {
    let sensor = Sensor::builder().connect(sensor()).await.unwrap();
    let item = sensor.scan(Window::DETECTION).await;
    for reason in ["was removed", "was cut short or written to"] {
        if cfg!(not(unix)) && reason == "was removed" {
            continue;
        }
        let folder = Folder::new("gone");
        let path = path(&folder);
        let mut recorder = Recorder::create(&path).unwrap();
        recorder.record(&item).unwrap();
        match reason {
            "was removed" => fs::remove_file(&path).unwrap(),
            _ => File::options().write(true).open(&path).unwrap().set_len(10).unwrap(),
        }
        match recorder.finish().await.unwrap_err() {
            RecordingError::Gone { reason: found } => assert_eq!(found, reason),
            other => panic!("{other:?}"),
        }
    }
}

/// What a thread of its own syncs is counted, and the end waits for it.
#[tokio::test]
async fn a_recording_is_synced_to_a_real_disk() {
    let folder = Folder::new("synced");
    for interval in [None, Some(Duration::ZERO), Some(Duration::from_secs(1))] {
        let path = path(&folder);
        let mut recorder = Recorder::builder().sync_interval(interval).create(&path).unwrap();
        let sensor = Sensor::builder().connect(Emulator::default()).await.unwrap();
        recorder.record(&sensor.scan(Window::DETECTION).await).unwrap();
        let progress = recorder.finish().await.unwrap();
        assert!(interval.is_some_and(|interval| interval.is_zero()) || progress.late_syncs == 0);
        assert_eq!(Recording::open(&path).unwrap().count(), 1);
    }
}

/// As other readers see it, which order messages by their log time.
fn times(file: &[u8]) -> Vec<(String, u32, u64, u64)> {
    let messages = mcap::MessageStream::new(file).unwrap().map(Result::unwrap);
    let time = |message: mcap::Message<'_>| {
        (message.channel.topic.clone(), message.sequence, message.log_time, message.publish_time)
    };
    messages.map(time).collect()
}

#[tokio::test(start_paused = true)]
async fn a_part_keeps_its_times() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 100).await;
    let whole = times(&sink.bytes());
    let mut part = Vec::new();
    let range = Duration::from_secs(3)..Duration::from_secs(6);
    let outcome =
        cut([std::io::Cursor::new(sink.bytes())], range.clone(), None, &mut part).unwrap();
    assert_eq!((outcome.damaged_parts, outcome.was_truncated), (0, false));
    let copied = times(&part);
    assert_eq!(outcome.messages as usize, copied.len());
    // The sensor's version differs: it has the time of the beginning.
    assert!(copied[1..].iter().all(|message| whole.contains(message)));
    assert_eq!((&copied[0].0, copied[0].2), (&"/scip/replies".to_owned(), copied[1].2));
    let span = copied.last().unwrap().2 - copied[0].2;
    assert!((2_800_000_000..3_000_000_000).contains(&span), "{span} ns");
    // The file has the same scans as the part.
    let open = |file: &[u8]| Recording::read(std::io::Cursor::new(file.to_vec())).unwrap();
    let scans = |recording: Recording| -> Vec<_> {
        let scans = recording.scans().map(Result::unwrap);
        scans.map(|scan| (scan.raw_values().collect::<Vec<_>>(), scan.times().stamp)).collect()
    };
    assert_eq!(scans(open(&part)), scans(sink.open().range(range)));
    assert_eq!(open(&part).metadata(), sink.open().metadata());
    let summary = mcap::Summary::read(&part).unwrap().unwrap();
    assert!(summary.chunk_indexes.len() >= 3);
}

#[tokio::test(start_paused = true)]
async fn joined_files_equal_the_unsplit_recording() {
    let folder = Folder::new("join");
    let path = path(&folder);
    let builder = Recorder::builder().split_duration(Duration::from_secs(2));
    let mut recorder = builder.create(&path).unwrap();
    let (sensor, mut scans) =
        observed(&recorder, sensor(), Window::DETECTION, Rate::hz(10.0)).await;
    recorder.describe(&sensor, &scans).await.unwrap();
    next(&mut recorder, &mut scans, 60).await;
    recorder.finish().await.unwrap();
    let files = [path.clone()].into_iter().chain((2..).map(|number| {
        let name = path.file_stem().unwrap().to_str().unwrap();
        path.with_file_name(format!("{name}_{number:04}.mcap"))
    }));
    let files: Vec<File> = files.map_while(|path| File::open(path).ok()).collect();
    assert!(files.len() >= 3);
    let mut joined = Vec::new();
    let outcome = cut(files, .., None, &mut joined).unwrap();
    assert_eq!(outcome.scans, 60);
    let summary = mcap::Summary::read(&joined).unwrap().unwrap();
    assert_eq!(summary.metadata_indexes.len(), 1, "each file has it");
    let records: Vec<_> =
        Recording::read(std::io::Cursor::new(joined)).unwrap().map(Result::unwrap).collect();
    let numbers = records.iter().filter(|record| matches!(record.entry, Entry::Scan(_)));
    assert!(numbers.map(|record| record.sequence).eq(0..60));
    let replies = records.iter().filter(|record| matches!(record.entry, Entry::Reply(_)));
    let replies: Vec<u32> = replies.map(|record| record.sequence).collect();
    assert!(replies.is_sorted_by(|a, b| a < b), "{replies:?}");
}
