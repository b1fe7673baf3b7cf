//! Recordings whose chunks another program compressed (feature `compression`).

use std::fs;
use std::io::Cursor;
use std::path::PathBuf;
use std::time::Duration;

use tokio_scip::{Scan, Window};
use urg_recording::{Compression, Recording, cut, repair};

use super::memory::reply;
use super::raw::{
    MAGIC, channel, channel_content, chunk_of, damaged_at, end, event, of_kind, read, text,
};
use super::recompress::{compress, compressed, u64_at};
use super::sink::{Sink, record, replayed, sensor, window};

/// Returns a chunk with this compression, which claims `size` bytes and has no checksum.
fn compressed_chunk(compression: &str, size: u64, bytes: &[u8]) -> Vec<u8> {
    let head = [&[0; 16][..], &size.to_le_bytes(), &[0; 4], &text(compression)].concat();
    of_kind(0x06, &[&head[..], &(bytes.len() as u64).to_le_bytes(), bytes].concat())
}

/// Makes a recording, and its compressed forms.
async fn recorded(window: Window, scans: usize) -> (Sink, [Vec<u8>; 2]) {
    let sink = Sink::new();
    record(sensor(), &sink, window, scans).await;
    let file = sink.bytes();
    let forms = ["zstd", "lz4"].map(|compression| compressed(&file, compression));
    for form in &forms {
        assert!(form.len() < file.len(), "{} of {}", form.len(), file.len());
    }
    (sink, forms)
}

/// Writes a file in the folder for tests' files.
fn written(name: &str, bytes: &[u8]) -> PathBuf {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::write(&path, bytes).unwrap();
    path
}

#[tokio::test(start_paused = true)]
async fn a_compressed_recording_is_used_as_the_original() {
    let part = Duration::from_secs(3)..Duration::from_secs(7);
    let (sink, forms) = recorded(Window::DETECTION, 100).await;
    let scans: Vec<_> = sink.open().scans().collect::<Result<_, _>>().unwrap();
    let mut expected_part = Vec::new();
    cut([Cursor::new(sink.bytes())], part.clone(), None, &mut expected_part).unwrap();
    for form in forms {
        let open = || Recording::read(Cursor::new(form.clone())).unwrap();
        let mut recording = open();
        assert_eq!(recording.metadata(), sink.open().metadata());
        let records: Vec<_> = recording.by_ref().collect::<Result<_, _>>().unwrap();
        assert_eq!(records, sink.records());
        assert!(!recording.is_truncated());
        let read: Vec<_> = open().scans().collect::<Result<_, _>>().unwrap();
        assert_eq!(format!("{read:?}"), format!("{scans:?}"));

        let (mut repaired, mut expected) = (Vec::new(), Vec::new());
        let plain = Some(Compression::Plain);
        let outcome = cut([Cursor::new(form.clone())], .., plain, &mut repaired).unwrap();
        assert_eq!((outcome.was_truncated, outcome.damaged_parts), (false, 0));
        repair(Cursor::new(sink.bytes()), &mut expected).unwrap();
        assert!(repaired == expected);
        let mut cut_out = Vec::new();
        cut([Cursor::new(form.clone())], part.clone(), plain, &mut cut_out).unwrap();
        assert!(cut_out == expected_part);

        let replayed = replayed(open(), Window::DETECTION).await;
        let told = |scan: &Scan| (scan.raw_values().collect::<Vec<_>>(), scan.times().stamp);
        assert!(replayed.iter().map(told).eq(scans.iter().map(told)));
    }
}

/// Replies before the metadata are kept in memory, and compressed ones are short in the file.
#[test]
fn long_compressed_messages_do_not_fill_the_memory() {
    let channel = of_kind(0x04, &channel_content(0, "/scip/replies"));
    let records = [channel, reply(4_000_000)].concat();
    let chunk = compressed_chunk("zstd", records.len() as u64, &compress("zstd", &records));
    let file = [MAGIC, &chunk.repeat(50)].concat();
    let counted = allocation_counter::measure(|| {
        let recording = Recording::read(Cursor::new(file)).unwrap();
        assert_eq!(recording.map(Result::unwrap).count(), 50);
    });
    assert!(counted.bytes_max < 40_000_000, "{} bytes in memory", counted.bytes_max);
}

#[tokio::test(start_paused = true)]
async fn a_compressed_part_is_reached_by_index() {
    let (sink, forms) = recorded(Window::DETECTION, 100).await;
    let place = Duration::from_secs(7);
    let expected: Vec<_> = sink.open().range(place..).collect::<Result<_, _>>().unwrap();
    assert!(expected.len() > 20);
    for (form, name) in forms.into_iter().zip(["part_zstd.mcap", "part_lz4.mcap"]) {
        // Damage before the part shows whether it was read.
        let mut damaged = form;
        let middle = damaged.len() / 2;
        damaged[middle] ^= 1;
        let recording = Recording::open(written(name, &damaged)).unwrap();
        let found: Vec<_> = recording.range(place..).collect::<Result<_, _>>().unwrap();
        assert_eq!(found, expected);
        let items: Vec<_> = Recording::read(Cursor::new(damaged)).unwrap().range(place..).collect();
        assert_eq!(damaged_at(&items).len(), 1);
    }
}

