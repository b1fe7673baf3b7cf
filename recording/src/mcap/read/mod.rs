//! [`Records`]: reads the records of a file from its beginning to wherever it ends, one chunk at a time.
//! Finds the next record after a damaged one. Leaves out unwanted parts if the file's index lists them.
//!
//! Believes no length until it agrees with another one or with the existing bytes. So the
//! file, and a chunk of it, bound the memory.

mod chunk;
mod end;

use std::collections::VecDeque;
use std::fs::File;
use std::io::Read;
use std::ops::{Range, RangeInclusive};

use self::chunk::ChunkRecords;
use super::file_index::{parts_outside, read_index};
use super::form::{
    Extent, Kinds, is_known, is_message_index, is_well_formed, next_start, outside_chunks,
    records_of,
};
use super::window::{READ_BYTES, Window};
use super::{ChunkBytes, Definitions, Fields, MAGIC, MAX_CHUNK_BYTES, RECORD_HEAD, kind};
use crate::RecordingError;

const WRONG_HEAD: &str = "a record's kind or length is wrong";

/// Kind of a record, and the place of its content in [`Records::bytes`].
type Place = (u8, Range<usize>);

/// Kind and content of a record, and the definitions up to it.
pub(crate) type ReadRecord<'a> = (u8, &'a [u8], &'a Definitions);

/// Kinds of records that no summary has.
fn is_data(kind: u8) -> bool {
    is_known(kind) && !matches!(kind, kind::FOOTER | kind::SCHEMA | kind::CHANNEL)
}

/// Reads the well-formed records of a file up to its summary, including those in chunks.
#[derive(Default)]
pub(crate) struct Records {
    window: Window,
    /// Chunk whose records are being read.
    chunk: ChunkRecords,
    pub(crate) chunk_bytes: ChunkBytes,
    /// Name of the latest compression that this build does not read.
    unknown: Option<String>,
    /// Length of the latest record of the file.
    used: usize,
    /// Set once the file is known to have chunks, or none.
    has_chunks: Option<bool>,
    pub(crate) definitions: Definitions,
    /// Position up to which a record that looked like the end of the data was no end.
    no_end: u64,
    /// Set once the index of the file was read.
    has_index: bool,
    /// Parts of the file to leave out.
    unwanted: VecDeque<Range<u64>>,
    /// Position of the last reported damage.
    damaged_at: Option<u64>,
    is_over: bool,
    /// True once the whole file was read, and its end is missing or damaged.
    pub(crate) is_truncated: bool,
}

impl Records {
    /// Reads any input. If it is a [`File`], its index is read, too.
    pub(crate) fn new(input: impl Read + Send + 'static) -> Self {
        Self { window: Window::new(input), ..Self::default() }
    }

    /// Continues in the next file of a recording.
    pub(crate) fn continue_in(&mut self, file: File) {
        let chunk_bytes = std::mem::take(&mut self.chunk_bytes);
        *self = Self { chunk_bytes, is_truncated: self.is_truncated, ..Self::new(file) };
    }

    /// Leaves out chunks without a message at these times, if the file's index lists them and repeats
    /// the definitions: the only one of a topic may be in such a chunk.
    pub(crate) fn leave_out_others(
        &mut self,
        times: &RangeInclusive<u64>,
    ) -> Result<(), RecordingError> {
        let index = self.read_index()?;
        let has = |wanted| records_of(&index).any(|(kind, _)| kind == wanted);
        if has(kind::SCHEMA) && has(kind::CHANNEL) {
            self.unwanted = parts_outside(&index, times).into();
        }
        Ok(())
    }

