//! [`Parts`]: when a recording continues in a further file, the name of that file, and
//! which old files are removed for it.

use std::fs::{self, Metadata};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime};

use super::file::RecordingFile;
use super::progress::Progress;
use super::sync::Syncer;
use super::{RecordingError, lock};

/// With this many index entries, a file is split at the next opportunity. Less than the maximum,
/// because the file grows until then.
const MAX_PART_ENTRIES: usize = 65_000;
/// Longest file without another limit: FAT, on most USB sticks, has room for 4 GiB and the index needs some of it.
const MAX_PART_BYTES: u64 = 4_000_000_000;
/// A larger number is not one of ours. There is room for further ones after it.
const MAX_PART_NUMBER: u32 = 999_999_999;
/// A file time before 2020 comes from a clock that was not set yet, and tells nothing about the file's age.
const CLOCK_IS_SET: Duration = Duration::from_secs(50 * 365 * 86_400);

/// Limits of a file of a recording.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Limits {
    pub(super) duration: Option<Duration>,
    pub(super) bytes: Option<u64>,
    /// Limits of all files together: the oldest ones are removed.
    pub(super) keep_duration: Option<Duration>,
    pub(super) keep_bytes: Option<u64>,
}

impl Limits {
    pub(super) fn removes_old(&self) -> bool {
        self.keep_duration.is_some() || self.keep_bytes.is_some()
    }
}

/// Files of a recording after the first one.
pub(super) struct Parts {
    limits: Limits,
    /// Path of the first file. Without it there are no further files.
    path: Option<PathBuf>,
    /// Number of the current file.
    number: u32,
    /// Finished files, oldest first. Empty unless old files are removed.
    old: Vec<(PathBuf, Metadata)>,
    progress: Arc<Mutex<Progress>>,
    syncer: Option<Syncer>,
}

impl Parts {
    /// Starts with an empty file. `path` is the recording's first file. `syncer` syncs each further one.
    pub(super) fn new(
        limits: Limits,
        path: Option<PathBuf>,
        progress: Arc<Mutex<Progress>>,
        syncer: Option<Syncer>,
    ) -> Self {
        let last = path.as_ref().and_then(|path| begun_parts(path).pop());
        let number = last.map_or(1, |(number, _)| number);
        let mut parts = Self { limits, path, number, old: Vec::new(), progress, syncer };
        parts.find_old();
        parts
    }

    /// Returns true if no more messages should be added to the current file.
    pub(super) fn is_full(&self, duration: Duration, bytes: u64, index_entries: usize) -> bool {
        self.path.is_some()
            && (index_entries >= MAX_PART_ENTRIES
                || self.limits.duration.is_some_and(|limit| duration >= limit)
                || bytes >= self.limits.bytes.unwrap_or(MAX_PART_BYTES))
    }

    /// Returns true if `error` ends only the current file, which may not grow: by its file system, or
    /// by a limit of the process (`ulimit -f`).
    pub(super) fn continues_after(&self, error: &io::Error) -> bool {
        self.path.is_some() && error.kind() == io::ErrorKind::FileTooLarge
    }

    /// Limits later files after one could not grow beyond `length`. They stay smaller, so that their
    /// index fits, too.
    pub(super) fn stay_below(&mut self, length: u64) {
        lock(&self.progress).has_outgrown_file = true;
        let limit = length - length / 16;
        self.limits.bytes = Some(self.limits.bytes.map_or(limit, |bytes| bytes.min(limit)));
    }

    /// Creates the next file, with the next unused number.
    pub(super) fn next(&mut self) -> io::Result<Counted> {
        let Some(path) = self.path.clone() else { return Err(io::ErrorKind::Unsupported.into()) };
        loop {
            self.number += 1;
            let out = match RecordingFile::open(part_path(&path, self.number), false) {
                Err(RecordingError::Exists { .. } | RecordingError::Busy { .. }) => continue,
                Err(RecordingError::Open { path, source }) => {
                    let kind = source.kind();
                    return Err(io::Error::new(kind, RecordingError::Open { path, source }));
                }
                opened => opened.map_err(io::Error::other)?.begin(self.syncer.clone())?,
            };
            self.find_old();
            lock(&self.progress).files += 1;
            return Ok(self.count(out));
        }
    }

    /// Counts the bytes written into a file of the recording.
    pub(super) fn count(&self, out: Box<dyn Write + Send>) -> Counted {
        Counted { out, progress: Arc::clone(&self.progress) }
    }

    /// Looks for finished files of the recording, if old ones are removed. The current one is still empty.
    fn find_old(&mut self) {
        self.old.clear();
        let Some(path) = self.path.as_ref().filter(|_| self.limits.removes_old()) else { return };
        let old = |(_, path): (u32, PathBuf)| path.metadata().ok().map(|metadata| (path, metadata));
        self.old = begun_parts(path).into_iter().filter_map(old).collect();
    }

