//! [`Sections`]: reads a file from its beginning to wherever it ends, one chunk at a time.
//! Finds the next chunk after a damaged part. Leaves out unwanted parts if the file's index
//! lists them.
//!
//! Believes no length until it agrees with another one or with the existing bytes. So the
//! file, and a chunk of it, bound the memory.

mod decompress;
mod end;
mod search;

use std::collections::VecDeque;
use std::io::{self, Read};
use std::ops::{Range, RangeInclusive};

use self::decompress::{Failure, decompress};
use super::form::{fields_length, is_well_formed, record_head};
use super::input::FileIndex;
use super::{
    CHUNK_HEAD, FOOTER_BYTES, Fields, Input, MAGIC, MAX_CHUNK_BYTES, MAX_RECORD_BYTES, RECORD_HEAD,
    kind,
};

/// Longest name of a compression.
const MAX_COMPRESSION_NAME: usize = 16;
/// Length of a chunk's record up to its records, compressed or not.
const MAX_CHUNK_HEAD: usize = CHUNK_HEAD + MAX_COMPRESSION_NAME;
/// Number of bytes to read at once.
const READ_BYTES: usize = 64 << 10;
/// Record that ends the data, up to its content.
const DATA_END_HEAD: [u8; RECORD_HEAD] = [kind::DATA_END, 4, 0, 0, 0, 0, 0, 0, 0];

/// Reason for damage.
const WRONG_HEAD: &str = "a record's kind or length is wrong";

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

/// Part of a file. Ranges index into [`Sections::bytes`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Section {
    /// A record outside of chunks.
    Record { kind: u8, content: Range<usize> },
    /// Records of a chunk without compression: with a correct checksum, or the beginning of one at
    /// the end of a cut-off file.
    Chunk { records: Range<usize>, is_cut: bool },
}

/// Reads the parts of a file up to its summary.
#[derive(Default)]
pub(super) struct Sections {
    input: Input,
    /// Room for one read.
    buffer: Vec<u8>,
    /// Bytes of the file, used up to `start`.
    window: Vec<u8>,
    start: usize,
    /// Records of the latest section if it is a compressed chunk, else empty.
    decompressed: Vec<u8>,
    /// Position of `start` in the file.
    offset: u64,
    /// Length of the latest section.
    used: usize,
    /// Parts of the file to leave out.
    unwanted: VecDeque<Range<u64>>,
    is_started: bool,
    is_over: bool,
    is_truncated: bool,
}

/// Head of a chunk whose lengths agree with each other.
struct ChunkHead {
    /// Length of the records without compression.
    size: u64,
    crc: u32,
    /// Name of the compression, or empty.
    compression: String,
    /// From the beginning of the chunk's record.
    records: Range<usize>,
}

impl Sections {
    pub(super) fn new(input: Input) -> Self {
        Self { input, buffer: vec![0; READ_BYTES], ..Self::default() }
    }

    /// Returns true if the whole file was read and its end is missing.
    pub(super) fn is_truncated(&self) -> bool {
        self.is_truncated
    }

    /// Position of the latest section in the file.
    pub(super) fn offset(&self) -> u64 {
        self.offset
    }

    /// Bytes of a range of the latest section.
    pub(super) fn bytes(&self, range: Range<usize>) -> &[u8] {
        let bytes = if self.decompressed.is_empty() { &self.window } else { &self.decompressed };
        bytes.get(range).unwrap_or_default()
    }

    /// Leaves out the chunks after the latest section that have no message at these times, if the
    /// file's index lists them. Returns the index.
    pub(super) fn leave_out_others(
        &mut self,
        times: &RangeInclusive<u64>,
    ) -> Result<FileIndex, FileError> {
        let index = self.index()?;
        self.unwanted = index.parts_outside(times).into();
        Ok(index)
    }

    /// Reads the index at the end of the file, which is empty if the file has none.
    pub(super) fn index(&mut self) -> Result<FileIndex, FileError> {
        self.input.index().map_err(|error| {
            self.is_over = true;
            FileError::Io(error)
        })
    }

