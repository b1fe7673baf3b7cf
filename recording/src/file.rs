//! [`RecordingFile`]: a file to record into. One recorder owns and locks it, and notices changes by
//! other programs before the next write.

use std::fs::{File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::RecordingError;
use super::error::FileGone;
use super::sync::Syncer;

/// File to record into, for [`RecorderBuilder::record_into`](super::RecorderBuilder::record_into).
///
/// Opens and locks the file at once, so that you get an error at once. Keeps its content until you
/// record into it. Dropping the value removes a file that it created.
#[derive(Debug)]
pub struct RecordingFile {
    path: PathBuf,
    /// True until it is recorded into, if it is new.
    is_unused: bool,
    /// Path of the recording's first file.
    first: PathBuf,
    file: File,
    /// True unless it is a pipe or a device.
    is_regular: bool,
}

impl RecordingFile {
    /// Opens a file. Opens an existing, non-empty file only with `overwrite`.
    ///
    /// If the file is a pipe, blocks the thread until a reader opens it.
    ///
    /// # Errors
    ///
    /// Fails with [`RecordingError::Exists`] if there is such a file, [`RecordingError::Busy`] if
    /// another recorder writes it, and [`RecordingError::Open`] if it cannot be opened.
    pub fn open(path: impl Into<PathBuf>, overwrite: bool) -> Result<Self, RecordingError> {
        let path = path.into();
        Self::open_part(path.clone(), path, overwrite)
    }

    /// Opens a further file of a recording.
    pub(super) fn open_part(
        first: PathBuf,
        path: PathBuf,
        overwrite: bool,
    ) -> Result<Self, RecordingError> {
        let mut opened = options().create_new(true).open(&path);
        let exists = |error: &io::Error| error.kind() == io::ErrorKind::AlreadyExists;
        let is_unused = !opened.as_ref().is_err_and(exists);
        if !is_unused {
            // Find out before opening a pipe, which would wait for a reader.
            let is_empty = path.metadata().is_ok_and(|file| file.is_file() && file.len() == 0);
            if !overwrite && !is_empty {
                return Err(RecordingError::Exists { path });
            }
            opened = options().open(&path);
        }
        let opened = opened.and_then(|file| Ok((file.metadata()?.is_file(), file)));
        match opened {
            Ok((is_regular, file)) if !is_regular || lock(&file) => {
                Ok(Self { path, is_unused, first, file, is_regular })
            }
            Err(error) if !is_locked_elsewhere(&error) => Err(RecordingError::open(path)(error)),
            _ => Err(RecordingError::Busy { path }),
        }
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Path of the recording's first file, or `None` for a pipe or a device, which no further files can follow.
    pub(super) fn first(&self) -> Option<&Path> {
        Some(&*self.first).filter(|_| self.is_regular)
    }

    /// Returns true if a recorder writes this file.
    pub(super) fn is_busy(path: &Path) -> bool {
        match options().open(path) {
            Ok(file) => !lock(&file),
            Err(error) => is_locked_elsewhere(&error),
        }
    }

    /// Empties the file, and has it synced from now on.
    pub(super) fn begin(mut self, syncer: Option<Syncer>) -> io::Result<Box<dyn Write + Send>> {
        self.is_unused = false;
        let file = self.file.try_clone()?;
        if !self.is_regular {
            return Ok(Box::new(file));
        }
        file.set_len(0)?;
        if let Some(syncer) = &syncer {
            let (mut is_new, path, file) = (true, self.path.clone(), file.try_clone()?);
            syncer.begin(Box::new(move || {
                if std::mem::take(&mut is_new) {
                    sync_folder(&path);
                }
                file.sync_data()
            }));
        }
        Ok(Box::new(FileWriter { file, length: 0, syncer }))
    }
}

impl Drop for RecordingFile {
    fn drop(&mut self) {
        if self.is_unused {
            // An empty file does no harm: the next recording uses it.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Fails if the file was removed, or its length is not the written one: further bytes would be
/// lost, or follow a hole.
fn check(file: &File, length: u64) -> io::Result<()> {
    let metadata = file.metadata()?;
    #[cfg(unix)]
    if std::os::unix::fs::MetadataExt::nlink(&metadata) == 0 {
        return Err(io::Error::other(FileGone("was removed")));
    }
    if metadata.len() != length {
        return Err(io::Error::other(FileGone("was cut short or written to")));
    }
    Ok(())
}

/// Writes a regular [`RecordingFile`]. Bytes that it has no room for because it may not grow (EFBIG) are
/// not written in part.
struct FileWriter {
    file: File,
    /// Length of the file if no other program writes to it.
    length: u64,
    /// `None` if it is not synced.
    syncer: Option<Syncer>,
}

impl Write for FileWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        check(&self.file, self.length)?;
        match self.file.write_all(bytes) {
            // Until here: the rest of `bytes` continues in a further file.
            Err(error) if error.kind() == io::ErrorKind::FileTooLarge => {
                self.file.set_len(self.length)?;
                self.file.seek(SeekFrom::Start(self.length))?;
                return Err(error);
            }
            written => written?,
        }
        self.length += bytes.len() as u64;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.syncer.as_ref().map_or(Ok(()), Syncer::written)
    }
}

/// Unlocks the file, although the thread that syncs it may still have it open: from now on it is an
/// old part, which may be removed.
#[cfg(unix)]
impl Drop for FileWriter {
    fn drop(&mut self) {
        // Fails only on a file system without locks.
        let _ = rustix::fs::flock(&self.file, rustix::fs::FlockOperation::Unlock);
    }
}

/// Without this, the file has no name after a power failure.
fn sync_folder(path: &Path) {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let open = || File::open(folder.unwrap_or(Path::new(".")));
    if cfg!(unix)
        && let Err(error) = open().and_then(|folder| folder.sync_all())
    {
        // Some file systems cannot sync a folder. If anything else is wrong, the file shows it.
        tracing::debug!(%error, "the folder of the recording cannot be synced");
    }
}

fn options() -> OpenOptions {
    let mut options = OpenOptions::new();
    options.write(true);
    // Others may read; there is no other lock on Windows.
    #[cfg(windows)]
    std::os::windows::fs::OpenOptionsExt::share_mode(&mut options, 1);
    options
}

#[cfg(unix)]
fn lock(file: &File) -> bool {
    use rustix::fs::{FlockOperation, flock};
    // Record even on a file system without locks.
    flock(file, FlockOperation::NonBlockingLockExclusive) != Err(rustix::io::Errno::WOULDBLOCK)
}

#[cfg(not(unix))]
fn lock(_: &File) -> bool {
    true
}

/// ERROR_SHARING_VIOLATION.
fn is_locked_elsewhere(error: &io::Error) -> bool {
    cfg!(windows) && error.raw_os_error() == Some(32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_finished_file_is_free_during_its_sync() {
        let path = std::env::temp_dir().join(format!("scip-lock-{}.mcap", std::process::id()));
        let syncer = Syncer::start(std::time::Duration::MAX).unwrap();
        let file = RecordingFile::open(&path, true).unwrap();
        let writer = file.begin(Some(syncer.clone())).unwrap();
        assert!(RecordingFile::is_busy(&path));
        drop(writer);
        assert!(!RecordingFile::is_busy(&path));
        syncer.finish().unwrap();
        std::fs::remove_file(&path).unwrap();
    }
}
