//! Hostile files: reading one takes no more memory than its own size.

use std::io::Cursor;

use tokio_scip::recording::{Recording, RecordingError, repair};

const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// Makes a record that claims this length.
fn record(kind: u8, length: u64, content: &[u8]) -> Vec<u8> {
    [&[kind][..], &length.to_le_bytes(), content].concat()
}

/// Makes the fields of a chunk: times, size, CRC, compression, length of its records.
fn chunk(size: u64, records: u64) -> Vec<u8> {
    let (size, records) = (size.to_le_bytes(), records.to_le_bytes());
    [&[0; 16][..], &size, &[0; 4], &[0; 4], &records].concat()
}

/// Makes the length field of a string or a map.
fn claims(length: u32) -> [u8; 4] {
    length.to_le_bytes()
}

#[test]
fn a_hostile_length_is_an_error_or_an_end_and_takes_no_memory() {
    const G4: u64 = 4 << 30;
    let cases = [
        ("a header's string of 4 GB", record(0x01, 4, &claims(u32::MAX))),
        ("a header of 4 GB", record(0x01, G4 + 4, &claims(u32::MAX))),
        ("a short attachment", record(0x09, 24, &[0; 24])),
        ("an attachment of 2^63", record(0x09, 1 << 63, &[0; 24])),
        ("a record of 2^63", record(0x05, 1 << 63, &[0; 24])),
        ("a private record of 2^64 - 1", record(0x80, u64::MAX, &[0; 24])),
        ("a chunk of 4 GB", record(0x06, 40 + G4, &chunk(G4, G4))),
        ("a chunk of 32 MB", record(0x06, 40 + (32 << 20), &chunk(32 << 20, 32 << 20))),
        ("a chunk whose records claim 4 GB", record(0x06, 40, &chunk(0, G4))),
        ("a chunk that becomes 4 GB", record(0x06, 40, &chunk(G4, 0))),
        (
            "a record of 2^63 in a chunk",
            record(0x06, 49, &[chunk(9, 9), record(0x05, 1 << 63, &[])].concat()),
        ),
        (
            "a map of 4 GB",
            record(0x0c, 18, &[&claims(10)[..], b"tokio_scip", &claims(u32::MAX)].concat()),
        ),
        ("a message index of 4 GB", record(0x07, G4, &[&[0; 2][..], &claims(u32::MAX)].concat())),
        ("a schema of 4 GB", record(0x03, 6, &[&[0; 2][..], &claims(u32::MAX)].concat())),
        ("a record of an unknown kind", record(0x00, 0, &[])),
        ("zeros", vec![0; 1000]),
    ];
    for (name, bytes) in cases {
        let file = [MAGIC, &bytes].concat();
        let most = file.len() as u64;
        let counted = allocation_counter::measure(|| {
            let recording = Recording::read(Cursor::new(file.clone())).unwrap();
            for item in recording {
                assert!(matches!(item, Err(RecordingError::Damaged { .. })), "{name}: {item:?}");
            }
            let mut out = Vec::new();
            repair(Cursor::new(file), &mut out).unwrap();
            assert!(Recording::read(Cursor::new(out)).unwrap().next().is_none(), "{name}");
        });
        let (bytes, most) = (counted.bytes_max, 400_000 + 4 * most);
        assert!(bytes < most, "{name}: {bytes} bytes in memory");
    }
}

#[test]
fn a_compressed_recording_is_reported_as_such() {
    let head = [&[0; 16][..], &9u64.to_le_bytes(), &[0; 4], &claims(3), b"lz4"].concat();
    let chunk = [&head[..], &9u64.to_le_bytes(), &[0; 9]].concat();
    let file = [MAGIC, &record(0x06, chunk.len() as u64, &chunk)].concat();
    let error = Recording::read(Cursor::new(file)).unwrap_err();
    let RecordingError::Compressed { compression } = &error else { panic!("{error:?}") };
    assert_eq!(compression, "lz4");
    assert!(error.to_string().contains("`lz4`"), "{error}");
}

/// Text behind its length.
fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
}

#[test]
fn a_malformed_record_in_a_chunk_is_reported_by_the_reader_and_left_out_by_a_repair() {
    let of_kind = |kind, content: &[u8]| record(kind, content.len() as u64, content);
    let channel = [&[0; 4][..], &text("/scip/events"), &text("cdr"), &[0; 4]].concat();
    let event = r#"{"event":"reconnected"}"#;
    let data = [&[0, 1, 0, 0][..], &(event.len() as u32 + 1).to_le_bytes()].concat();
    let data = [&data, event.as_bytes(), b"\0"].concat();
    let message = of_kind(0x05, &[&[0; 22][..], &data].concat());
    for (name, malformed) in [
        ("a map of no pairs", of_kind(0x0c, &[text("tokio_scip"), text("pair")].concat())),
        ("a map of 4 GB", of_kind(0x0c, &[&text("tokio_scip")[..], &claims(u32::MAX)].concat())),
        ("bytes behind a map", of_kind(0x0c, &[&text("a")[..], &[0; 4], b"more"].concat())),
        ("bytes behind a channel", of_kind(0x04, &[&channel[..], b"more"].concat())),
        ("a short schema", of_kind(0x03, &[0; 4])),
        ("a short message", of_kind(0x05, &[0; 21])),
    ] {
        let records = [of_kind(0x04, &channel), message.clone(), malformed, message.clone()];
        let records = records.concat();
        let length = records.len() as u64;
        let file = [
            MAGIC,
            &record(0x06, 40 + length, &[chunk(length, length), records].concat()),
            &of_kind(0x0f, &[0; 4]),
            &of_kind(0x02, &[0; 20]),
            MAGIC,
        ]
        .concat();
        let mut repaired = Vec::new();
        let outcome = repair(Cursor::new(file.clone()), &mut repaired).unwrap();
        assert_eq!((outcome.was_truncated, outcome.damaged_parts), (false, 1), "{name}");
        for (file, damaged) in [(file, 1), (repaired.clone(), 0)] {
            let mut recording = Recording::read(Cursor::new(file)).unwrap();
            let items: Vec<_> = recording.by_ref().collect();
            let errors = items.iter().filter(|item| item.is_err()).count();
            assert_eq!((items.len() - errors, errors), (2, damaged), "{name}: {items:?}");
            assert!(!recording.is_truncated(), "{name}");
        }
        assert_eq!(mcap::MessageStream::new(&repaired).unwrap().count(), 2, "{name}");
    }
}
