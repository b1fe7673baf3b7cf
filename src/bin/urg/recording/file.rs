//! The file of a recording. It is opened at once, so that an error is reported
//! at once, and left unchanged until there is a sensor to record.

use std::error::Error;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use tokio_scip::recording::RecordingError;

use crate::failure::Failure;

/// The treatment of a file that exists.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Existing {
    Refuse,
    Overwrite,
}

/// A file to record into. If it never [begins](Self::begin) and is new, it is
/// removed again.
#[derive(Debug)]
pub(crate) struct RecorderFile {
    path: PathBuf,
    unused: bool,
    contents: Arc<Mutex<Contents>>,
}

#[derive(Debug)]
struct Contents {
    file: File,
    /// Bytes to write once the recording begins; `None` from then on.
    waiting: Option<Vec<u8>>,
}

impl RecorderFile {
    /// Opens a file. For a pipe it waits until somebody reads it; the future may
    /// be dropped meanwhile.
    pub(crate) async fn open(path: &Path, existing: Existing) -> Result<Self, Failure> {
        let here = path.to_owned();
        let opened = tokio::task::spawn_blocking(move || Self::open_now(&here, existing)).await;
        opened.map_err(|error| cannot_write(path, &error))?
    }

    fn open_now(path: &Path, existing: Existing) -> Result<Self, Failure> {
        let mut options = OpenOptions::new();
        let (opened, new) = match options.write(true).create_new(true).open(path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                if existing == Existing::Refuse {
                    return Err(Failure::Failed(format!(
                        "{} exists: use another name, or --force to overwrite it",
                        path.display()
                    )));
                }
                (options.create_new(false).open(path), false)
            }
            opened => (opened, true),
        };
        let file = opened.map_err(|error| cannot_write(path, &error))?;
        let contents = Contents { file, waiting: Some(Vec::new()) };
        Ok(Self { path: path.into(), unused: new, contents: Arc::new(Mutex::new(contents)) })
    }

    /// Returns a writer for a recorder.
    pub(crate) fn writer(&self) -> impl Write + Send + use<> {
        FileWriter(Arc::clone(&self.contents))
    }

    /// Empties the file, and writes what the recorder has written so far.
    pub(crate) fn begin(&mut self) -> Result<(), Failure> {
        self.unused = false;
        self.empty().map_err(|error| cannot_write(&self.path, &error))
    }

    fn empty(&self) -> io::Result<()> {
        let mut contents = lock(&self.contents);
        if contents.file.metadata()?.is_file() {
            contents.file.set_len(0)?;
        }
        let waiting = contents.waiting.take().unwrap_or_default();
        contents.file.write_all(&waiting)
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Describes an error of its recorder.
    pub(crate) fn failure(&self, error: &RecordingError) -> Failure {
        Failure::at(&self.path.display().to_string(), error)
    }

    /// Returns true unless it is a pipe or a device.
    pub(crate) fn is_regular(&self) -> bool {
        lock(&self.contents).file.metadata().is_ok_and(|metadata| metadata.is_file())
    }
}

impl Drop for RecorderFile {
    fn drop(&mut self) {
        if self.unused {
            // An empty file does no harm.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

struct FileWriter(Arc<Mutex<Contents>>);

impl Write for FileWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut contents = lock(&self.0);
        match &mut contents.waiting {
            Some(waiting) => waiting.write(bytes),
            None => contents.file.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn cannot_write(path: &Path, error: &dyn Error) -> Failure {
    Failure::of(&format!("cannot write {}", path.display()), error)
}

fn lock(contents: &Mutex<Contents>) -> std::sync::MutexGuard<'_, Contents> {
    // Nothing panics while it is held.
    contents.lock().unwrap_or_else(PoisonError::into_inner)
}
