//! Reads a chunk, and the records in it.

use std::ops::Range;

use super::{Place, Records};
use crate::RecordingError;
use crate::mcap::compression::decompress;
use crate::mcap::form::{
    After, ChunkHead, begins, chunk_head, is_known, is_well_formed, measure, next_start,
};
use crate::mcap::{Compression, RECORD_HEAD};

/// Chunk whose records are being read.
#[derive(Default)]
pub(super) struct ChunkRecords {
    /// Records of a compressed chunk, else empty.
    pub(super) decompressed: Vec<u8>,
    /// Records that were not returned yet.
    rest: Range<usize>,
    /// True at the end of a cut-off file.
    is_cut: bool,
    /// True if a checksum proves the records.
    is_proved: bool,
}

impl Records {
    /// Reads the chunk here, whose record has `length` bytes if the file was not cut off. Returns false
    /// if it was cut off within the head of the chunk.
    pub(super) fn open_chunk(&mut self, length: usize) -> Result<bool, RecordingError> {
        let bytes = self.window.peek(length)?;
        self.used = length.min(bytes.len());
        let found = self.used;
        let Some(head) = chunk_head(bytes) else { return Ok(false) };
        let is_whole = found >= head.records.end;
        let records = if head.compression.is_empty() {
            let end = head.records.end.min(found);
            head.records.start.min(end)..end
        } else {
            self.decompress(&head, is_whole)?;
            0..self.chunk.decompressed.len()
        };
        let stored = found - head.records.start.min(found);
        self.chunk_bytes.add(&head.compression, stored, records.len());
        // A chunk that is cut short cannot be checked.
        let is_proved = is_whole && head.crc != 0;
        if is_proved && crc32fast::hash(self.bytes(records.clone())) != head.crc {
            return Err(self.damaged("a chunk's checksum is wrong"));
        }
        (self.chunk.rest, self.chunk.is_cut, self.chunk.is_proved) =
            (records, !is_whole, is_proved);
        Ok(true)
    }

    fn decompress(&mut self, head: &ChunkHead, is_whole: bool) -> Result<(), RecordingError> {
        let compressed = head.records.start..self.used.min(head.records.end);
        let compressed = self.window.bytes(compressed);
        match decompress(&head.compression, compressed, head.size, &mut self.chunk.decompressed) {
            None => Err(self.unknown_compression(&head.compression)),
            Some(Err(reason)) if is_whole => Err(self.damaged(reason)),
            Some(_) => Ok(()),
        }
    }

    /// Error of a chunk with a compression that this build does not read. The name may be damaged: then
    /// the next such chunk has another one.
    fn unknown_compression(&mut self, name: &str) -> RecordingError {
        let is_second = self.unknown.replace(name.to_owned()).as_deref() == Some(name);
        match Compression::named(name).is_some() || is_second {
            true => RecordingError::Compressed { compression: name.to_owned() },
            false => self.damaged("a chunk has an unknown compression"),
        }
    }

    /// Returns the next record of the open chunk, or `None` at its end.
    pub(super) fn next_in_chunk(&mut self) -> Result<Option<Place>, RecordingError> {
        while !self.chunk.rest.is_empty() {
            let rest = std::mem::take(&mut self.chunk.rest);
            let bytes = self.bytes(rest.clone());
            let known = bytes.len() as u64;
            let extent = measure(bytes, After::End).ok().flatten();
            let begins = |at, kinds| begins(bytes, After::End, at, kinds);
            let next = match &extent {
                Some(extent) if self.chunk.is_proved || extent.is_proved() => extent.end,
                Some(extent) => {
                    let kinds = |at| if at == 0 { |_| true } else { is_known };
                    next_start(extent, known, |at| begins(at, kinds(at))).unwrap_or(known)
                }
                None => (1..known).find(|at| begins(*at, is_known) == Ok(true)).unwrap_or(known),
            };
            let start = usize::try_from(next).unwrap_or(usize::MAX).saturating_add(rest.start);
            self.chunk.rest = start.min(rest.end)..rest.end;
            match extent {
                Some(extent) if next == extent.end && next <= known => {
                    let content = rest.start + RECORD_HEAD..rest.start + extent.fields as usize;
                    if !is_well_formed(extent.kind, self.bytes(content.clone())) {
                        return Err(self.damaged("a record is malformed"));
                    }
                    let defined = self.define(extent.kind, &content);
                    // The error makes the index known: then it is read again.
                    if defined.is_err() && !self.has_index {
                        self.chunk.rest.start = rest.start;
                    }
                    defined?;
                    return Ok(Some((extent.kind, content)));
                }
                Some(extent) if next == extent.end && self.chunk.is_cut => {}
                _ => return Err(self.damaged("a record in a chunk has a wrong length")),
            }
        }
        self.chunk.decompressed.clear();
        Ok(None)
    }
}
