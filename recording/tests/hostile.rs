//! Hostile files: reading one takes no more memory than its own size.

use std::fs::{self, File};
use std::io::{self, Cursor};
use std::path::Path;

use urg_recording::{Recording, RecordingError, repair};

use super::raw::{
    MAGIC, channel, channel_content, chunk, chunk_of, claims, damaged_at, end, event, metadata,
    of_kind, read, record, text,
};

#[test]
fn a_hostile_length_takes_no_memory() {
    const G4: u64 = 4 << 30;
    // The file, and the number of its damaged parts.
    let cases = [
        ("a header's string of 4 GB", record(0x01, 4, &claims(u32::MAX)), 1),
        ("a header of 4 GB", record(0x01, G4 + 4, &claims(u32::MAX)), 1),
        ("a short attachment", record(0x09, 24, &[0; 24]), 1),
        ("an attachment of 2^48", record(0x09, 1 << 48, &[0; 24]), 0),
        ("an attachment that no disk can hold", record(0x09, (1 << 48) + 1, &[0; 24]), 1),
        ("a record of 2^48", record(0x05, 1 << 48, &[0; 24]), 1),
        ("a private record of 2^48", record(0x80, 1 << 48, &[0; 24]), 0),
        ("a private record that no file can have", record(0x80, u64::MAX, &[0; 24]), 1),
        ("a chunk of 4 GB", record(0x06, 40 + G4, &chunk(G4, G4)), 1),
        ("a chunk of 32 MB", record(0x06, 40 + (32 << 20), &chunk(32 << 20, 32 << 20)), 0),
        ("a chunk whose records claim 4 GB", record(0x06, 40, &chunk(0, G4)), 1),
        ("a chunk that becomes 4 GB", record(0x06, 40, &chunk(G4, 0)), 1),
        ("a chunk of 40 bytes with 4 GB in it", record(0x06, 40, &chunk(G4, G4)), 1),
        (
            "a record of 2^63 in a chunk",
            record(0x06, 49, &[chunk(9, 9), record(0x05, 1 << 63, &[])].concat()),
            1,
        ),
        (
            "a map of 4 GB",
            record(0x0c, 18, &[&claims(10)[..], b"tokio_scip", &claims(u32::MAX)].concat()),
            1,
        ),
        // An empty name and an empty map, then six bytes of a later version's fields.
        ("a record cut off behind its fields", record(0x0c, 20, &[0; 14]), 0),
        (
            "a message index of 4 GB",
            record(0x07, G4, &[&[0; 2][..], &claims(u32::MAX)].concat()),
            1,
        ),
        ("a schema of 4 GB", record(0x03, 6, &[&[0; 2][..], &claims(u32::MAX)].concat()), 1),
        ("an end of the data of 1 MB", record(0x0f, 1 << 20, &[0; 5]), 1),
        ("a record of an unknown kind", record(0x00, 0, &[]), 1),
        ("zeros", vec![0; 1000], 1),
    ];
    for (name, bytes, errors) in cases {
        let file = [MAGIC, &bytes].concat();
        let most = file.len() as u64;
        let counted = allocation_counter::measure(|| {
            let mut recording = Recording::read(Cursor::new(file.clone())).unwrap();
            let items: Vec<_> = recording.by_ref().collect();
            assert_eq!(damaged_at(&items), vec![8; errors], "{name}: {items:?}");
            assert_eq!((items.len(), recording.is_truncated()), (errors, true), "{name}");
            let mut out = Vec::new();
            let outcome = repair(Cursor::new(file), &mut out).unwrap();
            assert_eq!(outcome.damaged_at, vec![8; errors], "{name}");
            assert!(outcome.was_truncated, "{name}");
            assert!(Recording::read(Cursor::new(out)).unwrap().next().is_none(), "{name}");
        });
        let (bytes, most) = (counted.bytes_max, 400_000 + 4 * most);
        assert!(bytes < most, "{name}: {bytes} bytes in memory");
    }
}

#[test]
fn a_compressed_recording_is_reported_as_such() {
    // 30 bytes, in 9.
    let head = [&[0; 16][..], &30u64.to_le_bytes(), &[0; 4], &claims(3), b"lzo"].concat();
    let chunk = of_kind(0x06, &[&head[..], &9u64.to_le_bytes(), &[0; 9]].concat());
    // Also if more chunks follow than `read` searches.
    for count in [1, 300] {
        let file = [MAGIC, &chunk.repeat(count)].concat();
        let error = Recording::read(Cursor::new(file)).unwrap_err();
        let RecordingError::Compressed { compression } = &error else { panic!("{error:?}") };
        assert_eq!(compression, "lzo");
        assert!(error.to_string().contains("`lzo`"), "{error}");
    }
}

#[test]
fn an_unreadable_compression_is_explained() {
    let text = |compression: &str| {
        RecordingError::Compressed { compression: compression.to_owned() }.to_string()
    };
    for compression in ["zstd", "lz4"] {
        let text = text(compression);
        assert!(text.contains(compression) && text.contains("feature `compression`"), "{text}");
        assert!(text.contains("mcap decompress"), "{text}");
    }
    assert!(text("lzo").contains("expected `zstd`, `lz4` or no compression"));
}

/// As some writers end each chunk, also an empty one.
#[test]
fn a_chunk_without_records_costs_nothing() {
    let full = chunk_of(&[channel(), event(0)].concat());
    let names: &[&str] = if cfg!(feature = "compression") { &["", "lz4", "zstd"] } else { &[""] };
    for name in names {
        let empty = of_kind(0x06, &[&[0; 28][..], &text(name), &[0; 8]].concat());
        for parts in [[&empty, &full, &full], [&full, &empty, &full], [&full, &full, &empty]] {
            let file = [MAGIC, &parts.map(Vec::as_slice).concat(), &end()].concat();
            assert_eq!(read(&file), (vec![], 2, false), "{name}");
        }
    }
}