    /// Reads the next section, or returns `None` at the end of the data. After an error
    /// other than [`FileError::Damaged`], no sections follow.
    pub(super) fn next(&mut self) -> Result<Option<Section>, FileError> {
        if self.is_over {
            return Ok(None);
        }
        self.decompressed.clear();
        let section = self.section();
        self.is_over = !matches!(section, Ok(Some(_)) | Err(FileError::Damaged { .. }));
        section
    }

    fn section(&mut self) -> Result<Option<Section>, FileError> {
        if !self.is_started {
            self.is_started = true;
            let magic = self.peek(MAGIC.len())?;
            let magic = magic.get(..MAGIC.len()).unwrap_or(magic);
            if !MAGIC.starts_with(magic) {
                return self.find_first_chunk();
            }
            self.used = magic.len();
        }
        loop {
            self.drop_used();
            self.leave_out()?;
            let head = self.peek(MAX_CHUNK_HEAD)?;
            let Some((kind, length)) = record_head(head) else {
                return Ok(self.end_early());
            };
            if let Some(chunk) = chunk_head(head) {
                return self.chunk(kind, chunk);
            }
            let content = head.get(RECORD_HEAD..).unwrap_or_default();
            let is_plausible = match kind {
                kind::DATA_END | kind::FOOTER => {
                    if length == if kind == kind::FOOTER { FOOTER_BYTES as u64 } else { 4 } {
                        self.is_truncated |= !self.is_end_whole()?;
                        match self.skip_to_joined()? {
                            true => continue,
                            false => return Ok(None),
                        }
                    }
                    false
                }
                // The lengths in a cut-off or damaged head do not agree.
                kind::CHUNK if head.len() < chunk_head_length(head) => return Ok(self.end_early()),
                kind::CHUNK => false,
                kind::MESSAGE_INDEX => {
                    let mut fields = Fields(content);
                    let entries = fields.u16().and_then(|_| fields.u32());
                    entries.is_none_or(|bytes| u64::from(bytes) + 6 == length && bytes % 16 == 0)
                }
                kind::MESSAGE => length <= MAX_CHUNK_BYTES,
                kind::HEADER | kind::SCHEMA | kind::CHANNEL | kind::METADATA => {
                    length <= MAX_RECORD_BYTES
                }
                // Those from 0x80 on are private to other programs.
                kind::ATTACHMENT | 0x80.. => match self.is_whole(kind, length)? {
                    Some(is_whole) => is_whole,
                    None => {
                        let error = self.damaged(WRONG_HEAD);
                        return if self.find_chunk()? { Err(error) } else { Ok(self.end_early()) };
                    }
                },
                // Not in the data of a file.
                _ => false,
            };
            if !is_plausible {
                return self.resynchronise(WRONG_HEAD);
            }
            if matches!(kind, kind::ATTACHMENT | kind::MESSAGE_INDEX | 0x80..) {
                if !self.skip(length.saturating_add(RECORD_HEAD as u64))? {
                    return Ok(self.end_early());
                }
                continue;
            }
            let length = usize::try_from(length).unwrap_or(usize::MAX);
            let end = RECORD_HEAD.saturating_add(length);
            let found = self.peek(end)?;
            let content = found.get(RECORD_HEAD..end.min(found.len())).unwrap_or_default();
            match fields_length(kind, content) {
                Some(fields) if fields != length => {
                    return self
                        .resynchronise("a record's fields are longer or shorter than it is");
                }
                None if found.len() >= end => {
                    return self.resynchronise("a record is shorter than its fields");
                }
                _ if found.len() < end => return Ok(self.end_early()),
                // The length of a malformed record may reach into the next chunk.
                _ if !is_well_formed(kind, content) => {
                    return self.resynchronise("a record is malformed");
                }
                _ => {}
            }
            self.used = end;
            let content = self.start + RECORD_HEAD..self.start + end;
            return Ok(Some(Section::Record { kind, content }));
        }
    }

