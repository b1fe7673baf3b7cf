//! [`Compression`]: how the chunks of a file are compressed, each one alone, so that damage costs no other.
//!
//! Pure Rust, but for writing zstd: no encoder in pure Rust is as good as the C library (`rationale`).
//! `ruzstd` returns bytes only once they have left the window: if a file is cut off within a chunk,
//! this whole chunk may be lost.

use std::cmp::Ordering;
use std::collections::BTreeSet;
use std::fmt;
use std::io::Read;

use super::MAX_CHUNK_BYTES;
use crate::RecordingError;

#[cfg(feature = "zstd")]
const ZSTD_LEVEL: i32 = 3;
/// Largest window of zstd for a smaller chunk: a decoder reserves the window that the input claims.
/// RFC 8878 recommends to support at least 8 MiB.
#[cfg(feature = "compression")]
const MAX_SMALL_WINDOW: u64 = 8 << 20;

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

    /// Returns true if this build writes it: LZ4 with feature `compression`, Zstandard with feature `zstd`.
    pub fn is_written(self) -> bool {
        match self {
            Self::Plain => true,
            Self::Lz4 => cfg!(feature = "compression"),
            Self::Zstd => cfg!(feature = "zstd"),
        }
    }

    pub(crate) fn check(self) -> Result<(), RecordingError> {
        match self.is_written() {
            true => Ok(()),
            false => Err(RecordingError::NotWritten { compression: self.to_string() }),
        }
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Plain => "",
            Self::Lz4 => "lz4",
            Self::Zstd => "zstd",
        }
    }

    pub(super) fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|one| one.name() == name)
    }

    /// Appends the compressed records of a chunk to `out`. Returns false if they do not get shorter, or
    /// this build does not write the compression; `out` may then have any bytes.
    #[cfg_attr(not(feature = "compression"), allow(clippy::ptr_arg))]
    pub(super) fn compress(self, records: &[u8], out: &mut Vec<u8>) -> bool {
        let begin = out.len();
        let is_done = match self {
            #[cfg(feature = "compression")]
            Self::Lz4 => lz4(records, out).is_ok(),
            #[cfg(feature = "zstd")]
            Self::Zstd => zstd(records, out).is_some(),
            _ => false,
        };
        is_done && out.len() - begin < records.len()
    }
}

#[cfg(feature = "zstd")]
fn zstd(records: &[u8], out: &mut Vec<u8>) -> Option<()> {
    let begin = out.len();
    out.resize(begin + zstd_safe::compress_bound(records.len()), 0);
    let length = zstd_safe::compress(out.get_mut(begin..)?, records, ZSTD_LEVEL).ok()?;
    out.truncate(begin + length);
    Some(())
}

/// Appends a frame of LZ4. Its blocks have 64 KiB: of a chunk that is cut off, the whole ones can be read.
#[cfg(feature = "compression")]
fn lz4(records: &[u8], out: &mut Vec<u8>) -> Result<(), lz4_flex::frame::Error> {
    use lz4_flex::frame::{BlockSize, FrameEncoder, FrameInfo};

    let info = FrameInfo::new().block_size(BlockSize::Max64KB);
    let mut encoder = FrameEncoder::with_frame_info(info, out);
    std::io::Write::write_all(&mut encoder, records)?;
    encoder.finish().map(drop)
}

/// Decompresses the records of a chunk, which claims `size` bytes of them, into the empty `out`. They may
/// be cut off: `out` then has what could be decompressed, and the error says why that is not all. Returns
/// `None` if this build does not read the compression.
pub(super) fn decompress(
    compression: &str,
    records: &[u8],
    size: u64,
    out: &mut Vec<u8>,
) -> Option<Result<(), &'static str>> {
    let decoder = decoder(compression, records, size)?;
    if size > MAX_CHUNK_BYTES {
        return Some(Err("a chunk claims more than 64 MiB after decompression"));
    }
    // One more byte shows that there are more.
    let outcome = decoder.take(size + 1).read_to_end(out);
    Some(match (out.len() as u64).cmp(&size) {
        Ordering::Greater => {
            out.pop();
            Err("a chunk decompresses to more bytes than it claims")
        }
        Ordering::Equal if outcome.is_ok() => Ok(()),
        _ => Err("a chunk cannot be decompressed"),
    })
}

#[cfg_attr(not(feature = "compression"), allow(unused_variables))]
fn decoder<'a>(compression: &str, records: &'a [u8], size: u64) -> Option<Box<dyn Read + 'a>> {
    match compression {
        #[cfg(feature = "compression")]
        "lz4" => Some(Box::new(lz4_flex::frame::FrameDecoder::new(records))),
        #[cfg(feature = "compression")]
        "zstd" => {
            let max_window = size.clamp(MAX_SMALL_WINDOW, MAX_CHUNK_BYTES);
            let decoder = ruzstd::decoding::StreamingDecoder::new_with_max_window_size;
            match decoder(records, max_window) {
                Ok(decoder) => Some(Box::new(decoder)),
                // Without its head, nothing can be decompressed.
                Err(_) => Some(Box::new(std::io::empty())),
            }
        }
        _ => None,
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
    pub(super) fn add(&mut self, compression: &str, stored: usize, plain: usize) {
        self.compressions.extend(Compression::named(compression));
        self.stored += stored as u64;
        self.plain += plain as u64;
    }
}