/// A definition of a later version before the first message asks whether the file has chunks.
#[cfg(feature = "compression")]
#[test]
fn an_empty_chunk_makes_no_file_with_chunks() {
    let empty = of_kind(0x06, &[&[0; 28][..], &text("zstd"), &[0; 8]].concat());
    let (channel, events) = (more(&channel(), &[1; 12]), event(0).repeat(4));
    let parts = [&channel[..], &events, &[0; 25], &events, &empty, &events, &end()];
    assert_eq!(repaired(&[MAGIC, &parts.concat()]).0, 12);
}

#[test]
fn a_malformed_record_is_reported_and_left_out() {
    for (name, malformed) in [
        ("a map of no pairs", of_kind(0x0c, &[text("tokio_scip"), text("pair")].concat())),
        ("a map of 4 GB", of_kind(0x0c, &[&text("tokio_scip")[..], &claims(u32::MAX)].concat())),
        ("a short schema", of_kind(0x03, &[0; 4])),
        ("a schema without a number", of_kind(0x03, &[0; 14])),
        ("a short message", of_kind(0x05, &[0; 21])),
    ] {
        let records = [channel(), event(0), malformed, event(0)].concat();
        let file = [MAGIC, &chunk_of(&records), &end()].concat();
        let mut repaired = Vec::new();
        let outcome = repair(Cursor::new(file.clone()), &mut repaired).unwrap();
        assert_eq!((outcome.was_truncated, outcome.damaged_at), (false, vec![8]), "{name}");
        assert_eq!(read(&file), (vec![8], 2, false), "{name}");
        assert_eq!(read(&repaired), (vec![], 2, false), "{name}");
        assert_eq!(mcap::MessageStream::new(&repaired).unwrap().count(), 2, "{name}");
    }
}

#[test]
fn a_malformed_header_is_not_copied() {
    let profile = of_kind(0x01, &[text("ros2"), text("caf\u{e9}")].concat());
    let latin1 = of_kind(0x01, &[&text("ros2")[..], &claims(4), b"caf\xe9"].concat());
    for (header, damaged) in [(profile, vec![]), (latin1, vec![8])] {
        let file = [MAGIC, &header, &chunk_of(&[channel(), event(0)].concat()), &end()].concat();
        let mut repaired = Vec::new();
        let outcome = repair(Cursor::new(file), &mut repaired).unwrap();
        assert_eq!((outcome.messages, outcome.damaged_at), (1, damaged));
        assert_eq!(mcap::MessageStream::new(&repaired).unwrap().count(), 1);
    }
}

#[test]
fn a_message_without_a_channel_is_damage() {
    let first = [MAGIC, &chunk_of(&[channel(), event(0)].concat())].concat();
    let second = chunk_of(&[event(3), event(0), event(3)].concat());
    let file = [&first[..], &second, &end()].concat();
    assert_eq!(read(&file), (vec![first.len() as u64], 2, false));
}

/// Damage that is not seen may have hit its channel, which the index repeats.
#[test]
fn the_index_defines_the_channel_of_the_first_message() {
    let (lost, chunk) = (of_kind(0x7f, &[0; 99]), chunk_of(&event(0).repeat(3)));
    let (data, channel) = ([MAGIC, &lost, &chunk, &of_kind(0x0f, &[0; 4])].concat(), channel());
    let footer = of_kind(0x02, &[&(data.len() as u64).to_le_bytes()[..], &[0; 12]].concat());
    let summary = [&channel, &footer[..footer.len() - 4]].concat();
    let crc = crc32fast::hash(&summary).to_le_bytes();
    let file = [&data[..], &summary, &crc, MAGIC].concat();
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("first_message.mcap");
    fs::write(&path, file).unwrap();
    let outcome = repair(File::open(&path).unwrap(), &mut io::sink()).unwrap();
    let place = (MAGIC.len() + lost.len()) as u64;
    assert_eq!((outcome.messages, outcome.damaged_at), (3, vec![place]));
}

#[test]
fn wrong_metadata_length_costs_no_chunk() {
    let content = [text("tokio_scip"), text("")].concat();
    let chunk = chunk_of(&[channel(), event(0)].concat());
    // Some end in the next chunk, some in themselves.
    for length in (0..content.len() + 80).filter(|length| *length != content.len()) {
        let metadata = record(0x0c, length as u64, &content);
        let file = [MAGIC, &metadata, &chunk, &end()].concat();
        assert_eq!(read(&file), (vec![8], 1, false), "{length} in place of {}", content.len());
    }
}

#[test]
fn a_stray_byte_costs_no_record() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    let index = of_kind(0x07, &[&[0; 2][..], &claims(16), &[0; 16]].concat());
    let (schema, event) = (of_kind(0x03, &[&[1, 0][..], &[0; 12]].concat()), event(0));
    for stray in 0..=u8::MAX {
        let chunks = [MAGIC, &chunk, &index].concat();
        let file = [&chunks[..], &[stray], &chunk, &index, &end()].concat();
        assert_eq!(read(&file), (vec![chunks.len() as u64], 2, false), "{stray:#x}");
        let records = [MAGIC, &schema, &channel(), &event].concat();
        let file = [&records[..], &[stray], &event, &event, &end()].concat();
        assert_eq!(read(&file), (vec![records.len() as u64], 3, false), "{stray:#x}");
    }
}

#[test]
fn a_damaged_schema_costs_no_message() {
    let schema = of_kind(0x03, &[&[1, 0][..], &[0; 12]].concat());
    for at in 0..schema.len() {
        let mut damaged = schema.clone();
        damaged[at] ^= 0x21;
        let file = [MAGIC, &damaged, &channel(), &event(0), &event(0), &end()].concat();
        assert_eq!(read(&file).1, 2, "byte {at}");
    }
}

