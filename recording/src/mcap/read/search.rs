//! Searches for the next chunk after a damaged part.

use super::{DATA_END_HEAD, FileError, MAX_CHUNK_HEAD, READ_BYTES, Section, Sections, chunk_head};
use crate::mcap::{MAX_CHUNK_BYTES, kind};

impl Sections {
    /// Skips to the first chunk of a file that does not begin like MCAP. Fails if there is
    /// no chunk nearby: a few damaged bytes do not make another kind of file.
    pub(super) fn find_first_chunk(&mut self) -> Result<Option<Section>, FileError> {
        let error = self.damaged("the file does not begin with the magic bytes of MCAP");
        let is_chunk =
            |rest: &[u8]| rest.first() == Some(&kind::CHUNK) && chunk_head(rest).is_some();
        match self.skip_to(is_chunk, MAX_CHUNK_BYTES)? {
            true => Err(error),
            false => Err(FileError::NotMcap),
        }
    }

    /// Skips to the next chunk, or to the end of the data.
    pub(super) fn resynchronise(
        &mut self,
        reason: &'static str,
    ) -> Result<Option<Section>, FileError> {
        let error = self.damaged(reason);
        self.find_chunk()?;
        Err(error)
    }

    /// Skips to the next chunk or the end of the data, or to the end of the file if it has neither.
    pub(super) fn find_chunk(&mut self) -> Result<bool, FileError> {
        self.skip_to(
            |rest| match rest.first() {
                Some(&kind::CHUNK) => chunk_head(rest).is_some(),
                Some(&kind::DATA_END) => rest.starts_with(&DATA_END_HEAD),
                _ => false,
            },
            u64::MAX,
        )
    }

    /// Skips to the next later position where `is_wanted` is true of the following bytes,
    /// or to the end of the file. Returns true if there is one before `limit`, a position
    /// in the file.
    fn skip_to(
        &mut self,
        is_wanted: impl Fn(&[u8]) -> bool,
        limit: u64,
    ) -> Result<bool, FileError> {
        // Nothing begins at the first byte.
        self.used = 1;
        while self.offset < limit {
            self.drop_used();
            let bytes = self.peek(READ_BYTES)?;
            let is_here = |at: &usize| is_wanted(bytes.get(*at..).unwrap_or_default());
            let next = (0..bytes.len()).find(is_here);
            let is_end = bytes.len() < READ_BYTES;
            self.used = match next {
                Some(next) => next,
                // The next call finds the end of the file.
                None if is_end => bytes.len(),
                // A head may begin in the bytes read so far and end after them.
                None => bytes.len().saturating_sub(MAX_CHUNK_HEAD),
            };
            if next.is_some() || is_end {
                return Ok(next.is_some());
            }
        }
        Ok(false)
    }
}
