//! [`Window`]: the bytes of a file around the position of its reader.

use std::any::Any;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;

use crc32fast::Hasher;

use super::MAGIC;
use super::form::{After, Extent, Kinds, begins, is_shown, measure};
use crate::RecordingError;

/// Number of bytes to read at once.
pub(super) const READ_BYTES: usize = 64 << 10;

/// Part of a file that is in memory: from the reader's position on.
pub(super) struct Window {
    input: Box<dyn Read + Send>,
    /// The same file, unless it can only be read forwards.
    pub(super) file: Option<File>,
    /// Bytes of the file, used up to `start`.
    bytes: Vec<u8>,
    start: usize,
    /// Position of `start` in the file.
    pub(super) offset: u64,
    /// Checksum of the file up to here, unless parts of it were left out.
    pub(super) checksum: Option<Hasher>,
}

impl Default for Window {
    fn default() -> Self {
        Self::new(io::empty())
    }
}

impl Window {
    /// Knows a file by its type.
    pub(super) fn new(input: impl Read + Send + 'static) -> Self {
        let file = (&input as &dyn Any).downcast_ref::<File>();
        let file = file.and_then(|file| file.try_clone().ok());
        let (input, checksum) = (Box::new(input), Some(Hasher::new()));
        Self { input, file, bytes: Vec::new(), start: 0, offset: 0, checksum }
    }

    /// Reads ahead: at least `count` bytes, unless the file has fewer.
    pub(super) fn peek(&mut self, count: usize) -> Result<&[u8], RecordingError> {
        if self.bytes.len().saturating_sub(self.start) < count {
            self.bytes.drain(..self.start);
            self.start = 0;
            // Grows with the existing bytes, not with the claimed ones. Takes what a pipe has, and
            // does not wait for more.
            while self.bytes.len() < count && self.read_more().map_err(RecordingError::read)? {}
        }
        Ok(self.bytes.get(self.start..).unwrap_or_default())
    }

    /// Reads up to [`READ_BYTES`]. Returns false at the end of the input.
    fn read_more(&mut self) -> io::Result<bool> {
        let known = self.bytes.len();
        self.bytes.resize(known + READ_BYTES, 0);
        let read = loop {
            match self.input.read(self.bytes.get_mut(known..).unwrap_or_default()) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                read => break read,
            }
        };
        self.bytes.truncate(known + *read.as_ref().unwrap_or(&0));
        Ok(read? > 0)
    }

    /// Bytes that were read ahead, counted from here.
    pub(super) fn bytes(&self, range: Range<usize>) -> &[u8] {
        self.bytes.get(self.start..).and_then(|bytes| bytes.get(range)).unwrap_or_default()
    }

    /// Goes forward over bytes that were read ahead.
    pub(super) fn advance(&mut self, count: usize) {
        if let Some(mut checksum) = self.checksum.take() {
            checksum.update(self.bytes(0..count));
            self.checksum = Some(checksum);
        }
        self.start += count;
        self.offset += count as u64;
    }

    /// Skips bytes. Returns false if the file has fewer.
    pub(super) fn skip(&mut self, length: u64) -> Result<bool, RecordingError> {
        let mut rest = length;
        while rest > 0 {
            let next = rest.min(READ_BYTES as u64) as usize;
            if self.peek(next)?.len() < next {
                return Ok(false);
            }
            self.advance(next);
            rest -= next as u64;
        }
        Ok(true)
    }

    /// Continues at this position of the file.
    pub(super) fn continue_at(&mut self, place: u64) -> Result<(), RecordingError> {
        let file = self.file.as_mut().ok_or(io::ErrorKind::NotSeekable.into());
        file.and_then(|file| file.seek(SeekFrom::Start(place))).map_err(RecordingError::read)?;
        self.bytes.clear();
        (self.start, self.offset, self.checksum) = (0, place, None);
        Ok(())
    }

    /// Measures the record here, or returns `None` if no record begins here.
    pub(super) fn measure(&mut self) -> Result<Option<Extent>, RecordingError> {
        self.decide(measure)
    }

    /// Returns true if a record of these kinds begins `at` bytes from here.
    pub(super) fn begins(&mut self, at: u64, kinds: Kinds) -> Result<bool, RecordingError> {
        self.decide(|bytes, after| begins(bytes, after, at, kinds))
    }

    /// The same if the record shows it, whatever follows.
    pub(super) fn is_shown(&mut self, at: u64, kinds: Kinds) -> Result<bool, RecordingError> {
        self.decide(|bytes, after| is_shown(bytes, after, at, kinds))
    }

    /// Reads ahead until enough bytes are known to judge them.
    fn decide<T>(
        &mut self,
        decision: impl Fn(&[u8], After) -> Result<T, usize>,
    ) -> Result<T, RecordingError> {
        let mut wanted = 1;
        loop {
            let bytes = self.peek(wanted)?;
            let after = match bytes.len() < wanted {
                true if bytes.ends_with(&MAGIC) => After::Magic,
                true => After::End,
                false => After::More,
            };
            match decision(bytes, after) {
                Ok(outcome) => return Ok(outcome),
                Err(more) => wanted = more,
            }
        }
    }

    /// Skips to the next record of these kinds, or to the end of the file. Returns true if there is
    /// one before `limit`, a position in the file.
    pub(super) fn skip_to(&mut self, kinds: Kinds, limit: u64) -> Result<bool, RecordingError> {
        // Nothing begins at the first byte.
        let mut at = 1;
        while self.offset < limit {
            let known = self.peek(at + 1)?.len();
            let is_end = known <= at;
            let is_here = !is_end && self.begins(at as u64, kinds)?;
            if is_end || is_here {
                self.advance(at.min(known));
                return Ok(is_here);
            }
            at += 1;
            if at == READ_BYTES {
                self.advance(at);
                at = 0;
            }
        }
        Ok(false)
    }
}