#[tokio::test(start_paused = true)]
async fn a_damaged_compressed_byte_costs_one_chunk() {
    let (sink, forms) = recorded(window(300, 310, 1), 50).await;
    let records = sink.records();
    for form in forms {
        let chunks: Vec<usize> = chunks(&form);
        let (from, to) = (chunks[1], chunks[2]);
        for at in (from..to).step_by(7) {
            let mut damaged = form.clone();
            damaged[at] ^= 0x11;
            let mut recording = Recording::read(Cursor::new(damaged.clone())).unwrap();
            let items: Vec<_> = recording.by_ref().collect();
            let damage = damaged_at(&items);
            assert!(!recording.is_truncated(), "{at}");
            let found: Vec<_> = items.into_iter().flatten().collect();
            let outcome = repair(Cursor::new(damaged), &mut Vec::new()).unwrap();
            assert_eq!(outcome.damaged_at, damage, "{at}");
            match damage[..] {
                // Times, which the reader does not use, and the lists after the chunk.
                [] => assert_eq!(found, records, "{at}"),
                [place] => {
                    assert!(place >= from as u64 && place <= at as u64, "{at}: {place}");
                    assert!(found.iter().all(|record| records.contains(record)), "{at}");
                    assert!(found.len() * 2 > records.len(), "{at}: {}", found.len());
                }
                _ => panic!("{at}: {damage:?}"),
            }
        }
    }
}

/// Positions of a file's chunks, and of its end.
fn chunks(file: &[u8]) -> Vec<usize> {
    let mut at = MAGIC.len();
    let mut chunks = Vec::new();
    while file[at] != 0x0f {
        if file[at] == 0x06 {
            chunks.push(at);
        }
        at += 9 + u64_at(file, at + 1) as usize;
    }
    chunks.push(at);
    chunks
}

#[tokio::test(start_paused = true)]
async fn a_truncated_compressed_recording_is_read() {
    let (sink, forms) = recorded(window(300, 340, 1), 50).await;
    let records = sink.records();
    for form in forms {
        let chunks = chunks(&form);
        let mut most = 0;
        for length in (9..form.len()).step_by(83) {
            let cut_off = form[..length].to_vec();
            let mut recording = Recording::read(Cursor::new(cut_off.clone())).unwrap();
            let found: Vec<_> = recording.by_ref().collect::<Result<_, _>>().unwrap();
            assert!(recording.is_truncated(), "{length} bytes");
            assert_eq!(found, records[..found.len()], "{length} bytes");
            // No whole chunk is lost.
            assert!(found.len() >= most, "{length} bytes");
            most = found.len();
            let mut repaired = Vec::new();
            let outcome = repair(Cursor::new(cut_off), &mut repaired).unwrap();
            assert_eq!((outcome.was_truncated, outcome.damaged_parts), (true, 0));
            let again: Vec<_> =
                Sink::with_bytes(&repaired).open().collect::<Result<_, _>>().unwrap();
            assert_eq!(again, found, "{length} bytes");
        }
        assert!(chunks.len() > 3);
        assert_eq!(most, records.len());
    }
}

/// Makes zstd of this number of blocks of 128 KiB of zeros, each of them 4 bytes, with a window of 2
/// to the power of `window` KiB.
fn zstd_of_zeros(blocks: usize, window: u8) -> Vec<u8> {
    let block = |is_last: u32| ((128_u32 << 10) << 3) | (1 << 1) | is_last;
    let block = |is_last| [&block(is_last).to_le_bytes()[..3], &[0]].concat();
    let head = [0x28, 0xb5, 0x2f, 0xfd, 0, window << 3];
    [&head[..], &block(0).repeat(blocks - 1), &block(1)].concat()
}

/// Returns 32 KiB that become 1 GiB.
fn zstd_bomb(window: u8) -> Vec<u8> {
    zstd_of_zeros(8192, window)
}