    /// Reads the index at the end of the file, which is empty if the file has none, and its definitions:
    /// the chunks with them may be damaged or left out.
    fn read_index(&mut self) -> Result<Vec<u8>, RecordingError> {
        let index = self.window.file.as_mut().map_or(Ok(Vec::new()), read_index);
        self.is_over |= index.is_err();
        let index = index.map_err(RecordingError::read)?;
        self.has_index = true;
        for (kind, content) in records_of(&index) {
            if matches!(kind, kind::SCHEMA | kind::CHANNEL) && is_well_formed(kind, content) {
                self.definitions.define(kind, content);
            }
        }
        Ok(index)
    }

    /// Reports the latest record as damaged. Returns the position of the record, or of its chunk if it is
    /// in one. Returns `None` if damage at that position has been reported already.
    pub(crate) fn report_damage(&mut self) -> Option<u64> {
        let offset = self.window.offset;
        self.is_news(offset).then_some(offset)
    }

    fn is_news(&mut self, damaged_at: u64) -> bool {
        self.damaged_at.replace(damaged_at) != Some(damaged_at)
    }

    /// Reads the next record, or returns `None` at the end of the data. The channel of a message has come
    /// before it. After an error other than [`RecordingError::Damaged`], no records follow.
    pub(crate) fn next(&mut self) -> Result<Option<ReadRecord<'_>>, RecordingError> {
        while !self.is_over {
            match self.next_place() {
                Ok(Some((kind, content))) => {
                    return Ok(Some((kind, self.bytes(content), &self.definitions)));
                }
                Err(RecordingError::Damaged { offset, .. }) if !self.is_news(offset) => {}
                Err(error @ RecordingError::Damaged { .. }) => {
                    // It may have hit definitions.
                    if !self.has_index {
                        self.read_index()?;
                    }
                    return Err(error);
                }
                Err(error) => {
                    self.is_over = true;
                    return Err(error);
                }
                Ok(None) => {
                    self.is_over = true;
                    let is_unread = self.chunk_bytes.compressions.is_empty();
                    if let Some(compression) = self.unknown.take().filter(|_| is_unread) {
                        return Err(RecordingError::Compressed { compression });
                    }
                }
            }
        }
        Ok(None)
    }

    /// Bytes of a range of the open chunk, or else of the latest record of the file.
    fn bytes(&self, range: Range<usize>) -> &[u8] {
        match self.chunk.decompressed.is_empty() {
            true => self.window.bytes(range),
            false => self.chunk.decompressed.get(range).unwrap_or_default(),
        }
    }

    fn next_place(&mut self) -> Result<Option<Place>, RecordingError> {
        if self.window.offset == 0 && self.used == 0 {
            let magic = self.window.peek(MAGIC.len())?;
            let magic = magic.get(..MAGIC.len()).unwrap_or(magic);
            if !MAGIC.starts_with(magic) {
                return self.find_first_record();
            }
            self.used = magic.len();
        }
        loop {
            if let Some(place) = self.next_in_chunk()? {
                return Ok(Some(place));
            }
            self.window.advance(std::mem::take(&mut self.used));
            self.leave_out()?;
            if self.window.peek(1)?.is_empty() {
                return Ok(self.end_early());
            }
            let extent = self.extent()?;
            let length = extent.end.min(MAX_CHUNK_BYTES + RECORD_HEAD as u64) as usize;
            let is_more = match extent.kind {
                // Without its lengths.
                _ if extent.is_endless() => false,
                kind::CHUNK => self.open_chunk(length)?,
                kind::DATA_END | kind::FOOTER => {
                    if !self.end(&extent, length)? {
                        return Ok(None);
                    }
                    true
                }
                kind::HEADER..=kind::MESSAGE | kind::METADATA => {
                    return self.record(&extent, length);
                }
                _ => self.window.skip(extent.end)?,
            };
            if !is_more {
                return Ok(self.end_early());
            }
        }
    }

    /// Measures the record here. Fails if its head is wrong.
    fn extent(&mut self) -> Result<Extent, RecordingError> {
        let Some(extent) = self.window.measure()? else {
            return self.resynchronise(WRONG_HEAD);
        };
        if extent.kind == kind::MESSAGE || extent.is_chunk {
            self.has_chunks.get_or_insert(extent.is_chunk);
        }
        let next = if extent.is_proved() { extent.end } else { self.next_start(&extent)? };
        if next < extent.end {
            let error = self.damaged(WRONG_HEAD);
            self.used = next as usize;
            return Err(error);
        }
        Ok(extent)
    }

    /// Reads the record here, which has `length` bytes if the file was not cut off.
    fn record(&mut self, extent: &Extent, length: usize) -> Result<Option<Place>, RecordingError> {
        if self.window.peek(length)?.len() < length {
            return Ok(self.end_early());
        }
        let content = RECORD_HEAD..extent.fields as usize;
        if extent.kind == kind::MESSAGE
            && self.has_chunks == Some(true)
            && is_message_index(self.window.bytes(content.clone()))
        {
            return self.resynchronise(WRONG_HEAD);
        }
        if !is_well_formed(extent.kind, self.window.bytes(content.clone())) {
            // Its length may come from its damaged fields.
            let error = self.damaged("a record is malformed");
            match self.window.begins(extent.end, |_| true)? {
                true => self.used = length,
                false => self.find_record()?,
            }
            return Err(error);
        }
        if extent.kind == kind::MESSAGE {
            // A file with a message outside of chunks has no compressed ones: it was no chunk.
            self.unknown = None;
        }
        self.used = length;
        self.define(extent.kind, &content)?;
        Ok(Some((extent.kind, content)))
    }

    /// Remembers a definition. Fails for a message whose channel no earlier record has defined.
    fn define(&mut self, kind: u8, content: &Range<usize>) -> Result<(), RecordingError> {
        let mut definitions = std::mem::take(&mut self.definitions);
        let content = self.bytes(content.clone());
        let wrong = match kind {
            kind::SCHEMA | kind::CHANNEL if !definitions.define(kind, content) => {
                Some("the definitions have more than 64 MiB")
            }
            kind::MESSAGE if !Fields(content).u16().is_some_and(|id| definitions.accept(id)) => {
                Some("the channel of a message is not defined")
            }
            _ => None,
        };
        self.definitions = definitions;
        wrong.map_or(Ok(()), |reason| Err(self.damaged(reason)))
    }

    /// Reads the record here, which ends the data of a file. If another file follows, skips to it and returns true.
    fn end(&mut self, extent: &Extent, length: usize) -> Result<bool, RecordingError> {
        // The damaged kind of another record. Definitions may follow the end of the data, but no footer.
        let known = self.window.peek(length + 1)?.len();
        let kinds = if extent.kind == kind::FOOTER { is_known } else { is_data };
        if known > length && self.window.begins(extent.end, kinds)? {
            return self.resynchronise(WRONG_HEAD);
        }
        if extent.kind == kind::DATA_END && self.has_wrong_checksum() {
            return Err(self.damaged("the checksum of the file is wrong"));
        }
        let is_whole = self.is_end_whole(extent)?;
        // The same, with damage or definitions after it.
        if !is_whole && extent.kind == kind::DATA_END && !extent.is_proved() {
            self.definitions.doubt_later();
            self.used = length.min(known);
            return Err(self.damaged(WRONG_HEAD));
        }
        self.is_truncated |= !is_whole;
        Ok(!is_whole && self.skip_to_joined()?)
    }

    /// Returns where the record after this one begins, counted from here.
    fn next_start(&mut self, extent: &Extent) -> Result<u64, RecordingError> {
        let known = self.window.peek(extent.end.min(MAX_CHUNK_BYTES) as usize)?.len() as u64;
        next_start(extent, known, |at| {
            let kinds = match at {
                _ if at == 0 || at == extent.end => |_| true,
                _ if at == 1 && self.has_chunks != Some(true) || at == extent.fields => is_known,
                _ => self.kinds_to_find()?,
            };
            // The last bytes of a message may look like an end of the data with more fields.
            let is_end = (2..extent.end).contains(&at)
                && self.window.bytes(0..at as usize + 1).ends_with(&[kind::DATA_END]);
            Ok(self.window.begins(at, kinds)? && !is_end)
        })
    }

    /// Kinds of records to search for after damage. In a file with chunks, others may lie in a chunk
    /// with a damaged head, where no checksum proves them. Which file it is shows the first chunk or
    /// message, or else what lies as far ahead as one chunk reaches.
    fn kinds_to_find(&mut self) -> Result<Kinds, RecordingError> {
        let mut at = 1;
        while self.has_chunks.is_none() {
            let kinds = |kind| matches!(kind, kind::CHUNK | kind::MESSAGE_INDEX);
            let is_shown = self.window.is_shown(at, kinds)?;
            at += 1;
            let is_end = at > MAX_CHUNK_BYTES || (self.window.peek(at as usize)?.len() as u64) < at;
            self.has_chunks = (is_shown || is_end).then_some(is_shown);
        }
        Ok(if self.has_chunks == Some(true) { outside_chunks } else { is_known })
    }

    /// If the next record lies in an unwanted part, continues after that part. If no record begins there, the
    /// file has lost or gained bytes since its index was written: then leaves out nothing.
    fn leave_out(&mut self) -> Result<(), RecordingError> {
        let here = self.window.offset;
        while let Some(part) = self.unwanted.front().cloned()
            && part.start <= self.window.offset
        {
            self.unwanted.pop_front();
            if part.contains(&self.window.offset) {
                self.window.continue_at(part.end)?;
                if !self.window.begins(0, outside_chunks)? {
                    self.unwanted.clear();
                    return self.window.continue_at(here);
                }
            }
        }
        Ok(())
    }

    /// Returns true if the file has another checksum than the one in the record here, which covers
    /// all bytes before it. Not checked after damage, nor in a file with chunks, which have their
    /// own: mcap 0.26.0 writes a wrong one if its chunks have none.
    fn has_wrong_checksum(&mut self) -> bool {
        let told = Fields(self.window.bytes(RECORD_HEAD..RECORD_HEAD + 4)).u32();
        let found = self.window.checksum.take().map(crc32fast::Hasher::finalize);
        self.has_chunks != Some(true) && found.is_some() && told != Some(0) && told != found
    }

    /// Skips to the first record of a file that does not begin like MCAP. Fails if there is none nearby: a
    /// few damaged bytes do not make another kind of file.
    fn find_first_record(&mut self) -> Result<Option<Place>, RecordingError> {
        let error = self.damaged("the file does not begin with the magic bytes of MCAP");
        let bytes = self.window.peek(READ_BYTES)?.get(MAGIC.len()..).unwrap_or_default();
        // A search needs more: the name of a profile, or undamaged records after the header.
        if records_of(bytes).next().is_some_and(|(kind, _)| kind == kind::HEADER) {
            self.used = MAGIC.len();
        } else if !self.window.skip_to(is_known, MAX_CHUNK_BYTES)? {
            return Err(RecordingError::NotMcap);
        }
        Err(error)
    }

    /// Skips to the next record, or to the end of the file.
    fn resynchronise<T>(&mut self, reason: &'static str) -> Result<T, RecordingError> {
        let error = self.damaged(reason);
        self.find_record()?;
        Err(error)
    }

    fn find_record(&mut self) -> Result<(), RecordingError> {
        let kinds = self.kinds_to_find()?;
        self.window.skip_to(kinds, u64::MAX).map(drop)
    }

    fn damaged(&mut self, reason: &'static str) -> RecordingError {
        self.window.checksum = None;
        RecordingError::Damaged { offset: self.window.offset, reason }
    }

    fn end_early<T>(&mut self) -> Option<T> {
        self.is_truncated = true;
        None
    }
}