#[test]
fn a_message_index_does_not_become_a_message() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    let index = [&[0; 2][..], &claims(16), &[0; 16]].concat();
    let before = [MAGIC, &chunk].concat();
    // Its length may be damaged, too, and end at another record.
    for length in [index.len(), index.len() + chunk.len()] {
        let index = record(0x05, length as u64, &index);
        let file = [&before[..], &index, &chunk, &chunk, &end()].concat();
        let outcome = repair(Cursor::new(file), &mut Vec::new()).unwrap();
        assert_eq!((outcome.messages, outcome.damaged_at), (3, vec![before.len() as u64]));
    }
}

#[test]
fn messages_may_stand_both_in_chunks_and_outside() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    let data = text("{\"event\":\"reconnected\"}\0");
    for sequence in 0..99_u32 {
        // At 1 s of a simulated clock, say.
        let times = 1_000_000_000_u64.to_le_bytes().repeat(2);
        let content = [&[0; 2][..], &sequence.to_le_bytes(), &times, &[0, 1, 0, 0], &data].concat();
        let file = [MAGIC, &chunk, &of_kind(0x05, &content), &chunk, &end()].concat();
        assert_eq!(read(&file), (vec![], 3, false), "{sequence}");
    }
}

/// A message whose kind is damaged, and whose number is the length of a list, looks like one.
#[test]
fn a_damaged_message_does_not_hide_the_next_ones() {
    let damaged = record(0x00, 0, &event(0)[9..]);
    for data in [&b""[..], b"data"] {
        let index = of_kind(0x07, &[&[0, 0, 16][..], &[0; 19], data].concat());
        let three = [event(0), event(0), event(0)].concat();
        for parts in [[&index, &three, &damaged, &three], [&damaged, &three, &index, &three]] {
            let file = [MAGIC, &channel(), &event(0), &parts.map(Vec::as_slice).concat(), &end()];
            let (damaged, records, is_truncated) = read(&file.concat());
            assert_eq!((damaged.len(), records, is_truncated), (1, 7, false), "{data:?}");
        }
    }
}

/// Adds the fields of a later version at the end of a record.
fn more(record: &[u8], fields: &[u8]) -> Vec<u8> {
    of_kind(record[0], &[&record[9..], fields].concat())
}

#[test]
fn a_length_in_a_later_chunk_is_no_record() {
    let later = of_kind(0x7f, b"later");
    // A record without bytes to count looks like the length of a chunk, or of its records, before zeros.
    for (kind, length) in [(0x01, 8), (0x07, 6), (0x0c, 8), (0x0f, 4)] {
        for fields_and_head in [0, 46] {
            let records = [channel(), event(0)].concat();
            let bytes = usize::from(u16::from_le_bytes([kind, length])) - fields_and_head;
            let rest = of_kind(0x10, &vec![1; bytes - records.len() - 9]);
            let chunk = more(&chunk_of(&[records, rest].concat()), b"123456");
            let file = [MAGIC, &chunk, &later, &chunk, &end()].concat();
            assert_eq!(read(&file), (vec![], 2, false), "kind {kind}, {fields_and_head}");
        }
    }
}

/// Its content may look like records of the file.
#[test]
fn a_later_chunk_that_is_cut_off_is_read() {
    let data = metadata().repeat(3);
    let data = [&claims(data.len() as u32)[..], &data].concat();
    let schema = of_kind(0x03, &[&[1, 0][..], &text("a"), &text("b"), &data].concat());
    let begun = [channel(), event(0)].concat();
    let chunk = chunk_of(&[&begun[..], &schema, &event(0)].concat());
    let file = [MAGIC, &more(&chunk, &[1; 12])].concat();
    let records_end = MAGIC.len() + chunk.len();
    for length in MAGIC.len() + 49 + begun.len()..file.len() {
        let events = 1 + usize::from(length >= records_end);
        assert_eq!(read(&file[..length]), (vec![], events, true), "{length}");
    }
}

#[test]
fn the_last_bytes_of_a_later_record_begin_no_chunk() {
    let chunk = more(&chunk_of(&[channel(), event(0)].concat()), b"123456");
    let index = of_kind(0x07, &[&[0; 2][..], &claims(16), &[0; 16]].concat());
    for fields in [&b"\x06"[..], b"1234567890\x06", b"12345678\x06\x0b"] {
        let header = more(&of_kind(0x01, &[0; 8]), fields);
        let (index, last) = (more(&index, fields), of_kind(0xaa, b""));
        let file = [MAGIC, &header, &chunk, &index, &chunk, &index, &last, &end()].concat();
        assert_eq!(read(&file), (vec![], 2, false), "{fields:?}");
    }
}

#[test]
fn the_last_byte_of_a_later_index_begins_no_message() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    let index = of_kind(0x07, &[&[0; 2][..], &claims(16), &[0; 16], b"\x05"].concat());
    // From that byte on it looks like a message of 0x150 bytes, up to the next chunk.
    let later = [of_kind(0x50, &[1]), of_kind(0x51, &[1; 0x150 - 11])].concat();
    let file = [MAGIC, &chunk, &index, &later, &chunk, &end()].concat();
    assert_eq!(read(&file), (vec![], 2, false));
}

/// A simulated clock begins at 0, and its first messages may have zeros.
/// With the head of the private record after it, it looks like one that ends where the second event does.
#[test]
fn the_last_byte_of_a_later_channel_begins_no_message() {
    let channel = more(&channel(), &[[1; 11].as_slice(), &[5]].concat());
    let private = of_kind(2 * event(0).len() as u8 + 1, &[]);
    let file = [MAGIC, &channel, &private, &event(0).repeat(5), &end()].concat();
    assert_eq!(read(&file), (vec![], 5, false));
}

#[test]
fn a_message_of_zeros_is_no_chunk() {
    for length in 22..99 {
        let message = of_kind(0x05, &vec![0; length]);
        for records in [message.clone(), chunk_of(&message)] {
            let file = [MAGIC, &channel(), &records, &end()].concat();
            let outcome = repair(Cursor::new(file), &mut Vec::new()).unwrap();
            assert_eq!((outcome.messages, outcome.damaged_parts), (1, 0), "{length}");
        }
    }
}