#[test]
fn an_oversized_chunk_takes_no_memory() {
    const MIB: u64 = 1 << 20;
    let small_chunk = compress("zstd", &[channel(), event(0)].concat());
    let claimed = (channel().len() + event(0).len()) as u64;
    for (name, chunk, most) in [
        ("1 GiB of zstd", compressed_chunk("zstd", 1000, &zstd_bomb(10)), 4 * MIB),
        ("8 MiB of lz4", compressed_chunk("lz4", 1000, &compress("lz4", &[0; 8 << 20])), MIB),
        ("a window of 64 MiB", compressed_chunk("zstd", 1000, &zstd_bomb(16)), MIB),
        ("a window of 1 TiB", compressed_chunk("zstd", 1000, &zstd_bomb(30)), MIB),
        (
            "64 MiB and a block",
            compressed_chunk("zstd", 64 * MIB + (128 << 10), &zstd_of_zeros(513, 10)),
            MIB,
        ),
        ("a claim of 2^64 - 1", compressed_chunk("lz4", u64::MAX, &[]), MIB),
        ("a claim of 64 MiB", compressed_chunk("zstd", 64 * MIB, &small_chunk), MIB),
        ("a byte more", compressed_chunk("zstd", claimed - 1, &small_chunk), MIB),
        ("a byte less", compressed_chunk("zstd", claimed + 1, &small_chunk), MIB),
        ("no head", compressed_chunk("zstd", claimed, b"zstd?"), MIB),
        ("no bytes", compressed_chunk("lz4", claimed, &[]), MIB),
        ("another compression", compressed_chunk("lz4", claimed, &small_chunk), MIB),
    ] {
        let plain = chunk_of(&[channel(), event(0)].concat());
        let file = [MAGIC, &plain, &chunk, &plain, &end()].concat();
        let place = 8 + plain.len() as u64;
        let counted = allocation_counter::measure(|| {
            assert_eq!(read(&file), (vec![place], 2, false), "{name}");
            let outcome = repair(Cursor::new(file.clone()), &mut Vec::new()).unwrap();
            assert_eq!((outcome.damaged_at, outcome.messages), (vec![place], 2), "{name}");
        });
        let most = most + 4 * file.len() as u64;
        assert!(counted.bytes_max < most, "{name}: {} bytes in memory", counted.bytes_max);
    }
}

/// Each chunk has a schema of a megabyte and a message of its type.
#[test]
fn compressed_schemas_do_not_fill_the_memory() {
    const MIB: usize = 1 << 20;
    let chunk = |number: u8| {
        let channel = [&[number, 0, number, 0][..], &text("/a"), &text("cdr"), &[0; 4]].concat();
        let name = text(&format!("a/msg/A{number}"));
        let definition = [&1_000_000_u32.to_le_bytes()[..], &vec![b' '; 1_000_000]].concat();
        let schema = [&[number, 0][..], &name, &text("ros2msg"), &definition].concat();
        let message = [&[number][..], &[0; 21]].concat();
        let records =
            [of_kind(0x03, &schema), of_kind(0x04, &channel), of_kind(0x05, &message)].concat();
        compressed_chunk("lz4", records.len() as u64, &compress("lz4", &records))
    };
    let chunks: Vec<u8> = (1..=120).flat_map(chunk).collect();
    let file = [MAGIC, &chunks, &end()].concat();
    assert!(file.len() < 2 * MIB);
    let counted = allocation_counter::measure(|| {
        let outcome = repair(Cursor::new(file), std::io::sink()).unwrap();
        // Those whose schema did not fit have none.
        assert_eq!((outcome.messages, outcome.damaged_parts), (120, 53));
    });
    // The definitions of the file, and the definitions of its copy twice: for its chunks, and for its index.
    let most = (3 * 64 + 16) * MIB as u64;
    assert!(counted.bytes_max < most, "{} bytes in memory", counted.bytes_max);
}

#[test]
fn a_small_chunk_may_have_a_window_of_8_mib() {
    let event = event(0);
    // The only block is the last one, stored as it is.
    let records = [channel(), event].concat();
    let block = ((records.len() as u32) << 3) | 1;
    let frame =
        [&[0x28, 0xb5, 0x2f, 0xfd, 0, 13 << 3][..], &block.to_le_bytes()[..3], &records].concat();
    let chunk = compressed_chunk("zstd", records.len() as u64, &frame);
    assert_eq!(read(&[MAGIC, &chunk, &end()].concat()), (vec![], 1, false));
}

#[test]
fn a_compressed_chunk_with_a_wrong_checksum_is_damaged() {
    let records = [channel(), event(0)].concat();
    for compression in ["zstd", "lz4"] {
        let bytes = compress(compression, &records);
        let mut chunk = compressed_chunk(compression, records.len() as u64, &bytes);
        chunk[9 + 24..][..4].copy_from_slice(&crc32fast::hash(&records).to_le_bytes());
        assert_eq!(read(&[MAGIC, &chunk, &end()].concat()), (vec![], 1, false));
        chunk[9 + 24] ^= 1;
        assert_eq!(read(&[MAGIC, &chunk, &end()].concat()), (vec![8], 0, false));
    }
}

#[test]
fn a_truncated_chunk_takes_no_memory() {
    let chunk = compressed_chunk("zstd", 1000, &zstd_bomb(10));
    let file = [MAGIC, &chunk[..chunk.len() - 1]].concat();
    let counted = allocation_counter::measure(|| {
        // Zeros are no records.
        assert_eq!(read(&file), (vec![8], 0, true));
    });
    assert!(counted.bytes_max < 4 << 20, "{} bytes in memory", counted.bytes_max);
}
