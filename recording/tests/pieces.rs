//! Recordings whose records begin and end where a read of 64 KiB does.

use std::io::{self, Cursor, Read};

use urg_recording::{Recording, RecordingError};

use super::raw::{MAGIC, channel, chunk_of, end, event, of_kind, read, record};

/// Bytes that are read at once.
const READ_BYTES: usize = 64 << 10;

/// Makes a record that readers skip and that ends `before` bytes before the end of the
/// first read, if `start` bytes are before it.
fn filler(start: usize, before: usize) -> Vec<u8> {
    let length = READ_BYTES - before - start - 9;
    let data = length - 16 - 4 - 4 - 8 - 4;
    // An attachment without a name and a type.
    of_kind(0x09, &[&[0; 24][..], &(data as u64).to_le_bytes(), &vec![0; data + 4]].concat())
}

#[test]
fn the_head_of_a_chunk_may_lie_across_two_reads() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    for before in 0..80 {
        let file = [MAGIC, &filler(8, before), &chunk, &chunk, &end()].concat();
        assert_eq!(read(&file), (vec![], 2, false), "{before} bytes before");
    }
}

/// Reader that a signal has interrupted, once.
struct Interrupted(bool);

impl Read for Interrupted {
    fn read(&mut self, _: &mut [u8]) -> io::Result<usize> {
        if std::mem::take(&mut self.0) { Err(io::ErrorKind::Interrupted.into()) } else { Ok(0) }
    }
}

#[test]
fn an_interrupted_read_continues() {
    let start = [MAGIC, &channel(), &event(0)].concat();
    let input = Cursor::new(start).chain(Interrupted(true)).chain(Cursor::new(event(0)));
    assert_eq!(Recording::read(input).unwrap().filter(Result::is_ok).count(), 2);
}

#[test]
fn the_name_of_a_compression_may_lie_across_two_reads() {
    let head = [&[0; 16][..], &30_u64.to_le_bytes(), &[0; 4], &[4, 0, 0, 0], b"lzip"].concat();
    let chunk = of_kind(0x06, &[&head[..], &9_u64.to_le_bytes(), &[0; 9]].concat());
    for before in 0..80 {
        let file = [MAGIC, &filler(8, before), &chunk].concat();
        let error = Recording::read(Cursor::new(file)).unwrap_err();
        let RecordingError::Compressed { compression } = error else { panic!("{error:?}") };
        assert_eq!(compression, "lzip", "{before} bytes before");
    }
}

#[test]
fn the_end_of_a_file_may_lie_across_two_reads() {
    let data = [chunk_of(&[channel(), event(0)].concat()), of_kind(0x0f, &[0; 4])].concat();
    for before in 0..50 {
        // Other programs' summaries have records of their own.
        let length = READ_BYTES - before - 8 - data.len() - 9;
        let filler = of_kind(0x80, &vec![0; length]);
        let footer = of_kind(0x02, &[0; 20]);
        let file = [MAGIC, &data, &filler, &footer, MAGIC].concat();
        assert_eq!(read(&file), (vec![], 1, false), "{before} bytes before");
        assert_eq!(read(&file[..file.len() - 1]), (vec![], 1, true), "{before} bytes before");
    }
}

#[test]
fn metadata_may_lie_across_two_reads_or_end_with_one() {
    let metadata = of_kind(0x0c, &[&[1, 0, 0, 0, b'x'][..], &[0; 4]].concat());
    let chunk = chunk_of(&[channel(), event(0)].concat());
    for before in 0..40 {
        let file = [MAGIC, &filler(8, before), &metadata, &chunk, &end()].concat();
        assert_eq!(read(&file), (vec![], 1, false), "{before} bytes before");
    }
}

/// The search for the next chunk goes on where a read ends, also in the middle of its head.
#[test]
fn a_chunk_after_long_damage_is_found() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    let shortest = 2 * READ_BYTES - 80;
    for length in (shortest..shortest + 80).chain([5 * READ_BYTES]) {
        let file = [MAGIC, &vec![0; length], &chunk, &chunk, &end()].concat();
        assert_eq!(read(&file), (vec![8], 2, false), "{length} bytes");
    }
    // Exactly one read follows the first damaged byte.
    for before in 0..80 {
        let damaged = vec![0; READ_BYTES + 1 - before];
        let file = [MAGIC, &filler(8, 1), &damaged, &chunk, &chunk, &end()].concat();
        let place = READ_BYTES as u64 - 1;
        assert_eq!(read(&file), (vec![place], 2, false), "{before} bytes before");
    }
}

#[test]
fn a_record_of_any_length_is_skipped_whole() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    for length in [0, 1, READ_BYTES - 9, READ_BYTES, 2 * READ_BYTES - 9, 10 * READ_BYTES] {
        for kind in [0x80, 0xff] {
            let skipped = of_kind(kind, &vec![6; length]);
            let file = [MAGIC, &skipped, &chunk, &skipped, &end()].concat();
            assert_eq!(read(&file), (vec![], 1, false), "{length} bytes of kind {kind}");
        }
    }
    // Of a longer one the file has only the beginning.
    let file = [MAGIC, &chunk, &record(0x80, 1 << 40, &[0; 100])].concat();
    assert_eq!(read(&file), (vec![], 1, true));
}
