//! [`Output`]: the target of a recording; [`Durable`], which makes it survive a power
//! failure; and [`FileGone`], why writing has stopped.

use std::error::Error;
use std::fmt;
use std::io::{self, Write};

/// Target of a recording.
pub(super) struct Output {
    pub(super) writer: Box<dyn Write + Send>,
    /// Makes the written bytes durable, if the target can.
    pub(super) durable: Option<Box<dyn Durable>>,
}

/// File, as the thread that syncs it sees it.
pub(super) trait Durable: Send {
    /// Waits until all written bytes are on the disk.
    fn sync(&self) -> io::Result<()>;

    /// Waits until the file's name is on the disk.
    fn sync_folder(&self) -> io::Result<()>;
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