/// With the zeros after it, they are a record of eight bytes, before another one.
#[test]
fn the_last_bytes_of_a_message_are_no_end_of_the_data() {
    let message = of_kind(0x05, &[&[0; 22][..], &[1; 60], &[0x0f, 8, 0, 0]].concat());
    let file = [MAGIC, &channel(), &message, &[0; 13], &channel(), &end()[13..]].concat();
    let outcome = repair(Cursor::new(file), &mut Vec::new()).unwrap();
    assert_eq!((outcome.messages, outcome.damaged_parts), (1, 1));
}

/// As in zeros, which are empty texts. The crate `mcap` reads no metadata of such a file.
#[test]
fn a_key_that_is_there_twice_is_damage() {
    for zeros in [0, 8, 16] {
        let pairs = [text("rate"), text("10 Hz"), vec![0; zeros]].concat();
        let content = [&text("tokio_scip")[..], &claims(pairs.len() as u32), &pairs].concat();
        let file = [MAGIC, &of_kind(0x0c, &content), &channel(), &event(0), &end()].concat();
        let (is_damaged, mut out) = (zeros == 16, Vec::new());
        let outcome = repair(Cursor::new(file), &mut out).unwrap();
        assert_eq!((outcome.messages, outcome.damaged_parts), (1, u64::from(is_damaged)));
        let summary = mcap::Summary::read(&out).unwrap().unwrap();
        assert_eq!(summary.metadata_indexes.is_empty(), is_damaged);
    }
}

#[test]
fn a_far_length_is_not_read_ahead() {
    const MIB: usize = 1 << 20;
    // Its name ends beyond the file's next megabytes.
    let attachment = record(0x09, 1 << 40, &[&[0; 16][..], &claims(8 << 20), &[0; 4]].concat());
    let events = event(0).repeat(10 * MIB / event(0).len());
    let file = [MAGIC, &channel(), &event(0), &attachment, &events, &end()];
    let file = Cursor::new(file.concat());
    let counted = allocation_counter::measure(|| {
        let items: Vec<_> = Recording::read(file).unwrap().take(3).collect();
        assert_eq!(damaged_at(&items).len(), 1);
    });
    assert!(counted.bytes_max < 4 * MIB as u64, "{} bytes in memory", counted.bytes_max);
}

/// At the end of what is in memory, more is read before the kind is believed.
#[test]
fn a_damaged_kind_shows_at_the_end_of_a_read() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    let mut damaged = chunk.clone();
    damaged[0] = 0x05;
    let read_bytes = 64 << 10;
    for rest in 1..70 {
        let start = [MAGIC, &chunk].concat();
        let length = read_bytes - rest - start.len() - 23;
        let data = [&claims(length as u32)[..], &vec![1; length]].concat();
        let schema = of_kind(0x03, &[&[1, 0][..], &[0; 8], &data].concat());
        let file = [&start[..], &schema, &damaged, &chunk, &end()].concat();
        let place = (read_bytes - rest) as u64;
        let outcome = repair(Cursor::new(file), &mut Vec::new()).unwrap();
        assert_eq!((outcome.messages, outcome.damaged_at), (2, vec![place]), "{rest}");
    }
}

#[test]
fn a_damaged_kind_of_a_later_chunk_is_reported() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    let head = [&[0; 16][..], &30u64.to_le_bytes(), &[0; 4], &text("lz4")].concat();
    let compressed = of_kind(0x06, &[&head[..], &9u64.to_le_bytes(), &[0; 9]].concat());
    for (kind, chunk_hit) in
        [(0x05, &chunk), (0x50, &chunk), (0x05, &compressed), (0x50, &compressed)]
    {
        let mut damaged = more(chunk_hit, b"123456");
        damaged[0] = kind;
        let file = [MAGIC, &chunk, &damaged, &chunk, &end()].concat();
        let outcome = repair(Cursor::new(file), &mut Vec::new()).unwrap();
        let place = 8 + chunk.len() as u64;
        assert_eq!((outcome.messages, outcome.damaged_at), (2, vec![place]), "{kind:#x}");
    }
}

#[test]
fn a_message_before_a_cut_off_one_is_found() {
    let (event, stray) = (event(0), [0; 1]);
    let whole = [MAGIC, &channel(), &event, &stray, &event, &event].concat();
    for missing in 1..event.len() {
        let (damaged, events, is_truncated) = read(&whole[..whole.len() - missing]);
        assert_eq!((damaged.len(), events, is_truncated), (1, 2, true), "{missing}");
    }
}

/// Returns the number of messages, and the places of damaged parts.
fn repaired(file: &[&[u8]]) -> (u64, Vec<u64>) {
    let outcome = repair(Cursor::new(file.concat()), &mut io::sink()).unwrap();
    (outcome.messages, outcome.damaged_at)
}

#[test]
fn a_message_before_a_cut_off_index_is_found() {
    let (event, stray) = (event(0), [0; 1]);
    let data = [MAGIC, &channel(), &event, &stray, &event, &of_kind(0x0f, &[0; 4])].concat();
    for length in 0..channel().len() {
        let (damaged, events, is_truncated) = read(&[&data, &channel()[..length]].concat());
        assert_eq!((damaged.len(), events, is_truncated), (1, 2, true), "{length}");
    }
}

#[test]
fn a_wrong_length_that_ends_at_the_last_bytes_hides_none() {
    let (channel, events) = (channel(), event(0).repeat(4));
    let chunk = chunk_of(&[&channel[..], &events].concat());
    let files = [[MAGIC, &channel, &events].concat(), [MAGIC, &chunk].concat()];
    for (file, place) in files.into_iter().zip([8 + channel.len(), 8]) {
        // Cut off in the text of the last event.
        let (start, end) = (file.len() - events.len(), file.len() - 9);
        for rest in 1..9 {
            let mut file = file[..end].to_vec();
            let length = (end - rest - start - 9) as u64;
            file[start + 1..start + 9].copy_from_slice(&length.to_le_bytes());
            assert_eq!(repaired(&[&file]), (2, vec![place as u64]), "{rest}");
        }
    }
}

