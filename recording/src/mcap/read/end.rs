//! Checks a file's end: its summary, and the footer that has the position of the summary.

use super::{FileError, Sections};
use crate::mcap::form::record_head;
use crate::mcap::{FILE_END, FOOTER_BYTES, Fields, MAGIC, RECORD_HEAD, kind};

/// Fields of a footer.
struct Footer {
    /// Positions in the file of the summary and of the offsets at its end, or 0.
    summary: u64,
    offsets: u64,
    /// Checksum of the summary and of the footer up to here, or 0.
    crc: u32,
}

impl Footer {
    fn parse(record: &[u8]) -> Option<Self> {
        let mut fields = Fields(record.get(RECORD_HEAD..)?);
        let (summary, offsets) = (fields.u64()?, fields.u64()?);
        Some(Self { summary, offsets, crc: fields.u32()? })
    }

    /// Checks the positions, if the data ends at `start` and the footer is at `end`.
    fn is_at(&self, start: u64, end: u64) -> bool {
        let is_inside = (start..=end).contains(&self.offsets);
        (self.summary == start || self.summary == 0) && (is_inside || self.offsets == 0)
    }
}

impl Sections {
    /// Reads the end of the file, starting at the end of its data. Returns true if other
    /// readers can find the messages with it: the summary is where the footer says, its
    /// checksum is right if it has one, and nothing follows.
    pub(super) fn is_end_whole(&mut self) -> Result<bool, FileError> {
        let data_end = self.peek(RECORD_HEAD)?;
        if data_end.first() == Some(&kind::DATA_END) && !self.skip(RECORD_HEAD as u64 + 4)? {
            return Ok(false);
        }
        let start = self.offset;
        let mut summary = crc32fast::Hasher::new();
        loop {
            let head = self.peek(FILE_END + 1)?;
            let Some((kind, length)) = record_head(head) else { return Ok(false) };
            if kind != kind::FOOTER {
                let length = length.saturating_add(RECORD_HEAD as u64);
                if !self.skip_with(length, |bytes| summary.update(bytes))? {
                    return Ok(false);
                }
                continue;
            }
            let Some(checked) = head.get(..RECORD_HEAD + FOOTER_BYTES - 4) else {
                return Ok(false);
            };
            summary.update(checked);
            let is_last = length == FOOTER_BYTES as u64 && head.len() == FILE_END;
            let is_whole = is_last && head.ends_with(&MAGIC);
            let footer = Footer::parse(head).filter(|_| is_whole);
            let is_right = |footer: Footer| {
                footer.is_at(start, self.offset)
                    && (footer.crc == 0 || footer.crc == summary.finalize())
            };
            return Ok(footer.is_some_and(is_right));
        }
    }

    /// Skips the footer here and the magic bytes after it if another file begins there, as
    /// after `cat a.mcap b.mcap`. Such a file has no complete end: no index covers both.
    pub(super) fn skip_to_joined(&mut self) -> Result<bool, FileError> {
        const JOINED: usize = FILE_END + MAGIC.len();
        let bytes = self.peek(JOINED)?.get(..JOINED).unwrap_or_default();
        let is_footer = record_head(bytes) == Some((kind::FOOTER, FOOTER_BYTES as u64));
        let magics = bytes.get(RECORD_HEAD + FOOTER_BYTES..).unwrap_or_default();
        Ok(is_footer && magics == [MAGIC, MAGIC].concat() && self.skip(JOINED as u64)?)
    }
}
