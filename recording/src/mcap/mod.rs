//! MCAP, the container format of recordings (<https://mcap.dev/spec>): written, read and
//! repaired. Knows nothing of scans and ROS.
//!
//! Written by hand, for files that are hostile, damaged or weeks long; `rationale` compares it with
//! the crate `mcap`, with which the tests read what is written here.

mod compression;
mod definitions;
mod file_index;
mod form;
mod index;
mod read;
mod window;
mod write;

use std::time::Duration;

pub use self::compression::{ChunkBytes, Compression};
pub(super) use self::definitions::{Channel, Definitions};
pub(super) use self::form::parse_metadata;
pub(super) use self::read::Records;
pub(super) use self::write::{McapWriter, channel, header, metadata, schema};

/// Starts and ends every file.
pub(super) const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";
/// Length of a record's kind and of the length of its content.
const RECORD_HEAD: usize = 1 + 8;
/// Length of an uncompressed chunk's record up to its records: start, end, size, CRC, the
/// empty name of the compression, length of the records.
const CHUNK_HEAD: usize = RECORD_HEAD + 8 + 8 + 8 + 4 + 4 + 8;
const FOOTER_BYTES: usize = 20;
/// Length of a file's end: its footer, and the magic after it.
const FILE_END: usize = RECORD_HEAD + FOOTER_BYTES + MAGIC.len();
/// Longest chunk, or message outside a chunk, to read.
const MAX_CHUNK_BYTES: u64 = 64 << 20;
/// Longest record of another kind to read.
const MAX_RECORD_BYTES: u64 = 1 << 20;
/// Largest number of bytes of the schemas and channels of one file.
const MAX_DEFINITION_BYTES: usize = 64 << 20;
/// Longest index to read and to write. 45 hours of chunks of a second take as much.
const MAX_INDEX_BYTES: usize = 16 << 20;

pub(super) mod kind {
    pub(crate) const HEADER: u8 = 0x01;
    pub(super) const FOOTER: u8 = 0x02;
    pub(crate) const SCHEMA: u8 = 0x03;
    pub(crate) const CHANNEL: u8 = 0x04;
    pub(crate) const MESSAGE: u8 = 0x05;
    pub(super) const CHUNK: u8 = 0x06;
    pub(super) const MESSAGE_INDEX: u8 = 0x07;
    pub(super) const CHUNK_INDEX: u8 = 0x08;
    pub(super) const ATTACHMENT: u8 = 0x09;
    pub(super) const STATISTICS: u8 = 0x0b;
    pub(crate) const METADATA: u8 = 0x0c;
    pub(super) const METADATA_INDEX: u8 = 0x0d;
    pub(super) const SUMMARY_OFFSET: u8 = 0x0e;
    pub(super) const DATA_END: u8 = 0x0f;
}

/// Fields of a message besides its data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct MessageHeader {
    pub(super) channel: u16,
    pub(super) sequence: u32,
    /// Nanoseconds since 1970.
    pub(super) log_time: u64,
    /// Nanoseconds since 1970.
    pub(super) publish_time: u64,
}

impl MessageHeader {
    /// Splits the content of a message into its header and its data.
    pub(super) fn parse(content: &[u8]) -> Option<(Self, &[u8])> {
        let mut fields = Fields(content);
        let header = Self {
            channel: fields.u16()?,
            sequence: fields.u32()?,
            log_time: fields.u64()?,
            publish_time: fields.u64()?,
        };
        Some((header, fields.0))
    }
}

/// Reads the fields of a record. Each method checks a length before it uses it, and
/// returns `None` if the content is too short.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fields<'a>(pub(super) &'a [u8]);

impl<'a> Fields<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*taken)
    }

    pub(super) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    pub(super) fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = usize::try_from(self.u32()?).ok()?;
        self.take(length)
    }

    pub(super) fn string(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.bytes()?).ok()
    }
}

/// Converts a duration, or a time since 1970, to the form in files.
pub(super) fn nanos(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

fn put_numbers(out: &mut Vec<u8>, numbers: &[u64]) {
    numbers.iter().for_each(|number| out.extend_from_slice(&number.to_le_bytes()));
}

fn put_bytes(out: &mut Vec<u8>, bytes: &[u8]) {
    let length = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
    out.extend_from_slice(&length.to_le_bytes());
    out.extend_from_slice(bytes);
}

/// Appends a record whose content `write` appends.
fn put_record(out: &mut Vec<u8>, kind: u8, write: impl FnOnce(&mut Vec<u8>)) {
    let start = out.len();
    out.push(kind);
    out.extend_from_slice(&[0; 8]);
    write(out);
    let length = (out.len() - start - RECORD_HEAD) as u64;
    if let Some(place) = out.get_mut(start + 1..start + RECORD_HEAD) {
        place.copy_from_slice(&length.to_le_bytes());
    }
}