#[test]
fn a_message_before_a_cut_off_later_record_is_found() {
    // Its data look like metadata of empty texts.
    let message = of_kind(0x05, &[&[0; 22], &of_kind(0x0c, &[0; 8])[..]].concat());
    let later = of_kind(0x7f, b"later");
    for length in 0..later.len() {
        let found = repaired(&[MAGIC, &channel(), &message, &later[..length]]);
        assert_eq!(found, (1, vec![]), "{length}");
    }
}

/// The last bytes of its data look like the end of the data and the head of an endless attachment.
#[test]
fn a_message_before_a_cut_off_message_is_found() {
    let tail = [&[0x0f, 9][..], &[0; 16]].concat();
    let message = of_kind(0x05, &[&[0; 22], &tail[..17]].concat());
    let later = of_kind(0x10, b"/private/");
    let parts = [channel(), message, later, event(0)].concat();
    let missing = event(0).len() - 6;
    let chunk = chunk_of(&parts);
    assert_eq!(repaired(&[MAGIC, &chunk[..chunk.len() - missing]]), (1, vec![]));
}

#[test]
fn a_record_in_a_message_is_its_data() {
    let (event, damage) = (event(0), [0xee; 40]);
    for data in [metadata(), channel(), of_kind(0x07, &[0; 6])] {
        let message = of_kind(0x05, &[&[0; 22], &data[..]].concat());
        let start = [MAGIC, &channel(), &message].concat();
        let place = (start.len() + 2 * event.len()) as u64;
        let two = event.repeat(2);
        assert_eq!(repaired(&[&start, &two, &damage, &two, &end()]), (5, vec![place]));
        for length in 0..event.len() {
            assert_eq!(repaired(&[&start, &event[..length]]), (1, vec![]), "{length}");
        }
        let chunk = chunk_of(&[&channel(), &message, &two, &damage[..], &two].concat());
        assert_eq!(repaired(&[MAGIC, &chunk, &end()]), (5, vec![8]));
    }
}

#[test]
fn numbers_in_a_message_are_no_metadata() {
    // A name and no pairs, or no name and a pair of two empty texts.
    for (name, pairs) in [(&[7; 7][..], &[][..]), (&[], &[0; 8])] {
        let lengths = [name, pairs].map(|text| claims(text.len() as u32));
        let numbers = of_kind(0x0c, &[&lengths[0], name, &lengths[1], pairs].concat());
        let message = of_kind(0x05, &[&[0; 22], &numbers[..]].concat());
        let start = [MAGIC, &channel(), &message].concat();
        let found = repaired(&[&start, &[0], &event(0).repeat(3), &end()]);
        assert_eq!(found, (4, vec![start.len() as u64]), "{numbers:?}");
    }
}

#[test]
fn a_chunk_between_damages_is_found() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    let damage = [0xee; 40];
    let file = [MAGIC, &chunk, &damage, &chunk, &damage, &chunk, &end()].concat();
    let (damaged, events, is_truncated) = read(&file);
    assert_eq!((damaged.len(), events, is_truncated), (2, 3, false));
}

/// As after `cat`.
#[test]
fn a_joined_file_without_chunks_is_searched() {
    let first = [MAGIC, &chunk_of(&[channel(), event(0)].concat()), &end()].concat();
    let second = [MAGIC, &channel(), &event(0), &[0xee; 40], &event(0).repeat(2), &end()].concat();
    let (damaged, events, _) = read(&[first, second].concat());
    assert_eq!((damaged.len(), events), (1, 4));
}

/// No checksum proves them.
#[test]
fn records_of_a_chunk_without_its_head_are_left_out() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    let index = of_kind(0x07, &[&[0; 2][..], &claims(16), &[0; 16]].concat());
    let mut damaged = chunk.clone();
    damaged[0] = 0;
    for (next, events) in [(&chunk, 1), (&index, 0)] {
        let file = [MAGIC, &damaged, next, &end()].concat();
        assert_eq!(read(&file), (vec![8], events, false));
    }
    let left = [&[0xe9][..], &event(0).repeat(3)].concat();
    let file = [MAGIC, &chunk, &left, &chunk, &end()].concat();
    assert_eq!(read(&file), (vec![(MAGIC.len() + chunk.len()) as u64], 2, false));
}

#[test]
fn a_message_of_33_mib_is_found() {
    let event = event(0);
    let long = of_kind(0x05, &[&event[9..], &vec![0x80; 33 << 20]].concat());
    let file = [MAGIC, &channel(), &event, &[0; 1], &long, &long, &end()].concat();
    let outcome = repair(Cursor::new(file), &mut io::sink()).unwrap();
    assert_eq!((outcome.messages, outcome.damaged_parts), (3, 1));
}

/// Numbers in a message may look like a channel without a name.
#[test]
fn numbers_at_a_chunks_end_define_no_channel() {
    let numbers = [&[0x04, 0x10][..], &[0; 26]].concat();
    let mut message = of_kind(0x05, &[&[0; 22][..], &numbers].concat());
    message[0] = 0;
    let first = chunk_of(&[channel(), event(0), message].concat());
    let file = [MAGIC, &first, &chunk_of(&event(0)), &end()].concat();
    assert_eq!(read(&file), (vec![8], 2, false));
}

#[test]
fn a_wrong_length_that_ends_at_a_record_hides_none() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    let mut long = more(&chunk, b"1");
    let length = 2 * chunk.len() as u64 + 1 - 9;
    long[1..9].copy_from_slice(&length.to_le_bytes());
    let file = [MAGIC, &long, &chunk, &chunk, &end()].concat();
    assert_eq!(read(&file), (vec![8], 2, false));
}

