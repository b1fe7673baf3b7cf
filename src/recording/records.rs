//! The records of an MCAP file one after the other, those in chunks included,
//! as far as the file goes. Knows nothing of what is in them.
//!
//! The crate that writes recordings can read them, too, but gives nothing of a
//! chunk that is cut short, or else panics on a damaged one.

use std::io::{self, BufReader, Read};
use std::ops::Range;
use std::sync::Arc;

use mcap::MAGIC;
use mcap::records::op;

use super::RecordingError;

/// What no chunk or record of a recording comes near.
const LONGEST: u64 = 256 << 20;
/// Of a chunk's header, what stands before the name of its compression: start,
/// end, size, CRC.
const BEFORE_COMPRESSION: usize = 8 + 8 + 8 + 4;

/// Reads records.
pub(super) struct Records {
    input: BufReader<Box<dyn Read + Send>>,
    /// The chunk or the record that is being read.
    buffer: Vec<u8>,
    /// What of the buffer is in records that were not given out yet.
    rest: Range<usize>,
    started: bool,
    truncated: bool,
}

impl Records {
    pub(super) fn new(input: impl Read + Send + 'static) -> Self {
        let input: Box<dyn Read + Send> = Box::new(input);
        Self {
            input: BufReader::with_capacity(64 << 10, input),
            buffer: Vec::new(),
            rest: 0..0,
            started: false,
            truncated: false,
        }
    }

    /// Whether the file ended before its end.
    pub(super) fn is_truncated(&self) -> bool {
        self.truncated
    }

    /// The next record: its kind and its content. `None` at the end of the
    /// data; an error is the last thing that it gives.
    pub(super) fn next(&mut self) -> Result<Option<(u8, &[u8])>, RecordingError> {
        if !self.started {
            self.started = true;
            let magic = self.fill(MAGIC.len() as u64)?;
            if !MAGIC.starts_with(&self.buffer) {
                return Err(RecordingError::NotMcap);
            }
            if !magic {
                return Ok(self.end_early());
            }
        }
        loop {
            if let Some((kind, content, end)) = split(&self.buffer, self.rest.clone()) {
                self.rest.start = end;
                return Ok(self.buffer.get(content).map(|content| (kind, content)));
            }
            if !self.rest.is_empty() && !self.truncated {
                return Err(damaged("a chunk ends in the middle of a record"));
            }
            if self.truncated || !self.fill(9)? {
                return Ok(self.end_early());
            }
            let Some((&kind, &length)) = self
                .buffer
                .split_first()
                .and_then(|(kind, rest)| Some((kind, rest.first_chunk()?)))
            else {
                return Ok(self.end_early());
            };
            let length = u64::from_le_bytes(length);
            if length > LONGEST {
                return Err(damaged("a record is too long"));
            }
            let whole = self.fill(length)?;
            self.truncated = !whole;
            match kind {
                op::CHUNK => self.rest = self.chunk()?,
                op::DATA_END => return Ok(None),
                _ if whole => return Ok(Some((kind, &self.buffer))),
                _ => {}
            }
        }
    }

    /// Where the records of the chunk in the buffer are.
    fn chunk(&self) -> Result<Range<usize>, RecordingError> {
        let header = || {
            let crc = self.buffer.get(24..BEFORE_COMPRESSION)?.first_chunk()?;
            let rest = self.buffer.get(BEFORE_COMPRESSION..)?;
            let compression = usize::try_from(u32::from_le_bytes(*rest.first_chunk()?)).ok()?;
            let size = rest.get(compression.checked_add(4)?..)?.first_chunk()?;
            let start = BEFORE_COMPRESSION + 4 + compression + 8;
            Some((u32::from_le_bytes(*crc), compression, u64::from_le_bytes(*size), start))
        };
        let (crc, compression, size, start) = match header() {
            Some(header) => header,
            None if self.truncated => return Ok(0..0),
            None => return Err(damaged("a chunk has no header")),
        };
        if compression > 0 {
            return Err(damaged("it is compressed, which this crate's recordings are not"));
        }
        let size = usize::try_from(size).unwrap_or(usize::MAX);
        let records = start..start.saturating_add(size).min(self.buffer.len());
        // What is cut short cannot be checked.
        if !self.truncated {
            let sum = self.buffer.get(records.clone()).map(crc32fast::hash);
            if records.len() != size || crc != 0 && sum != Some(crc) {
                return Err(damaged("a chunk's checksum is wrong"));
            }
        }
        Ok(records)
    }

    /// Reads so many bytes into the buffer, in place of what was there. False if
    /// the file has less.
    fn fill(&mut self, count: u64) -> Result<bool, RecordingError> {
        self.buffer.clear();
        self.rest = 0..0;
        let read = self.input.by_ref().take(count).read_to_end(&mut self.buffer);
        let read =
            read.map_err(|error: io::Error| RecordingError::Read { source: Arc::new(error) })?;
        Ok(read as u64 == count)
    }

    fn end_early<T>(&mut self) -> Option<T> {
        self.truncated = true;
        None
    }
}

/// The first record in `range`: its kind, where its content is, where it ends.
fn split(buffer: &[u8], range: Range<usize>) -> Option<(u8, Range<usize>, usize)> {
    let (&kind, rest) = buffer.get(range.clone())?.split_first()?;
    let length = usize::try_from(u64::from_le_bytes(*rest.first_chunk()?)).ok()?;
    let start = range.start + 9;
    let end = start.checked_add(length).filter(|end| *end <= range.end)?;
    Some((kind, start..end, end))
}

fn damaged(reason: &str) -> RecordingError {
    RecordingError::Damaged { reason: reason.to_owned() }
}