    /// Removes the files that are too old, and then the oldest ones until the rest and the current
    /// file, with its length, are within the limits. Never removes the current file.
    pub(super) fn remove_old(&mut self, current: u64) {
        let Limits { keep_duration, keep_bytes, .. } = self.limits;
        let now = SystemTime::now();
        let is_too_old = |metadata: &Metadata| {
            let changed = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
            let age = now.duration_since(changed).unwrap_or_default();
            let is_set = changed > SystemTime::UNIX_EPOCH + CLOCK_IS_SET;
            is_set && keep_duration.is_some_and(|keep| age > keep)
        };
        let mut unwanted: Vec<_> = self.old.extract_if(.., |(_, file)| is_too_old(file)).collect();
        let sum = |sum: u64, (_, file): &(_, Metadata)| sum.saturating_add(file.len());
        let mut total = self.old.iter().fold(current, sum);
        let is_too_much = |(_, file): &mut (_, Metadata)| {
            let is_too_much = keep_bytes.is_some_and(|keep| total > keep);
            total -= if is_too_much { file.len() } else { 0 };
            is_too_much
        };
        unwanted.extend(self.old.extract_if(.., is_too_much));
        // Another recorder under the same name may write one.
        unwanted.retain(|(path, _)| !RecordingFile::is_busy(path));
        for (path, _) in unwanted {
            let removed = fs::remove_file(&path);
            let path = path.display();
            match removed {
                Ok(()) => tracing::info!(%path, "old recording removed"),
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Err(error) => {
                    tracing::warn!(%path, %error, "an old recording cannot be removed");
                    lock(&self.progress).cannot_remove = true;
                }
            }
        }
    }
}

pub(super) struct Counted {
    out: Box<dyn Write + Send>,
    progress: Arc<Mutex<Progress>>,
}

impl Write for Counted {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        lock(&self.progress).bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

/// Path of the next file of a recording, after all existing ones, or `path` if there are none. Fails
/// if another recorder writes the last one: the files of both would alternate.
pub(super) fn next_path(path: &Path) -> Result<PathBuf, RecordingError> {
    match begun_parts(path).pop() {
        None => Ok(path.to_owned()),
        Some((_, last)) if RecordingFile::is_busy(&last) => {
            Err(RecordingError::Busy { path: last })
        }
        Some((number, _)) => Ok(part_path(path, number + 1)),
    }
}

pub(super) fn further_part(path: &Path) -> Option<PathBuf> {
    begun_parts(path).into_iter().find(|(number, _)| *number > 1).map(|(_, path)| path)
}

/// Files of a recording, with their numbers, in their order. The first file has number 1. An empty
/// file does not count, because it never began.
fn begun_parts(path: &Path) -> Vec<(u32, PathBuf)> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let entries = fs::read_dir(folder.unwrap_or(Path::new("."))).into_iter().flatten().flatten();
    let number = |name: &Path| {
        // The rest of the name need not be UTF-8.
        let digits = name.file_stem()?.as_encoded_bytes().rsplit(|byte| *byte == b'_').next()?;
        let number = std::str::from_utf8(digits).ok()?.parse().ok()?;
        let is_part = (2..=MAX_PART_NUMBER).contains(&number);
        (is_part && part_path(path, number).file_name()? == name).then_some(number)
    };
    let further = entries.filter_map(|entry| number(Path::new(&entry.file_name())));
    let further = further.map(|number| (number, part_path(path, number)));
    let is_begun = |path: &Path| path.metadata().is_ok_and(|file| file.is_file() && file.len() > 0);
    let all = [(1, path.to_owned())].into_iter().chain(further);
    let mut parts: Vec<_> = all.filter(|(_, path)| is_begun(path)).collect();
    parts.sort_unstable();
    parts
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
    fn a_file_fits_on_fat_unless_a_longer_one_is_asked_for() {
        let (path, second) = (Path::new("run.mcap"), Duration::from_secs(1));
        let parts = |bytes| {
            let limits = Limits { bytes, ..Limits::default() };
            Parts::new(limits, Some(path.to_owned()), Arc::default(), None)
        };
        assert!(!parts(None).is_full(second, MAX_PART_BYTES - 1, 1));
        assert!(parts(None).is_full(second, MAX_PART_BYTES, 1));
        let mut longer = parts(Some(2 * MAX_PART_BYTES));
        assert!(!longer.is_full(second, MAX_PART_BYTES, 1));
        // FAT had no room for more.
        longer.stay_below(u64::from(u32::MAX) - 1000);
        assert!(longer.is_full(second, u64::from(u32::MAX) / 16 * 15, 1));
        assert!(!longer.is_full(second, MAX_PART_BYTES, 1));
    }
}
