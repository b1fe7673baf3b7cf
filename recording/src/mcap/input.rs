//! [`Input`]: the bytes of a recording. In a file with a complete index, later parts can be
//! read without the parts before them.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;

use super::form::split_record;
use super::{FILE_END, FOOTER_BYTES, Fields, RECORD_HEAD, kind};

/// Longest index to read. The longest that this crate writes has 7 MB.
const MAX_INDEX_BYTES: u64 = 16 << 20;

/// Bytes of a recording, in order.
pub(in super::super) enum Input {
    File(File),
    /// Anything that can only be read forwards.
    Stream(Box<dyn Read + Send>),
}

impl Input {
    /// Continues at this position of the file.
    pub(super) fn continue_at(&mut self, place: u64) -> io::Result<()> {
        match self {
            Self::File(file) => file.seek(SeekFrom::Start(place)).map(drop),
            Self::Stream(_) => Err(io::ErrorKind::NotSeekable.into()),
        }
    }

    /// Reads the index at the end of the file. Returns an empty one if the index is
    /// incomplete, or if this is not a file. Reading then continues where it was.
    pub(super) fn index(&mut self) -> io::Result<FileIndex> {
        let Self::File(file) = self else { return Ok(FileIndex::default()) };
        // A pipe has no position.
        let Ok(here) = file.stream_position() else { return Ok(FileIndex::default()) };
        let index = index(file).unwrap_or_default();
        self.continue_at(here)?;
        Ok(index)
    }
}

/// Records of the index at the end of a file.
#[derive(Default)]
pub(in super::super) struct FileIndex(Vec<u8>);

impl FileIndex {
    /// Lists the parts of the file, in their order, that contain only chunks with messages
    /// before `time` (nanoseconds since 1970).
    pub(super) fn parts_before(&self, time: u64) -> Vec<Range<u64>> {
        let before = |content: &[u8]| chunk(content).filter(|(_, last)| *last < time);
        let chunks = self.records().filter(|(kind, _)| *kind == kind::CHUNK_INDEX);
        let chunks = chunks.filter_map(|(_, content)| before(content));
        let mut chunks: Vec<_> = chunks.map(|(place, _)| place).collect();
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

    /// Message types and channels, which the index repeats: kind and content of each.
    pub(in super::super) fn definitions(&self) -> impl Iterator<Item = (u8, &[u8])> {
        self.records().filter(|(kind, _)| matches!(*kind, kind::SCHEMA | kind::CHANNEL))
    }

    fn records(&self) -> impl Iterator<Item = (u8, &[u8])> {
        let mut rest = self.0.as_slice();
        std::iter::from_fn(move || {
            let (kind, content, after) = split_record(rest)?;
            rest = after;
            Some((kind, content))
        })
    }
}

impl Read for Input {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::File(file) => file.read(bytes),
            Self::Stream(stream) => stream.read(bytes),
        }
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
    if length > MAX_INDEX_BYTES {
        return None;
    }
    file.seek(SeekFrom::Start(start)).ok()?;
    let mut index = Vec::new();
    file.take(length).read_to_end(&mut index).ok()?;
    // The checksum covers the footer up to itself, so the rest needs no check.
    let mut checked = crc32fast::Hasher::new();
    checked.update(&index);
    checked.update(footer.get(..RECORD_HEAD + FOOTER_BYTES - 4)?);
    (checked.finalize() == crc).then_some(FileIndex(index))
}

/// Parses a chunk's index: its position, including the lists of its messages, and the time
/// of its last message.
fn chunk(content: &[u8]) -> Option<(Range<u64>, u64)> {
    let mut fields = Fields(content);
    let (_first, last) = (fields.u64()?, fields.u64()?);
    let (start, length) = (fields.u64()?, fields.u64()?);
    let (_places, lists) = (fields.bytes()?, fields.u64()?);
    let end = start.checked_add(length)?.checked_add(lists)?;
    Some((start..end, last))
}

#[cfg(test)]
mod tests {
    use super::super::{MAGIC, put_record};
    use super::*;

    /// Index entry of a chunk at `start`, with 10 bytes and 5 bytes of lists.
    fn entry(start: u64, last: u64) -> Vec<u8> {
        let mut record = vec![kind::CHUNK_INDEX];
        let mut content = Vec::new();
        for field in [0, last, start, 10_u64] {
            content.extend_from_slice(&field.to_le_bytes());
        }
        content.extend_from_slice(&[0; 4]);
        content.extend_from_slice(&5_u64.to_le_bytes());
        content.extend_from_slice(&[0; 4 + 16]);
        record.extend_from_slice(&(content.len() as u64).to_le_bytes());
        record.extend_from_slice(&content);
        record
    }

    #[test]
    fn chunks_that_touch_are_one_part_and_what_is_between_others_is_read() {
        let index = [entry(40, 2), entry(10, 1), entry(25, 1), entry(60, 3), entry(80, 9)].concat();
        let index = FileIndex(index);
        assert_eq!(index.parts_before(4), [10..55, 60..75]);
        assert_eq!(index.parts_before(1), []);
    }

    /// The checksum is right, but the memory for it is limited all the same.
    #[test]
    fn an_index_of_16_mib_is_read_and_none_that_is_longer() {
        let path = std::env::temp_dir().join(format!("scip-index-{}", std::process::id()));
        let longest = MAX_INDEX_BYTES as usize;
        for (length, is_read) in [(longest, true), (longest + 1, false)] {
            // The whole file is its index.
            let mut bytes = vec![0; length];
            put_record(&mut bytes, kind::FOOTER, |out| out.extend_from_slice(&[0; 16]));
            let crc = crc32fast::hash(&bytes);
            bytes.extend_from_slice(&crc.to_le_bytes());
            bytes.extend_from_slice(&MAGIC);
            std::fs::write(&path, &bytes).unwrap();
            let found = index(&mut File::open(&path).unwrap());
            assert_eq!(found.map(|index| index.0.len()), is_read.then_some(length));
        }
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn an_index_of_no_sense_leaves_nothing_out() {
        let mut wide = entry(u64::MAX - 3, 1);
        assert_eq!(FileIndex(wide.clone()).parts_before(4), []);
        wide.truncate(30);
        assert_eq!(FileIndex(wide.clone()).parts_before(4), []);
        assert_eq!(FileIndex(vec![0xff; 100]).parts_before(4), []);
    }
}
