//! Decompresses the records of a chunk (feature `compression`).
//!
//! The crates `ruzstd` and `lz4_flex` are pure Rust. `zstd` and `lz4` build C libraries, which takes
//! a C compiler for each target. `ruzstd` returns bytes only once they have left the window: if a
//! file is cut off within a chunk, this whole chunk may be lost.

use std::cmp::Ordering;
#[cfg(feature = "compression")]
use std::io;
use std::io::Read;

use crate::mcap::MAX_CHUNK_BYTES;
use crate::mcap::form::ChunkHead;

/// Largest window of zstd for a smaller chunk: a decoder reserves the window that the input claims.
/// RFC 8878 recommends to support at least 8 MiB.
#[cfg(feature = "compression")]
const MAX_SMALL_WINDOW: u64 = 8 << 20;

/// Decompresses the records of a chunk into the empty `out`. They may be cut off: `out` then has what
/// could be decompressed, and the error says why that is not all. Returns `None` if this build does not
/// read the compression.
pub(super) fn decompress(
    compressed: &[u8],
    head: &ChunkHead,
    out: &mut Vec<u8>,
) -> Option<Result<(), &'static str>> {
    let decoder = decoder(&head.compression, compressed, head.size)?;
    if head.size > MAX_CHUNK_BYTES {
        return Some(Err("a chunk claims more than 64 MiB after decompression"));
    }
    // One more byte shows that there are more.
    let outcome = decoder.take(head.size + 1).read_to_end(out);
    Some(match (out.len() as u64).cmp(&head.size) {
        Ordering::Greater => {
            out.pop();
            Err("a chunk decompresses to more bytes than it claims")
        }
        Ordering::Equal if outcome.is_ok() => Ok(()),
        _ => Err("a chunk cannot be decompressed"),
    })
}

/// Returns a decoder, or `None` if this build does not read the compression.
#[cfg(feature = "compression")]
fn decoder<'a>(compression: &str, bytes: &'a [u8], size: u64) -> Option<Box<dyn Read + 'a>> {
    use lz4_flex::frame::FrameDecoder;
    use ruzstd::decoding::StreamingDecoder;

    match compression {
        "lz4" => Some(Box::new(FrameDecoder::new(bytes))),
        "zstd" => {
            let max_window = size.clamp(MAX_SMALL_WINDOW, MAX_CHUNK_BYTES);
            match StreamingDecoder::new_with_max_window_size(bytes, max_window) {
                Ok(decoder) => Some(Box::new(decoder)),
                // Without its head, nothing can be decompressed.
                Err(_) => Some(Box::new(io::empty())),
            }
        }
        _ => None,
    }
}

#[cfg(not(feature = "compression"))]
fn decoder(_compression: &str, _bytes: &[u8], _size: u64) -> Option<std::io::Empty> {
    None
}
