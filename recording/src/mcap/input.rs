//! [`Input`]: the bytes of a recording. In a file with a complete index, later parts can be
//! read without the parts before them.

use std::any::Any;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::{Range, RangeInclusive};

use super::form::{After, is_well_formed, measure, record_head};
use super::{FILE_END, FOOTER_BYTES, Fields, MAX_INDEX_BYTES, RECORD_HEAD, kind};

/// Bytes of a recording, in order.
pub(crate) struct Input {
    pub(super) bytes: Box<dyn Read + Send>,
    /// The same file, unless it can only be read forwards.
    file: Option<File>,
}

impl Default for Input {
    fn default() -> Self {
        Self::new(io::empty())
    }
}

impl Input {
    /// Knows a file by its type.
    pub(crate) fn new(input: impl Read + Send + 'static) -> Self {
        let file = (&input as &dyn Any).downcast_ref::<File>();
        let file = file.and_then(|file| file.try_clone().ok());
        Self { bytes: Box::new(input), file }
    }

    /// Continues at this position of the file.
    pub(super) fn continue_at(&mut self, place: u64) -> io::Result<()> {
        let file = self.file.as_mut().ok_or(io::ErrorKind::NotSeekable)?;
        file.seek(SeekFrom::Start(place)).map(drop)
    }

    /// Reads the index at the end of the file. Returns an empty one if the index is
    /// incomplete, or if this is not a file. Reading then continues where it was.
    pub(super) fn index(&mut self) -> io::Result<FileIndex> {
        let Some(file) = &mut self.file else { return Ok(FileIndex::default()) };
        // A pipe has no position.
        let Ok(here) = file.stream_position() else { return Ok(FileIndex::default()) };
        let index = index(file).unwrap_or_default();
        self.continue_at(here)?;
        Ok(index)
    }
}

/// Records of the index at the end of a file.
#[derive(Default)]
pub(crate) struct FileIndex {
    records: Vec<u8>,
    /// Position of the next record for [`next_definition`](Self::next_definition).
    at: usize,
}

impl FileIndex {
    /// Lists the parts of the file, in their order, that contain only chunks without a message at
    /// these times (nanoseconds since 1970).
    pub(super) fn parts_outside(&self, times: &RangeInclusive<u64>) -> Vec<Range<u64>> {
        let outside = |content: &[u8]| {
            let (place, first, last) = chunk(content)?;
            (last < *times.start() || first > *times.end()).then_some(place)
        };
        let (mut at, mut chunks) = (0, Vec::new());
        while let Some((kind, content)) = self.record(at) {
            at = content.end;
            if kind == kind::CHUNK_INDEX {
                chunks.extend(outside(self.bytes(content)));
            }
        }
        chunks.sort_unstable_by_key(|place| place.start);
        let mut parts: Vec<Range<u64>> = Vec::new();
        for chunk in chunks {
            match parts.last_mut() {
                // Only chunks that follow each other directly, so that everything between
                // two chunks is read.
                Some(part) if part.end == chunk.start => part.end = chunk.end,
                _ => parts.push(chunk),
            }
        }
        parts
    }

    /// Returns the next of the schemas and channels, which the index repeats: its kind, and the
    /// place of its content.
    pub(super) fn next_definition(&mut self) -> Option<(u8, Range<usize>)> {
        loop {
            let (kind, content) = self.record(self.at)?;
            let start = std::mem::replace(&mut self.at, content.end);
            let record = self.bytes(start..content.end);
            let Ok(extent) = measure(record, After::End) else { continue };
            let fields = content.start..start + extent.fields as usize;
            if matches!(kind, kind::SCHEMA | kind::CHANNEL)
                && is_well_formed(kind, self.bytes(fields.clone()))
            {
                return Some((kind, fields));
            }
        }
    }

    pub(super) fn bytes(&self, place: Range<usize>) -> &[u8] {
        self.records.get(place).unwrap_or_default()
    }

    /// Returns the kind of the record at this position, and the place of its content.
    fn record(&self, at: usize) -> Option<(u8, Range<usize>)> {
        let (kind, length) = record_head(self.records.get(at..)?)?;
        let start = at + RECORD_HEAD;
        let end = start.checked_add(usize::try_from(length).ok()?)?;
        (end <= self.records.len()).then_some((kind, start..end))
    }
}

/// Reads the index at the end of a file. Returns `None` if it is incomplete, or has no
/// checksum to prove it: a wrong position would leave out wanted records.
fn index(file: &mut File) -> Option<FileIndex> {
    let end = file.seek(SeekFrom::End(0)).ok()?.checked_sub(FILE_END as u64)?;
    file.seek(SeekFrom::Start(end)).ok()?;
    let mut footer = [0; FILE_END];
    file.read_exact(&mut footer).ok()?;
    let mut fields = Fields(footer.get(RECORD_HEAD..)?);
    let (start, _offsets, crc) = (fields.u64()?, fields.u64()?, fields.u32()?);
    let length = end.checked_sub(start)?;
    if length > MAX_INDEX_BYTES as u64 {
        return None;
    }
    file.seek(SeekFrom::Start(start)).ok()?;
    let mut index = Vec::new();
    file.take(length).read_to_end(&mut index).ok()?;
    // The checksum covers the footer up to itself, so the rest needs no check.
    let mut checked = crc32fast::Hasher::new();
    checked.update(&index);
    checked.update(footer.get(..RECORD_HEAD + FOOTER_BYTES - 4)?);
    (checked.finalize() == crc).then_some(FileIndex { records: index, at: 0 })
}

/// Parses a chunk's index: its position, including the lists of its messages, and the times
/// of its first and last message.
fn chunk(content: &[u8]) -> Option<(Range<u64>, u64, u64)> {
    let mut fields = Fields(content);
    let (first, last) = (fields.u64()?, fields.u64()?);
    let (start, length) = (fields.u64()?, fields.u64()?);
    let (_places, lists) = (fields.bytes()?, fields.u64()?);
    let end = start.checked_add(length)?.checked_add(lists)?;
    Some((start..end, first, last))
}
