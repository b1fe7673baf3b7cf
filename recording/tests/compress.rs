//! Compressed recordings: chunks that a recorder and a copy compress (feature `zstd`).

use std::collections::BTreeSet;
use std::io::Cursor;

use tokio_scip::{Rate, Window};
use urg_emulator::{Emulator, Room};
use urg_recording::{Compression, Recorder, Recording, cut, repair};

use super::raw::{MAGIC, channel, chunk_of, end, event, of_kind, text};
use super::recompress::{compressed, compressions};
use super::sink::{Sink, observed};

const COMPRESSIONS: [Compression; 2] = [Compression::Lz4, Compression::Zstd];

/// Records ten scans a second of a room.
async fn recorded(compression: Compression, scans: usize) -> Vec<u8> {
    let sink = Sink::new();
    let builder = Recorder::builder().compression(compression);
    let mut recorder = builder.write_to(sink.clone()).unwrap();
    let emulator = Emulator::builder().world(Room::new(0)).build();
    let (sensor, mut stream) =
        observed(&recorder, emulator, Window::DETECTION, Rate::hz(10.0)).await;
    recorder.describe(&sensor, &stream).await.unwrap();
    for _ in 0..scans {
        recorder.record(&stream.next().await.unwrap()).unwrap();
    }
    let progress = recorder.finish().await.unwrap();
    assert_eq!((progress.lost, progress.bytes), (0, sink.bytes().len() as u64));
    sink.bytes()
}

/// Records as texts, because a range that is not a number equals none.
fn records(file: &[u8]) -> Vec<String> {
    let recording = Recording::read(Cursor::new(file.to_vec())).unwrap();
    recording.map(|record| format!("{:?}", record.unwrap())).collect()
}

#[tokio::test(start_paused = true)]
async fn a_recorder_compresses_each_second() {
    for compression in COMPRESSIONS {
        let file = recorded(compression, 100).await;
        let name = compression.to_string();
        let chunks = compressions(&file);
        assert!(chunks.len() >= 10 && chunks.iter().all(|found| *found == name), "{chunks:?}");
        let plain = compressed(&file, "");
        assert_eq!(records(&file), records(&plain));
        assert!(file.len() < plain.len() * 9 / 10, "{} of {}", file.len(), plain.len());
        // Sizes in the index and in the file.
        let mut recording = Recording::read(Cursor::new(file)).unwrap();
        assert_eq!(recording.by_ref().filter(Result::is_err).count(), 0);
        let bytes = recording.chunk_bytes();
        assert_eq!(bytes.compressions, BTreeSet::from([compression]));
        assert!(bytes.stored < bytes.plain && bytes.plain < plain.len() as u64, "{bytes:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_kill_costs_at_most_the_last_compressed_second() {
    for compression in COMPRESSIONS {
        let file = recorded(compression, 50).await;
        let all = records(&file);
        let most_in_chunk = 3 + 2 * 11;
        for part in 1..60 {
            let length = file.len() * part / 60;
            let found = records(&file[..length]);
            assert_eq!(found, all[..found.len()]);
            // As many as the plain file has there, but for one chunk.
            let expected = all.len() * part / 60;
            assert!(found.len() + 2 * most_in_chunk >= expected, "{part}: {}", found.len());
        }
    }
}

/// Some programs do not compress a chunk that would not get shorter.
#[tokio::test(start_paused = true)]
async fn a_copy_keeps_the_compression_of_later_chunks() {
    let file = recorded(Compression::Lz4, 30).await;
    let plain = chunk_of(&[channel(), event(0)].concat());
    let file = [MAGIC, &plain, &file[MAGIC.len()..]].concat();
    let mut copy = Vec::new();
    repair(Cursor::new(file), &mut copy).unwrap();
    assert!(compressions(&copy).contains(&"lz4"));
}

#[tokio::test(start_paused = true)]
async fn a_copy_keeps_changes_or_removes_compression() {
    for from in [Compression::Plain, Compression::Lz4, Compression::Zstd] {
        let file = recorded(from, 30).await;
        for to in [None, Some(Compression::Plain), Some(Compression::Lz4), Some(Compression::Zstd)]
        {
            let mut copy = Vec::new();
            let copied = cut([Cursor::new(file.clone())], .., to, &mut copy).unwrap();
            assert_eq!((copied.scans, copied.damaged_parts), (30, 0));
            let name = match to.unwrap_or(from) {
                Compression::Plain => String::new(),
                other => other.to_string(),
            };
            let chunks = compressions(&copy);
            assert!(chunks.iter().all(|found| *found == name), "{from} to {to:?}: {chunks:?}");
            assert_eq!(records(&copy), records(&file), "{from} to {to:?}");
        }
    }
}

/// A copy of several files has the strongest compression of those read so far, from its first chunk on.
#[tokio::test(start_paused = true)]
async fn joined_files_are_compressed_as_one_of_them() {
    let zeros = of_kind(0x05, &[0; 9_999]);
    let of_1970 = [MAGIC, &chunk_of(&[channel(), zeros].concat()), &end()].concat();
    let mut files = vec![Cursor::new(of_1970)];
    for compression in [Compression::Plain, Compression::Zstd, Compression::Lz4] {
        files.push(Cursor::new(recorded(compression, 30).await));
    }
    let mut joined = Vec::new();
    assert_eq!(cut(files, .., None, &mut joined).unwrap().scans, 90);
    assert!(compressions(&joined).iter().all(|name| *name == "zstd"));
}

#[test]
fn a_chunk_that_gets_no_shorter_is_plain() {
    let noise: Vec<u8> = std::iter::repeat_with(|| fastrand::u8(..)).take(9_999).collect();
    let message = of_kind(0x05, &[&[0; 2][..], &noise].concat());
    let file = [MAGIC, &chunk_of(&[channel(), message].concat()), &end()].concat();
    for compression in COMPRESSIONS {
        let mut copy = Vec::new();
        let input = Cursor::new(file.clone());
        assert_eq!(cut([input], .., Some(compression), &mut copy).unwrap().messages, 1);
        assert_eq!(compressions(&copy), [""]);
    }
}

#[tokio::test(start_paused = true)]
async fn one_damaged_name_is_no_other_compression() {
    let file = recorded(Compression::Zstd, 50).await;
    let all = records(&file).len();
    let names = file.windows(8).enumerate().filter(|(_, at)| *at == &text("zstd")[..]);
    let names: Vec<_> = names.map(|(at, _)| at + 4).collect();
    let first = names[0];
    for (at, letter) in [(first, b'Z'), (first + 3, 0), (names[2], b'q')] {
        let mut damaged = file.clone();
        damaged[at] = letter;
        let items: Vec<_> = Recording::read(Cursor::new(damaged.clone())).unwrap().collect();
        assert_eq!(items.iter().filter(|item| item.is_err()).count(), 1, "{at}");
        let found = items.iter().filter(|item| item.is_ok()).count();
        assert!(found <= all && found + 30 > all, "{at}: {found} of {all}");
        assert_eq!(repair(Cursor::new(damaged), std::io::sink()).unwrap().damaged_parts, 1);
    }
    // All of them are, as the second one tells. The metadata come before both.
    let mut other = file;
    names.into_iter().for_each(|at| other[at..at + 4].copy_from_slice(b"zpaq"));
    let error = Recording::read(Cursor::new(other)).unwrap_err();
    assert!(error.to_string().contains("`zpaq`"), "{error}");
}
