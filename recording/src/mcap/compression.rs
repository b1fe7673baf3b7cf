//! [`Compression`]: how the chunks of a file are compressed.

use std::collections::BTreeSet;
use std::fmt;

use crate::RecordingError;

/// Compression of a file's chunks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
#[non_exhaustive]
pub enum Compression {
    /// No compression.
    #[default]
    Plain,
    /// LZ4: takes less CPU time.
    Lz4,
    /// Zstandard: takes fewer bytes.
    Zstd,
}

impl Compression {
    const ALL: [Self; 3] = [Self::Plain, Self::Lz4, Self::Zstd];

    /// Returns true if this build writes it: LZ4 with feature `compression`, Zstandard with feature
    /// `zstd`.
    pub fn is_written(self) -> bool {
        match self {
            Self::Plain => true,
            Self::Lz4 => cfg!(feature = "compression"),
            Self::Zstd => cfg!(feature = "zstd"),
        }
    }

    pub(in super::super) fn check(self) -> Result<(), RecordingError> {
        match self.is_written() {
            true => Ok(()),
            false => Err(RecordingError::NotWritten { compression: self.to_string() }),
        }
    }

    /// Name in a file.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Plain => "",
            Self::Lz4 => "lz4",
            Self::Zstd => "zstd",
        }
    }

    /// Compression of this name in a file.
    pub(super) fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|one| one.name() == name)
    }
}

/// Writes `none`, `lz4` or `zstd`.
impl fmt::Display for Compression {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(if *self == Self::Plain { "none" } else { self.name() })
    }
}

/// Bytes of the records in the chunks of a recording, as far as it was read.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct ChunkBytes {
    /// Compressions of the chunks.
    pub compressions: BTreeSet<Compression>,
    /// Bytes in the file.
    pub stored: u64,
    /// The same without compression.
    pub plain: u64,
}

impl ChunkBytes {
    /// Adds a chunk of this compression.
    pub(super) fn add(&mut self, compression: &str, stored: usize, plain: usize) {
        self.compressions.extend(Compression::named(compression));
        self.stored += stored as u64;
        self.plain += plain as u64;
    }

    /// Adds the chunks of another file.
    pub(in super::super) fn extend(&mut self, other: &Self) {
        self.compressions.extend(&other.compressions);
        self.stored += other.stored;
        self.plain += other.plain;
    }
}
