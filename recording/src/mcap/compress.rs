//! [`Compressor`]: compresses the records of chunks, each one alone, so that damage costs no other.
//!
//! LZ4 is pure Rust. Zstandard is the C library, because no encoder in pure Rust is as good
//! (`rationale`).

use super::Compression;

/// Level of Zstandard.
#[cfg(feature = "zstd")]
const ZSTD_LEVEL: i32 = 3;

pub(super) struct Compressor {
    pub(super) compression: Compression,
    #[cfg(feature = "zstd")]
    zstd: Option<zstd_safe::CCtx<'static>>,
}

impl Compressor {
    pub(super) fn new(compression: Compression) -> Self {
        Self {
            compression,
            #[cfg(feature = "zstd")]
            zstd: None,
        }
    }

    /// Appends the compressed records to `out`. Returns false if they do not get shorter, or this build
    /// does not write the compression; `out` may then have any bytes.
    #[cfg_attr(not(feature = "compression"), allow(clippy::ptr_arg))]
    pub(super) fn compress(&mut self, records: &[u8], out: &mut Vec<u8>) -> bool {
        let begin = out.len();
        let is_done = match self.compression {
            #[cfg(feature = "compression")]
            Compression::Lz4 => lz4(records, out).is_ok(),
            #[cfg(feature = "zstd")]
            Compression::Zstd => self.zstd(records, out).is_some(),
            _ => false,
        };
        is_done && out.len() - begin < records.len()
    }

    #[cfg(feature = "zstd")]
    fn zstd(&mut self, records: &[u8], out: &mut Vec<u8>) -> Option<()> {
        let context = match &mut self.zstd {
            Some(context) => context,
            none => none.insert(zstd_safe::CCtx::try_create()?),
        };
        let begin = out.len();
        out.resize(begin + zstd_safe::compress_bound(records.len()), 0);
        let length = context.compress(out.get_mut(begin..)?, records, ZSTD_LEVEL).ok()?;
        out.truncate(begin + length);
        Some(())
    }
}

/// Appends a frame of LZ4. Its blocks have 64 KiB: of a chunk that is cut off, the whole ones can be
/// read.
#[cfg(feature = "compression")]
fn lz4(records: &[u8], out: &mut Vec<u8>) -> Result<(), lz4_flex::frame::Error> {
    use lz4_flex::frame::{BlockSize, FrameEncoder, FrameInfo};

    let info = FrameInfo::new().block_size(BlockSize::Max64KB);
    let mut encoder = FrameEncoder::with_frame_info(info, out);
    std::io::Write::write_all(&mut encoder, records)?;
    encoder.finish().map(drop)
}
