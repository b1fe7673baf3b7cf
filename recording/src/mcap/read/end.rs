//! Checks a file's end: its summary, and the footer that has the position of the summary.

use super::{Records, is_data};
use crate::RecordingError;
use crate::mcap::form::{Extent, record_head};
use crate::mcap::{FILE_END, FOOTER_BYTES, Fields, MAGIC, MAX_CHUNK_BYTES, RECORD_HEAD, kind};

impl Records {
    /// Reads the end of the file, starting at the record that ends its data. Returns true if other readers can find
    /// the messages with it: the summary is where the footer says, its checksum is right if it has one, and nothing
    /// follows. Stays before what may be data: also at a record whose lengths do not prove that it ends the data.
    pub(super) fn is_end_whole(&mut self, data_end: &Extent) -> Result<bool, RecordingError> {
        let window = &mut self.window;
        let mut at = if data_end.kind == kind::DATA_END { data_end.end } else { 0 };
        let (start, mut summary) = (window.offset + at, crc32fast::Hasher::new());
        // Otherwise a hostile file with many such records is read again after each of them.
        if !data_end.is_proved() && start <= self.no_end {
            return Ok(false);
        }
        loop {
            self.no_end = window.offset + at;
            if data_end.is_proved() && !window.skip(std::mem::take(&mut at))? {
                return Ok(false);
            }
            let bytes = window.peek(at as usize + RECORD_HEAD)?;
            let head = record_head(bytes.get(at as usize..).unwrap_or_default());
            let Some((_, length)) = head.filter(|(kind, _)| *kind != kind::FOOTER) else { break };
            let end = length.saturating_add(at + RECORD_HEAD as u64);
            let known = window.peek(end.min(MAX_CHUNK_BYTES) as usize)?.len() as u64;
            if known < end || window.begins(at, is_data)? {
                return Ok(false);
            }
            summary.update(window.bytes(at as usize..end as usize));
            at = end;
        }
        let end = window.peek(at as usize + FILE_END + 1)?.get(at as usize..).unwrap_or_default();
        let is_last = end.len() == FILE_END && end.ends_with(&MAGIC);
        let (content, crc) = end.split_at(end.len().min(RECORD_HEAD + FOOTER_BYTES - 4));
        summary.update(content);
        let (mut fields, crc) = (Fields(content.get(1..).unwrap_or_default()), Fields(crc).u32());
        let (length, at) = (fields.u64(), fields.u64());
        // A position of 0 means that there is none, and a checksum of 0 that it is not known.
        let is_right = (at == Some(start) || at == Some(0))
            && (crc == Some(0) || crc == Some(summary.finalize()));
        Ok(is_last && length == Some(FOOTER_BYTES as u64) && is_right)
    }

    /// Skips the footer here and the magic bytes after it if another file begins there, as
    /// after `cat a.mcap b.mcap`. Such a file has no complete end: no index covers both.
    pub(super) fn skip_to_joined(&mut self) -> Result<bool, RecordingError> {
        const JOINED: usize = FILE_END + MAGIC.len();
        let bytes = self.window.peek(JOINED)?.get(..JOINED).unwrap_or_default();
        if !bytes.ends_with(&[MAGIC, MAGIC].concat()) {
            return Ok(false);
        }
        (self.window.checksum, self.has_chunks) = (None, None);
        self.window.skip(JOINED as u64)
    }
}
