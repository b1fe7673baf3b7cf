//! The file of a recording: opened at once, so that what is wrong with it is
//! told at once, and left as it was until there is a sensor to record.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use crate::failure::Failure;

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
    /// What is to be written once it begins.
    waiting: Option<Vec<u8>>,
}

impl RecorderFile {
    /// Opens a new file; `force` makes do with an old one.
    pub(crate) fn open(path: &Path, force: bool) -> Result<Self, Failure> {
        let mut options = OpenOptions::new();
        let (opened, new) = match options.write(true).create_new(true).open(path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                if !force {
                    return Err(Failure::Failed(format!(
                        "{} exists already, and is not written over: use another name, or --force",
                        path.display()
                    )));
                }
                (options.create_new(false).open(path), false)
            }
            opened => (opened, true),
        };
        let file = opened
            .map_err(|error| Failure::of(&format!("cannot write {}", path.display()), &error))?;
        let contents = Contents { file, waiting: Some(Vec::new()) };
        Ok(Self { path: path.into(), unused: new, contents: Arc::new(Mutex::new(contents)) })
    }

    /// Where a recorder writes to.
    pub(crate) fn writer(&self) -> impl Write + Send + use<> {
        Writer(Arc::clone(&self.contents))
    }

    /// Empties the file, and writes what there is.
    pub(crate) fn begin(&mut self) -> io::Result<()> {
        self.unused = false;
        let mut contents = lock(&self.contents);
        if contents.file.metadata()?.is_file() {
            contents.file.set_len(0)?;
        }
        let waiting = contents.waiting.take().unwrap_or_default();
        contents.file.write_all(&waiting)
    }

    /// How many bytes it has.
    pub(crate) fn len(&self) -> u64 {
        lock(&self.contents).file.metadata().map_or(0, |metadata| metadata.len())
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

struct Writer(Arc<Mutex<Contents>>);

impl Write for Writer {
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

fn lock(contents: &Mutex<Contents>) -> std::sync::MutexGuard<'_, Contents> {
    // Nothing panics while it is held.
    contents.lock().unwrap_or_else(PoisonError::into_inner)
}