#[test]
fn a_wrong_length_that_ends_in_the_next_head_hides_no_chunk() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    for by in 1..6 {
        let mut long = more(&chunk, b"123");
        long[1] += by;
        let file = [MAGIC, &long, &chunk, &chunk, &end()].concat();
        assert_eq!(read(&file), (vec![8], 2, false), "{by}");
    }
}

#[test]
fn fields_and_kinds_of_later_versions_are_skipped() {
    let more = |record: Vec<u8>| more(&record, b"123456");
    let header = of_kind(0x01, &[0; 8]);
    let records = [more(channel()), of_kind(0x10, b"later"), event(0)].concat();
    let chunk = [more(chunk_of(&records)), of_kind(0x7f, b"later")].concat();
    for body in [records, chunk] {
        let file = [MAGIC, &more(header.clone()), &more(metadata()), &body, &end()].concat();
        assert_eq!(read(&file), (vec![], 1, false));
        let recording = Recording::read(Cursor::new(file)).unwrap();
        assert_eq!(recording.metadata()["rate"], "10 Hz");
    }
}

#[test]
fn a_chunk_with_zeros_for_its_lengths_is_damage() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    let mut damaged = chunk.clone();
    // From its size to the length of its first record.
    damaged[9 + 16..9 + 40 + 9].fill(0);
    let file = [MAGIC, &chunk, &damaged, &chunk, &end()].concat();
    assert_eq!(read(&file), (vec![8 + chunk.len() as u64], 2, false));
}

#[test]
fn malformed_metadata_does_not_hide_a_chunk() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    // Of a map of 40 bytes the last 31 are missing, and what is there is no pair.
    let metadata = [&text("tokio_scip")[..], &claims(40), &[0xff; 9]].concat();
    let metadata = record(0x0c, metadata.len() as u64 + 31, &metadata);
    let file = [MAGIC, &metadata, &chunk, &chunk, &end()].concat();
    assert_eq!(read(&file), (vec![8], 2, false));
}

/// The stray byte makes a header of the metadata, whose first text ends after several chunks, and whose
/// end lies beyond the file.
#[test]
fn a_stray_byte_before_damaged_metadata_hides_no_chunk() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    for more in 0..chunk.len() {
        let pair = [text("rate"), text(&"1".repeat(20 + more))].concat();
        let content = [&text("tokio_sc?ip")[..], &claims(pair.len() as u32), &pair].concat();
        let mut metadata = of_kind(0x0c, &content);
        // As if the name had gained a byte.
        metadata[9] -= 1;
        let file = [MAGIC, &[0x01], &metadata, &chunk.repeat(30), &end()].concat();
        assert_eq!(read(&file), (vec![8], 30, false), "{more}");
    }
}

#[test]
fn a_damaged_last_record_hides_no_end() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    let mut damaged = chunk.clone();
    // Its length.
    damaged[1] ^= 1;
    let file = [MAGIC, &chunk, &damaged, &end()].concat();
    assert_eq!(read(&file), (vec![8 + chunk.len() as u64], 1, false));
}

#[test]
fn a_damaged_kind_ends_no_file_before_its_metadata() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    // It was a message index.
    let damaged = of_kind(0x0f, &[&[0; 2][..], &claims(16), &[0; 16]].concat());
    let file = [MAGIC, &chunk, &damaged, &metadata(), &chunk, &end()].concat();
    assert_eq!(read(&file), (vec![8 + chunk.len() as u64], 2, false));
}

#[test]
fn a_damaged_kind_ends_no_file_before_damage() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    let place = 8 + chunk.len() as u64;
    let mut damaged = of_kind(0x0f, &[&[0; 2][..], &claims(16), &[0; 16]].concat());
    // A length that ends in the next chunk.
    let long =
        record(0x07, 21 + chunk.len() as u64, &[&[0; 2][..], &claims(16), &[0; 16]].concat());
    // A stray byte, or a damaged kind.
    for next in [b"\0".to_vec(), of_kind(0x5b, &[1; 30]), long] {
        for kind in [0x0f, 0x02] {
            damaged[0] = kind;
            let file = [MAGIC, &chunk, &damaged, &next, &chunk, &chunk, &end()].concat();
            let (places, events, is_truncated) = read(&file);
            assert_eq!((events, is_truncated), (3, false), "{kind}, {next:?}");
            assert!(places[0] >= place, "{places:?}");
        }
    }
}

#[test]
fn a_damaged_kind_ends_no_file_before_its_channels() {
    // Each has the length of a footer.
    let records = [
        of_kind(0x01, &[text("ros2"), text("12345678")].concat()),
        of_kind(0x03, &[&[1, 0][..], &text("a"), &text("b"), &text("data")].concat()),
        of_kind(0x04, &channel_content(1, "/")),
        channel(),
        event(0).repeat(2),
        end(),
    ];
    for kind in [0x0f, 0x02] {
        for number in 0..3 {
            let mut damaged = records.clone();
            damaged[number][0] = kind;
            let place = records[..number].iter().map(Vec::len).sum::<usize>() as u64 + 8;
            let file = [MAGIC, &damaged.concat()].concat();
            assert_eq!(read(&file), (vec![place], 2, false), "{kind}, record {number}");
        }
    }
}

/// Otherwise a file of a few MiB would take hours.
#[test]
fn records_after_many_false_ends_are_read_once() {
    const COUNT: u64 = 300;
    let end = [of_kind(0x0c, &[&text("a")[..], &claims(0)].concat()), of_kind(0x0f, &[0; 5])];
    let end = end.concat();
    // From each end to the same records, over all other ends.
    let long = |ends| record(0x80, ends * (end.len() as u64 + 9), &[]);
    let ends: Vec<_> = (0..COUNT).rev().map(|ends| [end.clone(), long(ends)].concat()).collect();
    // Like a chunk's. The reader allocates its name.
    let fields = [&[0; 28][..], &text("x"), &[0; 8]].concat();
    let records = of_kind(0x80, &fields).repeat(COUNT as usize);
    let file = [MAGIC, &ends.concat(), &of_kind(0, &[]), &records].concat();
    let counted = allocation_counter::measure(|| assert_eq!(read(&file).1, 0));
    assert!(counted.count_total < 50 * COUNT, "{} allocations", counted.count_total);
}

