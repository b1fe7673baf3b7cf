//! What can go wrong with a recording.

use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use mcap::McapError;

/// What went wrong with a recording. As all errors of this crate: `Display`
/// tells its own layer, the cause is in
/// [`source`](std::error::Error::source), and clones are cheap.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The file exists, and was not to be written over.
    #[error("{} exists already, and is not written over: use another name", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The file cannot be created or opened.
    #[error("cannot open {}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// Why.
        source: Arc<io::Error>,
    },
    /// Nothing more can be written; what was written before can be read.
    #[error("the recording has ended: writing failed; what was recorded before can be read")]
    Write {
        /// Why.
        source: Arc<io::Error>,
    },
    /// The file cannot be read any further.
    #[error("reading the recording failed")]
    Read {
        /// Why.
        source: Arc<io::Error>,
    },
    /// It is not an MCAP file.
    #[error("this is no MCAP file: only recordings can be replayed")]
    NotMcap,
    /// It is an MCAP file, and from here on it is not as it should be. That its
    /// end is missing is no error.
    #[error("the recording is damaged: {reason}")]
    Damaged {
        /// What is wrong.
        reason: String,
    },
    /// There are no replies of a sensor in it.
    #[error(
        "there are no replies of a sensor in this recording: only what `urg record` or a Recorder with a tap has written can be replayed"
    )]
    NoReplies,
}

impl RecordingError {
    pub(super) fn write(error: McapError) -> Self {
        let source = match error {
            McapError::Io(error) => error,
            other => io::Error::other(other),
        };
        Self::Write { source: Arc::new(source) }
    }

    pub(super) fn read(error: McapError) -> Self {
        Self::Damaged { reason: error.to_string() }
    }
}
