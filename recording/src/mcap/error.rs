//! [`FileError`].

use std::io;

/// Error of a file's form, or of reading it.
#[derive(Debug)]
pub(in super::super) enum FileError {
    Io(io::Error),
    NotMcap,
    /// Chunks have a compression that this build does not read.
    Compressed(String),
    /// A part is malformed. Reading continues after it.
    Damaged {
        offset: u64,
        reason: &'static str,
    },
}