#[test]
fn a_damaged_summary_defines_no_topic() {
    let data = [channel(), event(0)].concat();
    // With a field of a later version, and a damaged topic.
    let summary = [of_kind(0x0f, &[0; 5]), of_kind(0x04, &channel_content(1, "/sc?p/events"))];
    let rest = [of_kind(0x04, &channel_content(2, "")), b"\0".to_vec(), end()[13..].to_vec()];
    // A message of no channel proves no definition before it.
    for messages in [Vec::new(), event(9).repeat(3)] {
        let file = [MAGIC, &data, &summary.concat(), &messages, &rest.concat()].concat();
        let mut out = Vec::new();
        assert!(repair(Cursor::new(file), &mut out).unwrap().damaged_parts > 0);
        let summary = mcap::Summary::read(&out).unwrap().unwrap();
        let topics: Vec<_> = summary.channels.values().map(|channel| &channel.topic[..]).collect();
        assert_eq!(topics, ["/scip/events"]);
    }
}

/// A record that looks like the end of the data was none if a message follows.
#[test]
fn a_message_proves_the_definitions_before_it() {
    let later = [of_kind(0x0f, &[0; 5]), of_kind(0x04, &channel_content(1, "/later"))].concat();
    for number in [0, 1] {
        let file = [MAGIC, &channel(), &event(0), &later, &event(number), &end()].concat();
        let mut out = Vec::new();
        assert_eq!(repair(Cursor::new(file), &mut out).unwrap().messages, 2);
        let channels = mcap::Summary::read(&out).unwrap().unwrap().channels;
        assert!(channels.values().any(|channel| channel.topic == "/later"), "{number}");
    }
}

#[test]
fn no_record_ends_at_the_end_of_a_whole_file() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    let rest = [chunk.clone(), end()].concat();
    // The data of a message look like the head of a record up to the end of the file.
    let long = record(0x80, rest.len() as u64, &[]);
    let message = of_kind(0x05, &[&[0; 22], &long[..]].concat());
    let last = chunk_of(&[channel(), message].concat());
    // A message index with a damaged kind and length, which ends there.
    let length = 6 + chunk.len() + last.len() - long.len();
    let index = record(0xa9, length as u64, &[0; 6]);
    let start = [MAGIC, &chunk, &index, &chunk, &last].concat();
    let place = 8 + chunk.len() as u64;
    assert_eq!(repaired(&[&start, &rest]), (4, vec![place]));
    // It may be a record of a file that was cut off.
    let cut_off = &rest[..rest.len() - 1];
    assert_eq!(repaired(&[&start, cut_off, &[0]]), (1, vec![]));
    // In a chunk, too, even if a message ends with the magic bytes.
    let message = of_kind(0x05, &[&[0; 22], MAGIC].concat());
    let later = of_kind(0x80, &metadata());
    let chunk = chunk_of(&[channel(), event(0), later, message].concat());
    assert_eq!(repaired(&[MAGIC, &chunk, &end()]), (2, vec![]));
}

#[test]
fn a_message_index_with_a_wrong_length_hides_no_chunk() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    let mut index = of_kind(0x07, &[&[0; 2][..], &claims(16), &[0; 16]].concat());
    // The length of its entries is now what was its length and the channel.
    index.insert(3, 0x10);
    let many = 1 + 5_000 / chunk.len();
    let file = [MAGIC, &chunk, &index, &chunk.repeat(many), &end()].concat();
    assert_eq!(read(&file), (vec![8 + chunk.len() as u64], 1 + many, false));
}

#[test]
fn a_damaged_attachment_refuses_no_file() {
    // Its media type stands where a chunk has the name of its compression.
    let content = [&[0; 16][..], &text("12345678"), &text("text/yaml"), &[0; 8], &[0; 4]].concat();
    let attachment = of_kind(0x06, &content);
    let head = [MAGIC, &channel(), &attachment, &event(0).repeat(2)].concat();
    let first = 8 + channel().len() as u64;
    assert_eq!(read(&[&head[..], &end()].concat()), (vec![first], 2, false));
    // Nor do two, whose name is too long for a compression.
    let content = [&content[..28], &text("application/x-yaml"), &[0; 8], &[0; 4]].concat();
    let two = of_kind(0x06, &content).repeat(2);
    let file = [MAGIC, &channel(), &two, &event(0).repeat(2), &end()].concat();
    assert_eq!(read(&file), (vec![first], 2, false));
    // Nor does it make a file with chunks of one without.
    let file = [&head[..], &[0; 5], &event(0).repeat(3), &end()].concat();
    assert_eq!(read(&file), (vec![first, head.len() as u64], 5, false));
}

#[test]
fn metadata_at_a_damaged_beginning_is_read() {
    let chunk = chunk_of(&[channel(), event(0)].concat());
    let file = [&MAGIC[..4], &metadata(), &chunk, &end()].concat();
    let mut recording = Recording::read(Cursor::new(file)).unwrap();
    assert_eq!(recording.by_ref().filter(Result::is_ok).count(), 1);
    assert_eq!(recording.metadata()["rate"], "10 Hz");
}

#[test]
fn metadata_between_a_damaged_beginning_and_damage_are_read() {
    let names = [text(""), text("library")].concat();
    let chunk = chunk_of(&[channel(), event(0)].concat());
    let start = [b"\x89MCAP1\r\n", &of_kind(0x01, &names)[..]].concat();
    // With fields of a later version, or without.
    let later = [&start[..8], &of_kind(0x01, &[&names[..], &[1; 5]].concat())].concat();
    for start in [start, later] {
        let start = [&start[..], &more(&metadata(), &[1; 2])].concat();
        let file = [&start[..], &[0xee; 16], &chunk, &end()].concat();
        let mut recording = Recording::read(Cursor::new(file)).unwrap();
        let damaged = damaged_at(&recording.by_ref().collect::<Vec<_>>());
        assert_eq!(damaged, [0, start.len() as u64]);
        assert_eq!(recording.metadata()["rate"], "10 Hz");
    }
}

