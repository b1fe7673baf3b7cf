//! [`Parts`]: when a recording goes on in a further file, and which one that is.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// A file ends at so many entries of its index: fewer than it may have, since it gets
/// further chunks until it can be split.
pub(super) const MAX_PART_ENTRIES: usize = 65_000;

/// The file that is written.
pub(super) type Output = Box<dyn Write + Send>;

/// The limits of a file of a recording.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Limits {
    pub(super) duration: Option<Duration>,
    pub(super) bytes: Option<u64>,
}

/// The files of a recording behind the first one.
pub(super) struct Parts {
    limits: Limits,
    /// The path of the first file. Without one there is only that file.
    path: Option<PathBuf>,
    /// The number of the current file.
    number: u32,
    wrap: Box<dyn Fn(File) -> Output + Send>,
}

impl Parts {
    /// `wrap` makes an output of each further file.
    pub(super) fn new(
        limits: Limits,
        path: Option<PathBuf>,
        wrap: impl Fn(File) -> Output + Send + 'static,
    ) -> Self {
        Self { limits, path, number: 1, wrap: Box::new(wrap) }
    }

    /// Returns true if the current file should have no more messages.
    pub(super) fn is_full(&self, duration: Duration, bytes: u64, index_entries: usize) -> bool {
        self.path.is_some()
            && (index_entries >= MAX_PART_ENTRIES
                || self.limits.duration.is_some_and(|limit| duration >= limit)
                || self.limits.bytes.is_some_and(|limit| bytes >= limit))
    }

    /// Creates the next file: the next number that no file has.
    pub(super) fn next(&mut self) -> io::Result<Output> {
        let Some(path) = &self.path else { return Err(io::ErrorKind::Unsupported.into()) };
        loop {
            self.number += 1;
            let path = part_path(path, self.number);
            match OpenOptions::new().write(true).create_new(true).open(&path) {
                Ok(file) => return Ok((self.wrap)(file)),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => {
                    let text = format!("cannot create {}: {error}", path.display());
                    return Err(io::Error::new(error.kind(), text));
                }
            }
        }
    }
}

/// `run.mcap`, `run_0002.mcap`, `run_0003.mcap`.
fn part_path(path: &Path, number: u32) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(format!("_{number:04}"));
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    path.with_file_name(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_full_at_its_limits_and_a_pipe_never_is() {
        let limits = Limits { duration: Some(Duration::from_secs(9)), bytes: Some(99) };
        let parts = |path| Parts::new(limits, path, |file| Box::new(file));
        let (file, pipe) = (parts(Some("run.mcap".into())), parts(None));
        for (seconds, bytes, entries, is_full) in [
            (8, 98, MAX_PART_ENTRIES - 1, false),
            (9, 0, 0, true),
            (0, 99, 0, true),
            (0, 0, MAX_PART_ENTRIES, true),
        ] {
            let duration = Duration::from_secs(seconds);
            assert_eq!(file.is_full(duration, bytes, entries), is_full);
            assert!(!pipe.is_full(duration, bytes, entries));
        }
    }

    #[test]
    fn parts_are_numbered_before_the_extension() {
        for (path, second) in [
            ("/tmp/run.mcap", "/tmp/run_0002.mcap"),
            ("a.b.mcap", "a.b_0002.mcap"),
            ("run", "run_0002"),
        ] {
            assert_eq!(part_path(Path::new(path), 2), Path::new(second));
        }
    }
}
