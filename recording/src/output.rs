//! [`Output`]: the target of a recording; [`Durable`], which makes it survive a power
//! failure; and [`FileGone`], why writing has stopped.

use std::error::Error;
use std::fmt;
use std::io::{self, Write};

/// Target of a recording.
pub(super) trait Output: Write + Send {
    /// Handle that makes the written bytes durable, if the target can.
    fn durable(&self) -> Option<Box<dyn Durable>>;
}

/// File, as the thread that syncs it sees it.
pub(super) trait Durable: Send {
    /// Waits until all written bytes are on the disk.
    fn sync(&self) -> io::Result<()>;

    /// Waits until the file's name is on the disk.
    fn sync_folder(&self) -> io::Result<()>;
}

/// Any writer, such as a pipe.
pub(super) struct Plain<W>(pub(super) W);

impl<W: Write> Write for Plain<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl<W: Write + Send> Output for Plain<W> {
    fn durable(&self) -> Option<Box<dyn Durable>> {
        None
    }
}

/// What another program did to a file, so that it is no longer written to.
#[derive(Debug)]
pub(super) struct FileGone(pub(super) &'static str);

impl FileGone {
    /// Returns what was done, if `error` is about that.
    pub(super) fn reason(error: &io::Error) -> Option<&'static str> {
        error.get_ref()?.downcast_ref().map(|Self(reason)| *reason)
    }
}

impl fmt::Display for FileGone {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the file {} by another program", self.0)
    }
}

impl Error for FileGone {}
