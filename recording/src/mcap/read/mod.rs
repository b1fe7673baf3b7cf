//! [`Sections`]: reads a file from its beginning to wherever it ends, one chunk at a time.
//! Finds the next record after a damaged one. Leaves out unwanted parts if the file's index
//! lists them.
//!
//! Believes no length until it agrees with another one or with the existing bytes. So the
//! file, and a chunk of it, bound the memory.

mod end;

use std::collections::VecDeque;
use std::ops::Range;

use super::compression::decompress;
use super::form::{
    ChunkHead, Extent, Kinds, chunk_head, is_known, is_message_index, is_well_formed, next_start,
    outside_chunks,
};
use super::input::FileIndex;
use super::window::Window;
use super::{ChunkBytes, Compression, Fields, Input, MAGIC, MAX_CHUNK_BYTES, RECORD_HEAD, kind};
use crate::RecordingError;

/// Reason for damage.
const WRONG_HEAD: &str = "a record's kind or length is wrong";

/// Part of a file. Ranges index into [`Sections::bytes`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Section {
    /// A record outside of chunks.
    Record { kind: u8, content: Range<usize> },
    /// Records of a chunk without compression, perhaps the beginning of one at the end of a cut-off
    /// file. They are proved by a checksum if the chunk is whole and has one.
    Chunk { records: Range<usize>, is_cut: bool, is_proved: bool },
}

/// Kinds of records that no summary has.
fn is_data(kind: u8) -> bool {
    matches!(
        kind,
        kind::MESSAGE | kind::CHUNK | kind::MESSAGE_INDEX | kind::ATTACHMENT | kind::METADATA
    )
}

/// Reads the parts of a file up to its summary.
#[derive(Default)]
pub(super) struct Sections {
    window: Window,
    /// Records of the latest section if it is a compressed chunk, else empty.
    decompressed: Vec<u8>,
    /// Bytes of the chunks so far.
    pub(super) chunk_bytes: ChunkBytes,
    /// Name of the latest compression that this build does not read.
    unknown: Option<String>,
    /// Length of the latest section.
    used: usize,
    /// Set once the file is known to have chunks, or none.
    has_chunks: Option<bool>,
    /// Parts of the file to leave out.
    pub(super) unwanted: VecDeque<Range<u64>>,
    is_started: bool,
    is_over: bool,
    /// True if the end of the file is missing, once it was read.
    pub(super) is_truncated: bool,
}

impl Sections {
    pub(super) fn new(input: Input) -> Self {
        Self { window: Window::new(input), ..Self::default() }
    }

    /// Position of the latest section in the file.
    pub(super) fn offset(&self) -> u64 {
        self.window.offset
    }

    /// Bytes of a range of the latest section.
    pub(super) fn bytes(&self, range: Range<usize>) -> &[u8] {
        match self.decompressed.is_empty() {
            true => self.window.bytes(range),
            false => self.decompressed.get(range).unwrap_or_default(),
        }
    }

    /// Reads the index at the end of the file, which is empty if the file has none.
    pub(super) fn index(&mut self) -> Result<FileIndex, RecordingError> {
        self.window.input.index().map_err(|error| {
            self.is_over = true;
            RecordingError::read(error)
        })
    }

    /// Reads the next section, or returns `None` at the end of the data. After an error
    /// other than [`RecordingError::Damaged`], no sections follow.
    pub(super) fn next(&mut self) -> Result<Option<Section>, RecordingError> {
        if self.is_over {
            return Ok(None);
        }
        self.decompressed.clear();
        let mut section = self.section();
        if matches!(section, Ok(None)) && self.chunk_bytes.compressions.is_empty() {
            let compression = self.unknown.take();
            section = compression
                .map_or(section, |compression| Err(RecordingError::Compressed { compression }));
        }
        self.is_over = !matches!(section, Ok(Some(_)) | Err(RecordingError::Damaged { .. }));
        section
    }

