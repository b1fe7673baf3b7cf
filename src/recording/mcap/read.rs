//! [`Sections`]: reads a file from its beginning to wherever it ends, one chunk at a
//! time, and finds the next chunk behind a damaged part. Parts that nobody wants are
//! left out if the file's index has them.
//!
//! No length is believed before it agrees with another one or with the bytes that
//! are there. So memory is bounded by the file, and by a chunk of it.

use std::collections::VecDeque;
use std::io::{self, Read};
use std::ops::Range;

use super::form::{fields_length, is_well_formed, record_head};
use super::input::FileIndex;
use super::{
    CHUNK_HEAD, FILE_END, FOOTER_BYTES, Fields, Input, MAGIC, MAX_CHUNK_BYTES, MAX_RECORD_BYTES,
    RECORD_HEAD, kind,
};

/// The longest name of a compression.
const MAX_COMPRESSION_NAME: usize = 16;
/// A chunk's record up to its records, compressed or not.
const MAX_CHUNK_HEAD: usize = CHUNK_HEAD + MAX_COMPRESSION_NAME;
/// The bytes that are read at once.
const READ_BYTES: usize = 64 << 10;
/// The record that ends the data, up to its content.
const DATA_END_HEAD: [u8; RECORD_HEAD] = [kind::DATA_END, 4, 0, 0, 0, 0, 0, 0, 0];

/// An error of a file's form, or of reading it.
#[derive(Debug)]
pub(in super::super) enum FileError {
    Io(io::Error),
    NotMcap,
    /// Chunks are compressed.
    Compressed(String),
    /// A part is malformed. Reading goes on behind it.
    Damaged {
        offset: u64,
        reason: &'static str,
    },
}

/// A part of a file. Ranges are those of [`Sections::bytes`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in super::super) enum Section {
    /// A record outside of chunks.
    Record { kind: u8, content: Range<usize> },
    /// A chunk whose checksum is right: all of it, and its records.
    Chunk { record: Range<usize>, records: Range<usize> },
    /// The beginning of a chunk, where the file ends in it.
    CutChunk { records: Range<usize> },
}

/// Reads the parts of a file up to its summary.
pub(in super::super) struct Sections {
    input: Input,
    /// Bytes of the file; those before `start` were used.
    window: Vec<u8>,
    start: usize,
    /// The place of `start` in the file.
    offset: u64,
    /// The length of the latest section.
    used: usize,
    /// Parts of the file that are left out.
    unwanted: VecDeque<Range<u64>>,
    is_started: bool,
    is_over: bool,
    is_truncated: bool,
}

/// The head of a chunk whose lengths agree with each other.
struct ChunkHead {
    crc: u32,
    /// The name of the compression, empty for none.
    compression: String,
    /// From the beginning of the chunk's record.
    records: Range<usize>,
}

impl Sections {
    pub(in super::super) fn new(input: Input) -> Self {
        Self {
            input,
            window: Vec::new(),
            start: 0,
            offset: 0,
            used: 0,
            unwanted: VecDeque::new(),
            is_started: false,
            is_over: false,
            is_truncated: false,
        }
    }

    /// Returns true if the file was read and its end is missing.
    pub(in super::super) fn is_truncated(&self) -> bool {
        self.is_truncated
    }

    /// Returns the place of the latest section in the file.
    pub(in super::super) fn offset(&self) -> u64 {
        self.offset
    }

    /// Returns the bytes of a range of the latest section.
    pub(in super::super) fn bytes(&self, range: Range<usize>) -> &[u8] {
        self.window.get(range).unwrap_or_default()
    }

    /// Leaves out the chunks behind the latest section that have nothing but messages
    /// before `time` (nanoseconds since 1970), as far as the file's index has them. Returns
    /// the index: channels may be defined in what is left out.
    pub(in super::super) fn leave_out_before(&mut self, time: u64) -> Result<FileIndex, FileError> {
        let index = self.input.index().map_err(FileError::Io)?;
        self.unwanted = index.parts_before(time).into();
        Ok(index)
    }