    /// If the next record lies in an unwanted part, continues after that part. If no record
    /// begins there, the file has lost or gained bytes since its index was written: then
    /// leaves out nothing.
    fn leave_out(&mut self) -> Result<(), FileError> {
        let here = self.offset;
        while let Some(part) = self.unwanted.front().cloned()
            && part.start <= self.offset
        {
            self.unwanted.pop_front();
            if part.contains(&self.offset) {
                self.continue_at(part.end)?;
                if !self.begins_here()? {
                    self.unwanted.clear();
                    return self.continue_at(here);
                }
            }
        }
        Ok(())
    }

    fn continue_at(&mut self, place: u64) -> Result<(), FileError> {
        self.input.continue_at(place).map_err(FileError::Io)?;
        self.window.clear();
        (self.start, self.offset) = (0, place);
        Ok(())
    }

    /// Returns true if a chunk, metadata or the end of the data begins here.
    fn begins_here(&mut self) -> Result<bool, FileError> {
        let head = self.peek(MAX_CHUNK_HEAD)?;
        match record_head(head) {
            Some((kind::CHUNK, _)) => Ok(chunk_head(head).is_some()),
            Some((kind::METADATA, length)) if length <= MAX_RECORD_BYTES => {
                let end = RECORD_HEAD + length as usize;
                let content = self.peek(end)?.get(RECORD_HEAD..end);
                Ok(content.is_some_and(|content| is_well_formed(kind::METADATA, content)))
            }
            _ => Ok(head.starts_with(&DATA_END_HEAD)),
        }
    }

    /// Returns true if a record that is skipped has its true length: an attachment if its own
    /// lengths agree, another one if a record follows. Returns `None` if the file has fewer bytes.
    fn is_whole(&mut self, kind: u8, length: u64) -> Result<Option<bool>, FileError> {
        let is_attachment = kind == kind::ATTACHMENT;
        let most = if is_attachment { MAX_RECORD_BYTES } else { MAX_CHUNK_BYTES };
        if length > most && !is_attachment {
            return Ok(None);
        }
        let content = length.min(most) as usize;
        let wanted = RECORD_HEAD + content + if is_attachment { 0 } else { RECORD_HEAD };
        let found = self.peek(wanted)?;
        if is_attachment {
            let lengths = attachment_length(found.get(RECORD_HEAD..).unwrap_or_default());
            let is_short = lengths.is_none() && found.len() < wanted;
            return Ok((!is_short).then_some(lengths == Some(length)));
        }
        let next = found.get(RECORD_HEAD + content..).and_then(record_head);
        Ok(next.map(|(kind, length)| match kind {
            kind::ATTACHMENT => true,
            kind::SCHEMA..=kind::DATA_END | 0x80.. => length <= MAX_CHUNK_BYTES,
            _ => false,
        }))
    }

    fn chunk(&mut self, kind: u8, head: ChunkHead) -> Result<Option<Section>, FileError> {
        const WRONG_CHECKSUM: &str = "a chunk's checksum is wrong";
        let found = self.peek(head.records.end)?.len();
        let is_whole = found >= head.records.end;
        let end = head.records.end.min(found);
        self.used = end;
        if kind != kind::CHUNK {
            return Err(self.damaged(WRONG_CHECKSUM));
        }
        let records = if head.compression.is_empty() {
            let end = self.start + end;
            (self.start + head.records.start).min(end)..end
        } else {
            self.decompress(&head, is_whole)?;
            0..self.decompressed.len()
        };
        // A chunk that is cut short cannot be checked.
        self.is_truncated |= !is_whole;
        let is_checked = is_whole && head.crc != 0;
        if is_checked && crc32fast::hash(self.bytes(records.clone())) != head.crc {
            return Err(self.damaged(WRONG_CHECKSUM));
        }
        Ok(Some(Section::Chunk { records, is_cut: !is_whole }))
    }

    /// Decompresses the chunk at `start`.
    fn decompress(&mut self, head: &ChunkHead, is_whole: bool) -> Result<(), FileError> {
        let chunk = self.window.get(self.start..self.start + self.used).unwrap_or_default();
        match decompress(chunk, head, &mut self.decompressed) {
            Err(Failure::Compression) => Err(FileError::Compressed(head.compression.clone())),
            Err(Failure::Damaged(reason)) if is_whole => Err(self.damaged(reason)),
            _ => Ok(()),
        }
    }