    fn section(&mut self) -> Result<Option<Section>, RecordingError> {
        if !self.is_started {
            self.is_started = true;
            let magic = self.window.peek(MAGIC.len())?;
            let magic = magic.get(..MAGIC.len()).unwrap_or(magic);
            if !MAGIC.starts_with(magic) {
                return self.find_first_record();
            }
            self.used = magic.len();
        }
        loop {
            self.window.advance(std::mem::take(&mut self.used));
            self.leave_out()?;
            if self.window.peek(1)?.is_empty() {
                return Ok(self.end_early());
            }
            let extent = self.extent()?;
            let length = extent.end.min(MAX_CHUNK_BYTES + RECORD_HEAD as u64) as usize;
            match extent.kind {
                // Without its lengths.
                _ if extent.fields == u64::MAX => return Ok(self.end_early()),
                kind::CHUNK => return self.chunk(length),
                kind::DATA_END | kind::FOOTER => {
                    if !self.end(&extent, length)? {
                        return Ok(None);
                    }
                }
                kind::HEADER..=kind::MESSAGE | kind::METADATA => {
                    return self.record(&extent, length);
                }
                _ => {
                    if !self.window.skip_with(extent.end, |_| {})? {
                        return Ok(self.end_early());
                    }
                }
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
        let next = self.next_start(&extent)?;
        if next < extent.end {
            let error = self.damaged(WRONG_HEAD);
            self.used = next as usize;
            return Err(error);
        }
        Ok(extent)
    }

    /// Reads the record here, which has `length` bytes if the file was not cut off.
    fn record(
        &mut self,
        extent: &Extent,
        length: usize,
    ) -> Result<Option<Section>, RecordingError> {
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
        Ok(Some(Section::Record { kind: extent.kind, content }))
    }

    /// Reads the record here, which ends the data of a file. If another file follows, skips to it and
    /// returns true.
    fn end(&mut self, extent: &Extent, length: usize) -> Result<bool, RecordingError> {
        // The damaged kind of another record.
        let is_last = self.window.peek(length + 1)?.len() <= length;
        if !is_last && self.window.begins(extent.end, is_data)? {
            return self.resynchronise(WRONG_HEAD);
        }
        if extent.kind == kind::DATA_END && self.has_wrong_checksum() {
            return Err(self.damaged("the checksum of the file is wrong"));
        }
        let is_whole = self.is_end_whole(extent)?;
        // The same, with damage after it.
        if !is_whole && extent.kind == kind::DATA_END && !extent.is_proved() {
            let error = self.damaged(WRONG_HEAD);
            if !self.window.begins(0, is_data)? {
                self.find_record()?;
            }
            return Err(error);
        }
        self.is_truncated |= !is_whole;
        let is_joined = self.skip_to_joined()?;
        if is_joined {
            self.has_chunks = None;
        }
        Ok(is_joined)
    }

    /// Returns where the record after this one begins, counted from here.
    fn next_start(&mut self, extent: &Extent) -> Result<u64, RecordingError> {
        let known = match extent.is_proved() {
            true => 0,
            false => self.window.peek(extent.end.min(MAX_CHUNK_BYTES) as usize)?.len() as u64,
        };
        next_start(extent, known, |at| {
            let is_chunked = self.has_chunks == Some(true);
            let kinds = match at {
                _ if at == extent.end => {
                    if is_chunked && !extent.is_chunk {
                        outside_chunks
                    } else {
                        |_| true
                    }
                }
                _ if at == 1 || at == extent.fields => is_known,
                _ => self.kinds_to_find()?,
            };
            self.window.begins(at, kinds)
        })
    }

    /// Kinds of records to search for after damage. In a file with chunks, others may lie in a chunk
    /// with a damaged head, where no checksum proves them. Which file it is shows the first chunk or
    /// message, or else what lies as far ahead as one chunk reaches.
    fn kinds_to_find(&mut self) -> Result<Kinds, RecordingError> {
        let mut at = 1;
        while self.has_chunks.is_none() {
            if self.window.is_shown(at, |kind| matches!(kind, kind::CHUNK | kind::MESSAGE_INDEX))? {
                self.has_chunks = Some(true);
            } else if at == MAX_CHUNK_BYTES || self.window.peek(at as usize + 1)?.len() as u64 <= at
            {
                self.has_chunks = Some(false);
            }
            at += 1;
        }
        Ok(if self.has_chunks == Some(true) { outside_chunks } else { is_known })
    }

    /// If the next record lies in an unwanted part, continues after that part. If no record
    /// begins there, the file has lost or gained bytes since its index was written: then
    /// leaves out nothing.
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

    /// Reads the chunk here, whose record has `length` bytes if the file was not cut off.
    fn chunk(&mut self, length: usize) -> Result<Option<Section>, RecordingError> {
        let bytes = self.window.peek(length)?;
        self.used = length.min(bytes.len());
        let found = self.used;
        let Some(head) = chunk_head(bytes) else { return Ok(self.end_early()) };
        let is_whole = found >= head.records.end;
        let records = if head.compression.is_empty() {
            let end = head.records.end.min(found);
            head.records.start.min(end)..end
        } else {
            self.decompress(&head, is_whole)?;
            0..self.decompressed.len()
        };
        self.has_chunks = Some(true);
        self.chunk_bytes.add(
            &head.compression,
            found - head.records.start.min(found),
            records.len(),
        );
        // A chunk that is cut short cannot be checked.
        self.is_truncated |= !is_whole;
        let is_proved = is_whole && head.crc != 0;
        if is_proved && crc32fast::hash(self.bytes(records.clone())) != head.crc {
            return Err(self.damaged("a chunk's checksum is wrong"));
        }
        Ok(Some(Section::Chunk { records, is_cut: !is_whole, is_proved }))
    }

    /// Decompresses the chunk here.
    fn decompress(&mut self, head: &ChunkHead, is_whole: bool) -> Result<(), RecordingError> {
        let compressed = head.records.start..self.used.min(head.records.end);
        let compressed = self.window.bytes(compressed);
        match decompress(&head.compression, compressed, head.size, &mut self.decompressed) {
            None => Err(self.unknown_compression(&head.compression)),
            Some(Err(reason)) if is_whole => Err(self.damaged(reason)),
            Some(_) => Ok(()),
        }
    }

    /// Error of a chunk with a compression that this build does not read. The name may be damaged: then
    /// no other chunk has it.
    fn unknown_compression(&mut self, name: &str) -> RecordingError {
        let is_compressed = |known: &Compression| *known != Compression::Plain;
        let has_known = self.chunk_bytes.compressions.iter().any(is_compressed);
        let is_second = self.unknown.replace(name.to_owned()).as_deref() == Some(name);
        match Compression::named(name).is_some() || is_second && !has_known {
            true => RecordingError::Compressed { compression: name.to_owned() },
            false => self.damaged("a chunk has an unknown compression"),
        }
    }

    /// Returns true if the file has another checksum than the one in the record here, which covers
    /// all bytes before it. Not checked after damage, nor in a file with chunks, which have their
    /// own: mcap 0.26.0 writes a wrong one if its chunks have none.
    fn has_wrong_checksum(&mut self) -> bool {
        let told = Fields(self.window.bytes(RECORD_HEAD..RECORD_HEAD + 4)).u32();
        let found = self.window.checksum.take().map(crc32fast::Hasher::finalize);
        self.has_chunks != Some(true) && found.is_some() && told != Some(0) && told != found
    }

    /// Skips to the first record of a file that does not begin like MCAP. Fails if there is
    /// none nearby: a few damaged bytes do not make another kind of file.
    fn find_first_record(&mut self) -> Result<Option<Section>, RecordingError> {
        let error = self.damaged("the file does not begin with the magic bytes of MCAP");
        let is_first = |kind| {
            is_known(kind) && !matches!(kind, kind::MESSAGE | kind::MESSAGE_INDEX | kind::DATA_END)
        };
        match self.window.skip_to(is_first, MAX_CHUNK_BYTES)? {
            true => Err(error),
            false => Err(RecordingError::NotMcap),
        }
    }

    /// Skips to the next record, or to the end of the file.
    fn resynchronise<T>(&mut self, reason: &'static str) -> Result<T, RecordingError> {
        let error = self.damaged(reason);
        self.find_record()?;
        Err(error)
    }

    fn find_record(&mut self) -> Result<(), RecordingError> {
        let is_stray = self.window.begins(1, is_known)?;
        let kinds = self.kinds_to_find()?;
        match is_stray {
            true => self.used = 1,
            false => drop(self.window.skip_to(kinds, u64::MAX)?),
        }
        Ok(())
    }

    pub(super) fn damaged(&mut self, reason: &'static str) -> RecordingError {
        self.window.checksum = None;
        RecordingError::Damaged { offset: self.window.offset, reason }
    }

    fn end_early<T>(&mut self) -> Option<T> {
        self.is_truncated = true;
        None
    }
}
