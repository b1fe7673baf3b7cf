//! [`recording_files`]: the files of a recording, which is a folder if `ros2 bag record` made it.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};

use super::RecordingError;

/// Description of a folder's files that `ros2 bag record` writes at its end.
const METADATA_FILE: &str = "metadata.yaml";
/// Longest description to read. A topic takes about a kilobyte.
const MAX_METADATA_BYTES: u64 = 16 << 20;

/// Returns the files of a recording, in order: `path` itself, or if it is a folder, the files that
/// its `metadata.yaml` lists. Without one, as after a kill, the `.mcap` files in the folder follow each
/// other by the number at the end of their names.
///
/// # Errors
///
/// Fails with [`RecordingError::Open`] if the folder cannot be read, [`RecordingError::Folder`] if it
/// has no recording, and [`RecordingError::OtherFormat`] if a file's name shows that it is a bag in
/// another format.
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
                names.into_iter().map(|name| path.join(name)).collect()
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
        if is_bag && path.is_file() {
            let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let before = stem.trim_end_matches(|c: char| c.is_ascii_digit());
            let number = stem.get(before.len()..).and_then(|digits| digits.parse::<u64>().ok());
            files.push((before.trim_end_matches('_').to_owned(), number, path));
        }
    }
    files.sort();
    Ok(files.into_iter().map(|(_, _, path)| path).collect())
}

/// Parses the list of files in a `metadata.yaml`, as rosbag2 and rosbags write it: one name a line, in
/// quotes if it has special characters, and continued on the next line if it is long. Returns `None`
/// for other YAML.
fn listed(text: &str) -> Option<Vec<String>> {
    let indent = |line: &str| line.len() - line.trim_start().len();
    let mut lines = text.lines().skip_while(|line| line.trim() != "relative_file_paths:").skip(1);
    let mut items: Vec<String> = Vec::new();
    let first = lines.next().filter(|line| line.trim_start().starts_with("- "))?;
    let depth = indent(first);
    for line in std::iter::once(first).chain(lines) {
        match line.trim_start().strip_prefix("- ") {
            Some(item) if indent(line) == depth => items.push(item.trim().to_owned()),
            _ if indent(line) > depth => {
                let item = items.last_mut()?;
                // In double quotes, a backslash before the break keeps the words together.
                if item.starts_with('"') && item.ends_with('\\') {
                    item.pop();
                } else {
                    item.push(' ');
                }
                item.push_str(line.trim());
            }
            _ => break,
        }
    }
    items.iter().map(|item| scalar(item)).collect()
}

/// Parses a text of YAML on one line.
fn scalar(text: &str) -> Option<String> {
    if let Some(quoted) = text.strip_prefix('\'') {
        return Some(quoted.strip_suffix('\'')?.replace("''", "'"));
    }
    let Some(quoted) = text.strip_prefix('"') else { return Some(text.to_owned()) };
    let (mut out, mut letters) = (String::new(), quoted.strip_suffix('"')?.chars());
    while let Some(letter) = letters.next() {
        out.push(match letter {
            '\\' => {
                let digits = match letters.next()? {
                    'x' => 2,
                    'u' => 4,
                    'U' => 8,
                    mark @ ('"' | '\\' | '/' | ' ') => {
                        out.push(mark);
                        continue;
                    }
                    _ => return None,
                };
                let code: String = letters.by_ref().take(digits).collect();
                char::from_u32(u32::from_str_radix(&code, 16).ok()?)?
            }
            letter => letter,
        });
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_of_files_is_read_in_each_form() {
        for (list, names) in [
            ("    - bag_0.mcap\n    - bag_1.mcap\n", Some(vec!["bag_0.mcap", "bag_1.mcap"])),
            ("  - bag_0.mcap\n", Some(vec!["bag_0.mcap"])),
            ("  - 'it''s.mcap'\n", Some(vec!["it's.mcap"])),
            ("  - \"a\\\": \\xFC\\\\\\u00fc.mcap\"\n", Some(vec!["a\": ü\\ü.mcap"])),
            ("  - a long\n    name.mcap\n  - b\n", Some(vec!["a long name.mcap", "b"])),
            ("  - \"a:\\\n    \\ b.mcap\"\n", Some(vec!["a: b.mcap"])),
            ("    - [a]\n", Some(vec!["[a]"])),
            ("", None),
            ("  - \"open\n", None),
            ("  - \"\\q\"\n", None),
            ("  - \"\\ud800\"\n", None),
        ] {
            let text = format!(
                "rosbag2_bagfile_information:\n  files:\n  - path: x.mcap\n  relative_file_paths:\n\
                 {list}  duration:\n    nanoseconds: 1\n"
            );
            let names = names.map(|names| names.into_iter().map(str::to_owned).collect());
            assert_eq!(listed(&text), names, "{list}");
        }
        for text in ["", "relative_file_paths: []\n", "relative_file_paths:\n", "- a.mcap\n"] {
            assert_eq!(listed(text), None, "{text}");
        }
    }

    #[test]
    fn a_listed_file_lies_in_the_folder() {
        for name in ["a.mcap", "part/a.mcap"] {
            assert!(is_inside(name), "{name}");
        }
        for name in ["", "..", "/etc/a.mcap", "../a.mcap", "a/../../b.mcap"] {
            assert!(!is_inside(name), "{name}");
        }
    }
}