    /// Returns the next section, or `None` at the end of the data. Only
    /// [`FileError::Damaged`] is followed by more.
    pub(in super::super) fn next(&mut self) -> Result<Option<Section>, FileError> {
        if self.is_over {
            return Ok(None);
        }
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
                return Err(FileError::NotMcap);
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
                        self.is_truncated = !self.has_end()?;
                        return Ok(None);
                    }
                    false
                }
                // A cut-off head has no agreeing lengths, nor has a damaged one.
                kind::CHUNK if head.len() < CHUNK_HEAD => return Ok(self.end_early()),
                kind::CHUNK => false,
                kind::MESSAGE_INDEX => {
                    let mut fields = Fields(content);
                    let entries = fields.u16().and_then(|_| fields.u32());
                    entries.is_none_or(|bytes| u64::from(bytes) + 6 == length && bytes % 16 == 0)
                }
                kind::MESSAGE => length <= MAX_CHUNK_BYTES,
                kind::ATTACHMENT => true,
                kind::HEADER..=kind::DATA_END => length <= MAX_RECORD_BYTES,
                // Private to others; 0 and the rest are no records.
                0x80.. => true,
                _ => false,
            };
            if !is_plausible {
                return self.resynchronise("a record's kind or length is wrong");
            }
            if matches!(kind, kind::ATTACHMENT | kind::MESSAGE_INDEX | 0x10..) {
                if !self.skip(length)? {
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
                    return self.resynchronise("a record is not of its form");
                }
                _ => {}
            }
            self.used = end;
            let content = self.start + RECORD_HEAD..self.start + end;
            return Ok(Some(Section::Record { kind, content }));
        }
    }

    /// Goes on behind the unwanted part in which the next record is, if it is in one.
    /// If no record begins there, the file has lost or gained bytes since its index was
    /// written: then nothing is left out.
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

    fn chunk(&mut self, kind: u8, head: ChunkHead) -> Result<Option<Section>, FileError> {
        let ChunkHead { crc, compression, records } = head;
        if !compression.is_empty() {
            return Err(FileError::Compressed(compression));
        }
        let chunk = self.peek(records.end)?;
        let is_whole = chunk.len() >= records.end;
        let end = records.end.min(chunk.len());
        let found = chunk.get(records.start..end).unwrap_or_default();
        // What is cut short cannot be checked.
        let is_right =
            kind == kind::CHUNK && (!is_whole || crc == 0 || crc32fast::hash(found) == crc);
        self.used = end;
        let records = self.start + records.start.min(end)..self.start + end;
        if !is_right {
            return Err(self.damaged("a chunk's checksum is wrong"));
        }
        if is_whole {
            let record = self.start..self.start + end;
            return Ok(Some(Section::Chunk { record, records }));
        }
        self.is_truncated = true;
        Ok(Some(Section::CutChunk { records }))
    }

    /// Skips to the next chunk, or to the end of the data.
    fn resynchronise(&mut self, reason: &'static str) -> Result<Option<Section>, FileError> {
        let error = self.damaged(reason);
        // The first byte begins nothing.
        self.used = 1;
        loop {
            self.drop_used();
            let bytes = self.peek(READ_BYTES)?;
            let is_next = |at: &usize| {
                let rest = bytes.get(*at..).unwrap_or_default();
                match rest.first() {
                    Some(&kind::CHUNK) => chunk_head(rest).is_some(),
                    Some(&kind::DATA_END) => rest.starts_with(&DATA_END_HEAD),
                    _ => false,
                }
            };
            let next = (0..bytes.len()).find(is_next);
            let is_end = bytes.len() < READ_BYTES;
            self.used = match next {
                Some(next) => next,
                // The next call finds the end of the file.
                None if is_end => bytes.len(),
                // A head may begin in what was read and end behind it.
                None => bytes.len().saturating_sub(MAX_CHUNK_HEAD),
            };
            if next.is_some() || is_end {
                return Err(error);
            }
        }
    }

    /// Skips the summary, and returns true if the file has its last byte: without its
    /// end, other readers do not open it.
    fn has_end(&mut self) -> Result<bool, FileError> {
        loop {
            let head = self.peek(FILE_END)?;
            let Some((kind, length)) = record_head(head) else { return Ok(false) };
            if kind == kind::FOOTER {
                let is_whole = head.get(..FILE_END).is_some_and(|end| end.ends_with(&MAGIC));
                return Ok(is_whole && length == FOOTER_BYTES as u64);
            }
            if !self.skip(length)? {
                return Ok(false);
            }
        }
    }

    pub(super) fn damaged(&self, reason: &'static str) -> FileError {
        FileError::Damaged { offset: self.offset, reason }
    }

    fn end_early<T>(&mut self) -> Option<T> {
        self.is_truncated = true;
        None
    }

    /// Skips a record, however long its content is. Returns false if the file ends
    /// in it.
    fn skip(&mut self, length: u64) -> Result<bool, FileError> {
        let mut rest = length.saturating_add(RECORD_HEAD as u64);
        while rest > 0 {
            let next = rest.min(READ_BYTES as u64) as usize;
            if self.peek(next)?.len() < next {
                return Ok(false);
            }
            self.used = next;
            self.drop_used();
            rest -= next as u64;
        }
        Ok(true)
    }

    /// Returns the next bytes: at least so many, unless the file has fewer.
    fn peek(&mut self, count: usize) -> Result<&[u8], FileError> {
        let missing = (self.start.saturating_add(count)).saturating_sub(self.window.len());
        if missing > 0 {
            self.window.drain(..self.start);
            self.start = 0;
            // Grows with the bytes that are there, not with those that were claimed.
            let wanted = missing.max(READ_BYTES) as u64;
            let mut input = self.input.by_ref().take(wanted);
            input.read_to_end(&mut self.window).map_err(FileError::Io)?;
        }
        Ok(self.window.get(self.start..).unwrap_or_default())
    }

    fn drop_used(&mut self) {
        let used = std::mem::take(&mut self.used);
        self.start += used;
        self.offset += used as u64;
    }
}

/// The head of the chunk at the beginning of `bytes`, whatever its kind says, if
/// its lengths agree.
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
        ChunkHead { crc, compression, records: start..end }
    })
}