#[test]
fn a_file_without_its_last_byte_is_truncated() {
    let file = [MAGIC, &chunk_of(&[channel(), event(0)].concat()), &end()].concat();
    assert_eq!(read(&file), (vec![], 1, false));
    for missing in 1..=end().len() {
        assert_eq!(read(&file[..file.len() - missing]), (vec![], 1, true), "{missing}");
    }
}

#[test]
fn a_footer_alone_ends_a_file() {
    let whole = [MAGIC, &chunk_of(&[channel(), event(0)].concat()), &end()].concat();
    let mut damaged = whole.clone();
    // The kind of the record that ends the data: of a later version now.
    damaged[whole.len() - end().len()] = 0x10;
    assert_eq!(read(&damaged), (vec![], 1, false));
    assert_eq!(read(&[damaged, whole].concat()), (vec![], 2, true));
}

/// A line feed would end the line that they become.
#[test]
fn metadata_become_a_version() {
    let pairs = ["serial_number", "H1\nSERI:H2", "status", "good"].map(text).concat();
    let pairs = [&text("tokio_scip")[..], &claims(pairs.len() as u32), &pairs].concat();
    let file = [MAGIC, &of_kind(0x0c, &pairs), &end()].concat();
    let version = Recording::read(Cursor::new(file)).unwrap().scans().version();
    assert_eq!(version.serial_number.to_string(), "H1");
    assert_eq!(version.status.map(|status| status.to_string()), Some("good".to_owned()));
    assert_eq!((version.vendor, version.firmware), Default::default());
}

#[test]
fn metadata_is_read_at_the_files_end() {
    let file = [MAGIC, &metadata()].concat();
    let recording = Recording::read(Cursor::new(file)).unwrap();
    assert_eq!(recording.metadata()["rate"], "10 Hz");
}

#[test]
fn the_first_16_damaged_places_are_kept() {
    let mut chunk = chunk_of(&event(0));
    // The checksum is wrong.
    chunk[9 + 24] = 1;
    let file = [MAGIC, &chunk.repeat(20), &end()].concat();
    let outcome = repair(Cursor::new(file), &mut Vec::new()).unwrap();
    assert_eq!(outcome.damaged_parts, 20);
    let places: Vec<u64> = (0..16).map(|number| (8 + number * chunk.len()) as u64).collect();
    assert_eq!(outcome.damaged_at, places);
}

/// The file has many channels with long names, and as many chunks as fit.
#[test]
fn a_repaired_file_stays_small() {
    let name = "x".repeat(1000);
    let channels: Vec<u8> =
        (0..200).flat_map(|number| of_kind(0x04, &channel_content(number, &name))).collect();
    let message = of_kind(0x05, &[0; 22]);
    let metadata = of_kind(0x0c, &[claims(0), claims(0)].concat());
    let chunk = chunk_of(&message);
    for (name, body) in [
        ("metadata between messages", [&message[..], &metadata].concat().repeat(5_000)),
        ("metadata in a chunk", chunk_of(&[&message[..], &metadata].concat().repeat(5_000))),
        ("small chunks", chunk.repeat(5_000)),
        ("empty chunks", chunk_of(&[]).repeat(5_000)),
        ("metadata", metadata.repeat(5_000)),
        (
            "redefined channels",
            [&channel()[..], &of_kind(0x04, &channel_content(0, "/x"))].concat().repeat(5_000),
        ),
    ] {
        let file = [MAGIC, &channels, &body, &end()].concat();
        let mut out = Vec::new();
        let outcome = repair(Cursor::new(file.clone()), &mut out).unwrap();
        assert_eq!(outcome.damaged_parts, 0, "{name}");
        assert!(out.len() < 8 * file.len() + (8 << 10), "{name}: {} of {}", out.len(), file.len());
    }
}

/// Another program's file may use the names of a recording's topics for anything.
#[test]
fn a_topic_of_another_type_is_none_of_a_recording() {
    let schema =
        |name: &str| of_kind(0x03, &[&[1, 0][..], &text(name), &text("ros2msg"), &[0; 4]].concat());
    let channel =
        of_kind(0x04, &[&[0, 0, 1, 0][..], &text("/scip/events"), &text("cdr"), &[0; 4]].concat());
    let message = of_kind(0x05, &[&[0; 22][..], b"other"].concat());
    for name in ["std_msgs/msg/String", "my/msg/Other"] {
        let file =
            [MAGIC, &chunk_of(&[schema(name), channel.clone(), message.clone()].concat()), &end()]
                .concat();
        assert_eq!(read(&file), (vec![], 0, false), "{name}");
        let outcome = repair(Cursor::new(file), &mut Vec::new()).unwrap();
        assert_eq!((outcome.damaged_parts, outcome.messages), (0, 1), "{name}");
    }
}

/// One part, however many of its messages are malformed, for the reader and the repair.
#[test]
fn reader_and_repair_judge_chunks_alike() {
    let bad = of_kind(0x05, &[&[0; 22][..], b"no event"].concat());
    let records = [channel(), bad.clone(), event(0), bad, event(7), event(0)].concat();
    let file = [MAGIC, &chunk_of(&records), &end()].concat();
    assert_eq!(read(&file), (vec![8], 2, false));
    let mut repaired = Vec::new();
    let outcome = repair(Cursor::new(file), &mut repaired).unwrap();
    // A message in another form than events have is copied, too.
    assert_eq!((outcome.damaged_at, outcome.messages), (vec![8], 4));
    assert_eq!(read(&repaired), (vec![], 2, false));
}
