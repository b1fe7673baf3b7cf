//! The index at the end of a file. With a complete one, later parts can be read without the ones before.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::{Range, RangeInclusive};

use super::form::records_of;
use super::{FILE_END, FOOTER_BYTES, Fields, MAX_INDEX_BYTES, RECORD_HEAD, kind};

/// Reads the records of the index at the end of a file. Returns none if the index is incomplete, or if
/// the file is a pipe. Reading then continues where it was.
pub(super) fn read_index(file: &mut File) -> io::Result<Vec<u8>> {
    // A pipe has no position.
    let Ok(here) = file.stream_position() else { return Ok(Vec::new()) };
    let index = index(file).unwrap_or_default();
    file.seek(SeekFrom::Start(here))?;
    Ok(index)
}

/// Lists the parts of a file, in their order, that contain only chunks without a message at these
/// times (nanoseconds since 1970), by its index.
pub(super) fn parts_outside(index: &[u8], times: &RangeInclusive<u64>) -> Vec<Range<u64>> {
    let outside = |(kind, content): (u8, &[u8])| {
        let (place, first, last) = chunk(content).filter(|_| kind == kind::CHUNK_INDEX)?;
        (last < *times.start() || first > *times.end()).then_some(place)
    };
    let mut chunks: Vec<_> = records_of(index).filter_map(outside).collect();
    chunks.sort_unstable_by_key(|place| place.start);
    let mut parts: Vec<Range<u64>> = Vec::new();
    for chunk in chunks {
        match parts.last_mut() {
            // Only chunks that follow each other directly, so that everything between two chunks is read.
            Some(part) if part.end == chunk.start => part.end = chunk.end,
            _ => parts.push(chunk),
        }
    }
    parts
}

/// Reads the index at the end of a file. Returns `None` if it is incomplete, or has no
/// checksum to prove it: a wrong position would leave out wanted records.
fn index(file: &mut File) -> Option<Vec<u8>> {
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
    (checked.finalize() == crc).then_some(index)
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