    pub(super) fn damaged(&self, reason: &'static str) -> FileError {
        FileError::Damaged { offset: self.offset, reason }
    }

    fn end_early<T>(&mut self) -> Option<T> {
        self.is_truncated = true;
        None
    }

    /// Skips this many bytes. Returns false if the file has fewer.
    fn skip(&mut self, length: u64) -> Result<bool, FileError> {
        self.skip_with(length, |_| {})
    }

    /// Skips bytes, and passes them to `see` in pieces.
    fn skip_with(&mut self, length: u64, mut see: impl FnMut(&[u8])) -> Result<bool, FileError> {
        let mut rest = length;
        while rest > 0 {
            let next = rest.min(READ_BYTES as u64) as usize;
            let Some(bytes) = self.peek(next)?.get(..next) else { return Ok(false) };
            see(bytes);
            self.used = next;
            self.drop_used();
            rest -= next as u64;
        }
        Ok(true)
    }

    /// Reads ahead: at least `count` bytes, unless the file has fewer.
    fn peek(&mut self, count: usize) -> Result<&[u8], FileError> {
        if self.window.len().saturating_sub(self.start) < count {
            self.window.drain(..self.start);
            self.start = 0;
            // Grows with the existing bytes, not with the claimed ones. Takes what a pipe has, and
            // does not wait for more.
            while self.window.len() < count && self.read_more().map_err(FileError::Io)? {}
        }
        Ok(self.window.get(self.start..).unwrap_or_default())
    }

    /// Reads up to [`READ_BYTES`]. Returns false at the end of the input.
    fn read_more(&mut self) -> io::Result<bool> {
        let read = loop {
            match self.input.read(&mut self.buffer) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                outcome => break outcome?,
            }
        };
        self.window.extend_from_slice(self.buffer.get(..read).unwrap_or_default());
        Ok(read > 0)
    }

    fn drop_used(&mut self) {
        let used = std::mem::take(&mut self.used);
        self.start += used;
        self.offset += used as u64;
    }
}

/// Length of an attachment by the lengths in it: times, name, media type, data and CRC.
fn attachment_length(content: &[u8]) -> Option<u64> {
    let mut fields = Fields(content);
    let _times = (fields.u64()?, fields.u64()?);
    let _names = (fields.bytes()?, fields.bytes()?);
    let data = fields.u64()?;
    data.checked_add((content.len() - fields.0.len()) as u64 + 4)
}

/// Length of the chunk's head at the beginning of `bytes`, which may be cut off.
fn chunk_head_length(bytes: &[u8]) -> usize {
    // The last fields are the length of the name, the name, and the length of the records.
    let name = bytes.get(CHUNK_HEAD - 8 - 4..).and_then(|rest| Fields(rest).u32());
    CHUNK_HEAD + name.map_or(0, |length| (length as usize).min(MAX_COMPRESSION_NAME))
}

/// Head of the chunk at the beginning of `bytes`, whatever its kind says, if its lengths
/// agree.
fn chunk_head(bytes: &[u8]) -> Option<ChunkHead> {
    let (_, length) = record_head(bytes)?;
    let mut fields = Fields(bytes.get(RECORD_HEAD..)?);
    let (_start, _end, size) = (fields.u64()?, fields.u64()?, fields.u64()?);
    let crc = fields.u32()?;
    let name = fields.bytes()?;
    let records = fields.u64()?;
    let start = CHUNK_HEAD + name.len();
    let agrees = name.len() <= MAX_COMPRESSION_NAME
        && length <= MAX_CHUNK_BYTES
        && length.checked_sub((start - RECORD_HEAD) as u64) == Some(records)
        && (!name.is_empty() || size == records);
    let end = start.checked_add(usize::try_from(records).ok()?)?;
    agrees.then(|| {
        let compression = name.escape_ascii().to_string();
        ChunkHead { size, crc, compression, records: start..end }
    })
}
