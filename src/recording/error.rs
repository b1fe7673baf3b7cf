//! [`RecordingError`].

use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use mcap::McapError;

/// An error of recording, reading or replaying. As in all errors of this crate,
/// `Display` covers its own layer, [`source`](std::error::Error::source) returns
/// the cause, and clones are cheap.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The file exists, and overwriting was not asked for.
    #[error("{} exists already and is not overwritten: choose another name", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The file cannot be created or opened.
    #[error("cannot open {}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: Arc<io::Error>,
    },
    /// Writing failed, and the recording has ended. What was written before can
    /// be read.
    #[error("writing the recording failed: it has ended, and what was written before can be read")]
    Write {
        /// The system's error.
        source: Arc<io::Error>,
    },
    /// Reading failed, and the rest of the file was not read.
    #[error("reading the recording failed")]
    Read {
        /// The system's error.
        source: Arc<io::Error>,
    },
    /// The file is not MCAP.
    #[error("not a recording: expected an MCAP file, found other bytes at its start")]
    NotMcap,
    /// The file is MCAP and malformed from here on. A missing end is no error.
    #[error("the recording is damaged: {reason}")]
    Damaged {
        /// The failed check.
        reason: String,
    },
    /// The file has no replies of a sensor.
    #[error(
        "no replies of a sensor in this recording: only a file of `urg record`, or of a Recorder with its observer set, can be replayed"
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
