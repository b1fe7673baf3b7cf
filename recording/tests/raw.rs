//! Recordings made by hand, byte by byte: what this crate's writer never writes.

use std::io::Cursor;

use urg_recording::{Record, Recording, RecordingError};

pub(super) const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// Makes a record that claims this length.
pub(super) fn record(kind: u8, length: u64, content: &[u8]) -> Vec<u8> {
    [&[kind][..], &length.to_le_bytes(), content].concat()
}

/// Makes the fields of a chunk: times, size, CRC, compression, length of its records.
pub(super) fn chunk(size: u64, records: u64) -> Vec<u8> {
    let (size, records) = (size.to_le_bytes(), records.to_le_bytes());
    [&[0; 16][..], &size, &[0; 4], &[0; 4], &records].concat()
}

/// Makes the length field of a string or a map.
pub(super) fn claims(length: u32) -> [u8; 4] {
    length.to_le_bytes()
}

/// Returns the length, then the text.
pub(super) fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
}

/// Makes a record of this content.
pub(super) fn of_kind(kind: u8, content: &[u8]) -> Vec<u8> {
    record(kind, content.len() as u64, content)
}

/// Makes a chunk without a checksum.
pub(super) fn chunk_of(records: &[u8]) -> Vec<u8> {
    let length = records.len() as u64;
    of_kind(0x06, &[&chunk(length, length), records].concat())
}

/// Makes the record of channel 0, which has events.
pub(super) fn channel() -> Vec<u8> {
    of_kind(0x04, &channel_content(0, "/scip/events"))
}

/// Makes the content of the record of a channel.
pub(super) fn channel_content(number: u8, topic: &str) -> Vec<u8> {
    [&[number, 0, 0, 0][..], &text(topic), &text("cdr"), &[0; 4]].concat()
}

/// Makes the metadata of a recording at 10 Hz.
pub(super) fn metadata() -> Vec<u8> {
    let pair = [text("rate"), text("10 Hz")].concat();
    let content = [&text("tokio_scip")[..], &claims(pair.len() as u32), &pair].concat();
    of_kind(0x0c, &content)
}

/// Makes an event on a channel.
pub(super) fn event(channel: u8) -> Vec<u8> {
    let data = [&[0, 1, 0, 0][..], &text("{\"event\":\"reconnected\"}\0")].concat();
    of_kind(0x05, &[&[channel][..], &[0; 21], &data].concat())
}

/// Makes the end of a file without an index.
pub(super) fn end() -> Vec<u8> {
    [of_kind(0x0f, &[0; 4]), of_kind(0x02, &[0; 20]), MAGIC.to_vec()].concat()
}

/// Returns the places of the damaged parts, the number of records, and whether the end of
/// the file is missing.
pub(super) fn read(file: &[u8]) -> (Vec<u64>, usize, bool) {
    let mut recording = Recording::read(Cursor::new(file.to_vec())).unwrap();
    let items: Vec<_> = recording.by_ref().collect();
    let damaged = damaged_at(&items);
    let records = items.len() - damaged.len();
    (damaged, records, recording.is_truncated())
}

/// Returns the places of the damaged parts.
pub(super) fn damaged_at(items: &[Result<Record, RecordingError>]) -> Vec<u64> {
    let place = |item: &Result<Record, RecordingError>| match item {
        Err(RecordingError::Damaged { offset, .. }) => Some(*offset),
        Err(error) => panic!("{error:?}"),
        Ok(_) => None,
    };
    items.iter().filter_map(place).collect()
}
