//! [`recording_files`]: the files of a recording, which is a folder if `ros2 bag record` made it.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};

use saphyr_parser::{Event, Parser};

use super::RecordingError;

/// Description of a folder's files that `ros2 bag record` writes at its end.
const METADATA_FILE: &str = "metadata.yaml";
/// Longest description to read. A topic takes about a kilobyte.
const MAX_METADATA_BYTES: u64 = 16 << 20;

/// Returns the files of a recording, in order: `path` itself, or if it is a folder, the files that its
/// `metadata.yaml` lists. Without one, as after a kill, the `.mcap` files in the folder follow each other by
/// the number at the end of their names. A file that lies beside its compressed form is read in place of it.
///
/// # Errors
///
/// Fails with [`RecordingError::Open`] if the folder cannot be read, [`RecordingError::Folder`] if it has no
/// recording, and [`RecordingError::OtherFormat`] if a file's name shows that it is a bag in another format.
pub fn recording_files(path: impl AsRef<Path>) -> Result<Vec<PathBuf>, RecordingError> {
    let path = path.as_ref();
    if !path.is_dir() {
        // A file that does not exist is no bag.
        let checked = if path.exists() { check_format(path) } else { Ok(()) };
        return checked.map(|()| vec![path.to_owned()]);
    }
    let no_recording = |reason| Err(RecordingError::Folder { path: path.to_owned(), reason });
    let metadata = path.join(METADATA_FILE);
    let mut text = String::new();
    let opened = File::open(&metadata);
    let read = opened.and_then(|file| file.take(MAX_METADATA_BYTES).read_to_string(&mut text));
    let files = match read {
        Ok(_) => match listed(&text) {
            Some(names) if names.iter().all(|name| is_inside(name)) => {
                let files = names.into_iter().map(|name| path.join(name));
                files.map(|file| decompressed(&file).unwrap_or(file)).collect()
            }
            _ => return no_recording("its metadata.yaml lists no files in it"),
        },
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            numbered(path).map_err(RecordingError::open(path))?
        }
        Err(error) => return Err(RecordingError::open(metadata)(error)),
    };
    if files.is_empty() {
        return no_recording("it has neither a metadata.yaml nor .mcap files");
    }
    files.iter().try_for_each(|file| check_format(file))?;
    Ok(files)
}

/// Refuses names of bags in other formats.
fn check_format(path: &Path) -> Result<(), RecordingError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    let (zstd, plain) = match name.strip_suffix(".zstd").or(name.strip_suffix(".zst")) {
        Some(plain) => (true, plain),
        None => (false, &*name),
    };
    let found = match plain.rsplit_once('.').map(|(_, ending)| ending) {
        Some("db3") => "a ROS 2 bag in SQLite",
        Some("bag") => "a ROS 1 bag",
        Some("mcap") if zstd => "one compressed as a whole",
        _ => return Ok(()),
    };
    Err(RecordingError::OtherFormat { path: path.to_owned(), found })
}

/// Returns the file beside a compressed one that has its content. `ros2 bag` makes one to read it, and
/// leaves it there.
fn decompressed(path: &Path) -> Option<PathBuf> {
    let is_compressed = path.extension()?.to_string_lossy().to_lowercase().starts_with("zst");
    Some(path.with_extension("")).filter(|plain| is_compressed && plain.is_file())
}

/// Returns true for the name of a file in the folder, and not of one elsewhere.
fn is_inside(name: &str) -> bool {
    let mut parts = Path::new(name).components();
    !name.is_empty() && parts.all(|part| matches!(part, Component::Normal(_)))
}

/// Recordings in a folder. Both `bag_10.mcap` and `run_0010.mcap` come after their ninth file.
fn numbered(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let ending = path.extension().unwrap_or_default();
        let is_bag = ending.eq_ignore_ascii_case("mcap") || check_format(&path).is_err();
        if is_bag && path.is_file() && decompressed(&path).is_none() {
            let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let before = stem.trim_end_matches(|c: char| c.is_ascii_digit());
            let number = stem.get(before.len()..).and_then(|digits| digits.parse::<u64>().ok());
            files.push((before.trim_end_matches('_').to_owned(), number, path));
        }
    }
    files.sort();
    Ok(files.into_iter().map(|(_, _, path)| path).collect())
}

/// Reads the list of files in a `metadata.yaml`.
fn listed(text: &str) -> Option<Vec<String>> {
    let mut events = Parser::new_from_str(text).map_while(|event| Some(event.ok()?.0));
    events.find(|event| matches!(event, Event::Scalar(key, ..) if key == "relative_file_paths"))?;
    events.next().filter(|event| matches!(event, Event::SequenceStart(..)))?;
    let mut names = Vec::new();
    loop {
        match events.next()? {
            Event::Scalar(name, ..) => names.push(name.into_owned()),
            Event::SequenceEnd => return Some(names).filter(|names| !names.is_empty()),
            _ => return None,
        }
    }
}
