//! [`RecordingError`].

use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use super::mcap::FileError;

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
    /// The file's chunks are compressed, by another program: recordings of this
    /// crate are not.
    #[error(
        "cannot read a recording with `{compression}` compression: expected none, as `mcap compress --compression none` writes it"
    )]
    Compressed {
        /// The name of the compression.
        compression: String,
    },
    /// A part of the file is malformed: a chunk, about a second of a recording.
    /// Reading goes on behind it. A missing end of the file is no error.
    #[error("the recording is damaged at byte {offset}: {reason}")]
    Damaged {
        /// The place of the malformed part in the file.
        offset: u64,
        /// The failed check.
        reason: &'static str,
    },
    /// The file has no replies of a sensor.
    #[error(
        "no replies of a sensor in this recording: only a file of `urg record`, or of a Recorder with its observer set, can be replayed"
    )]
    NoReplies,
}

impl RecordingError {
    pub(super) fn write(error: io::Error) -> Self {
        Self::Write { source: Arc::new(error) }
    }
}

impl From<FileError> for RecordingError {
    fn from(error: FileError) -> Self {
        match error {
            FileError::Io(error) => Self::Read { source: Arc::new(error) },
            FileError::NotMcap => Self::NotMcap,
            FileError::Compressed(compression) => Self::Compressed { compression },
            FileError::Damaged { offset, reason } => Self::Damaged { offset, reason },
        }
    }
}
