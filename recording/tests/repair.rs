//! The repair of recordings that are cut off or damaged.

use std::io::{self, Cursor};
use std::path::Path;

use tokio_scip::{Rate, Sensor, Window};
use urg_recording::{Entry, Recording, RecordingError, ReplayPace, repair};

use super::file::{truth_of, write_truth};
use super::sink::{Sink, record, sensor, window};

/// Returns all messages of a file as an independent reader finds them: by the index at
/// the file's end.
fn by_index(file: &[u8]) -> Vec<(String, u32, u64, u64, Vec<u8>)> {
    let summary = mcap::Summary::read(file).unwrap().expect("no summary");
    let mut messages = Vec::new();
    for chunk in &summary.chunk_indexes {
        for entries in summary.read_message_indexes(file, chunk).into_iter() {
            for entry in entries.values().flatten() {
                let message = summary.seek_message(file, chunk, entry).unwrap();
                let topic = message.channel.topic.clone();
                let data = message.data.into_owned();
                messages.push((
                    topic,
                    message.sequence,
                    message.log_time,
                    message.publish_time,
                    data,
                ));
            }
        }
    }
    let count = summary.stats.unwrap().message_count;
    assert_eq!(messages.len() as u64, count);
    assert_eq!(mcap::MessageStream::new(file).unwrap().count() as u64, count);
    messages.sort();
    messages
}

#[tokio::test(start_paused = true)]
async fn repair_keeps_bytes_and_stamps() {
    let sink = Sink::new();
    record(sensor(), &sink, window(300, 340, 1), 30).await;
    let (file, whole) = (sink.bytes(), by_index(&sink.bytes()));
    let mut most = 0;
    for length in (9..file.len()).step_by(41) {
        let mut repaired = Vec::new();
        let outcome = repair(Cursor::new(file[..length].to_vec()), &mut repaired).unwrap();
        let mut cut = Recording::read(Cursor::new(file[..length].to_vec())).unwrap();
        let records: Vec<_> = cut.by_ref().collect::<Result<_, _>>().unwrap();
        assert_eq!(outcome.was_truncated, cut.is_truncated(), "{length} bytes");
        // Also in the summary: only this crate reads such a file.
        assert!(outcome.was_truncated, "{length} bytes");
        assert_eq!(outcome.damaged_parts, 0, "{length} bytes");
        let mut again = Recording::read(Cursor::new(repaired.clone())).unwrap();
        let read: Vec<_> = again.by_ref().collect::<Result<_, _>>().unwrap();
        assert_eq!(format!("{read:?}"), format!("{records:?}"), "{length} bytes");
        assert!(!again.is_truncated());
        assert_eq!(again.metadata(), cut.metadata());
        if !records.is_empty() {
            let found = by_index(&repaired);
            assert!(found.iter().all(|message| whole.contains(message)), "{length} bytes");
            assert_eq!(found.len(), records.len());
        }
        most = most.max(records.len());
    }
    assert_eq!(most, whole.len());
}

/// Leaves its file for `urg/tests/recording_readers.py`.
#[tokio::test(start_paused = true)]
async fn a_damaged_truncated_file_is_repaired() {
    let sink = Sink::new();
    let items = record(sensor(), &sink, Window::DETECTION, 1000).await;
    let mut file = sink.bytes();
    let (half, cut) = (file.len() / 2, file.len() * 9 / 10);
    // In a reply, because no checksum proves the index of a chunk.
    let damaged = half + file[half..].windows(3).position(|bytes| bytes == b"G04").unwrap();
    file[damaged] ^= 1;
    file.truncate(cut);
    let items_of_file: Vec<_> = Recording::read(Cursor::new(file.clone())).unwrap().collect();
    let errors: Vec<_> = items_of_file.iter().filter_map(|item| item.as_ref().err()).collect();
    let [RecordingError::Damaged { offset, .. }] = errors[..] else { panic!("{errors:?}") };
    assert!((*offset as usize) < damaged);
    let mut repaired = Vec::new();
    let outcome = repair(Cursor::new(file), &mut repaired).unwrap();
    assert!(outcome.was_truncated);
    assert_eq!(outcome.damaged_at, [*offset]);
    let records: Vec<_> = items_of_file.iter().flatten().collect();
    assert_eq!(by_index(&repaired).len(), records.len());
    let scans = records.iter().filter(|record| matches!(record.entry, Entry::Scan(_)));
    let numbers: Vec<u32> = scans.map(|record| record.sequence).collect();
    assert!(numbers.len() > 600 && numbers.len() < 900, "{} scans", numbers.len());

    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    std::fs::write(folder.join("repaired.mcap"), repaired).unwrap();
    let scans: Vec<_> = items.into_iter().map(Result::unwrap).collect();
    write_truth(&folder.join("repaired.txt"), &truth_of(&scans, &numbers));
}

#[test]
fn a_file_that_is_not_a_recording_is_not_repaired() {
    let mut out = Vec::new();
    let error = repair(Cursor::new(b"precious".to_vec()), &mut out).unwrap_err();
    assert!(matches!(error, RecordingError::NotMcap), "{error:?}");
    assert!(out.is_empty());
    let error = repair(io::empty(), Sink::with_room(0)).unwrap_err();
    assert!(matches!(error, RecordingError::Write { .. }), "{error:?}");
}

#[tokio::test(start_paused = true)]
async fn a_truncated_file_replays_the_same_scans() {
    let sink = Sink::new();
    record(sensor(), &sink, window(300, 340, 1), 30).await;
    let file = sink.bytes();
    for length in (0..file.len()).step_by(419) {
        let open = || Recording::read(Cursor::new(file[..length].to_vec())).unwrap();
        let scans: Vec<_> = open().scans().filter_map(Result::ok).collect();
        let Ok(replay) = open().replay(ReplayPace::Max) else {
            assert!(scans.is_empty(), "{length} bytes");
            continue;
        };
        let builder = Sensor::builder().depth(64);
        let sensor = builder.connect(replay).await.unwrap();
        let mut stream = sensor.scans(window(300, 340, 1), Rate::UNLIMITED).await.unwrap();
        let mut replayed = Vec::new();
        while let Some(Ok(scan)) = stream.next().await {
            replayed.push((scan.raw_values().collect::<Vec<_>>(), scan.times().stamp));
        }
        let scans: Vec<_> = scans
            .iter()
            .map(|scan| (scan.raw_values().collect::<Vec<_>>(), scan.times().stamp))
            .collect();
        assert_eq!(scans, replayed, "{length} bytes");
    }
}

#[tokio::test(start_paused = true)]
async fn a_damaged_first_sector_costs_one_chunk() {
    let (file, whole) = (two_chunks().await, by_index(&two_chunks().await).len());
    let first = mcap::Summary::read(&file).unwrap().unwrap().chunk_indexes[0].clone();
    let messages = mcap::MessageStream::new(&file).unwrap();
    let end = first.message_end_time;
    let lost = messages.filter(|message| message.as_ref().unwrap().log_time <= end).count();
    assert!(lost < whole);
    for (at, width) in (0..512).map(|at| (at, 1)).chain([(0, 512)]) {
        let mut damaged = file.clone();
        damaged[at..at + width].iter_mut().for_each(|byte| *byte ^= 0x21);
        let mut repaired = Vec::new();
        let outcome = repair(Cursor::new(damaged.clone()), &mut repaired).unwrap();
        // The header has no checksum.
        assert!(outcome.damaged_parts == 1 || (8..100).contains(&at), "byte {at}: {outcome:?}");
        assert!(by_index(&repaired).len() + lost >= whole, "byte {at}");
        let items: Vec<_> = Recording::read(Cursor::new(damaged)).unwrap().collect();
        let damaged_parts = items.iter().filter(|item| item.is_err()).count();
        let messages = items.len() - damaged_parts;
        assert_eq!(
            (outcome.damaged_parts, outcome.messages),
            (damaged_parts as u64, messages as u64),
            "byte {at}"
        );
        assert_eq!(messages, by_index(&repaired).len(), "byte {at}");
    }
}

/// Other kinds, such as those from 0x80, would be skipped as records of other programs.
#[tokio::test(start_paused = true)]
async fn a_damaged_kind_of_chunk_is_reported() {
    let file = two_chunks().await;
    let chunk = mcap::Summary::read(&file).unwrap().unwrap().chunk_indexes[0].clone();
    let at = chunk.chunk_start_offset;
    for kind in (0..=u8::MAX).filter(|kind| *kind != file[at as usize]) {
        let mut damaged = file.clone();
        damaged[at as usize] = kind;
        let outcome = repair(Cursor::new(damaged), &mut Vec::new()).unwrap();
        assert_eq!(outcome.damaged_at, [at], "kind {kind:#x}");
    }
}

/// Makes a file of several chunks, 10 kB.
async fn two_chunks() -> Vec<u8> {
    let sink = Sink::new();
    record(sensor(), &sink, window(300, 310, 1), 20).await;
    sink.bytes()
}

/// As the readers that begin with the index see it.
#[tokio::test(start_paused = true)]
async fn a_damaged_index_is_known_and_repaired() {
    let file = two_chunks().await;
    let data_end = [0x0f, 4, 0, 0, 0, 0, 0, 0, 0];
    let mut expected = Vec::new();
    repair(Cursor::new(file.clone()), &mut expected).unwrap();
    let start = file.windows(9).position(|bytes| bytes == data_end).unwrap();
    for at in start + 13..file.len() {
        let mut damaged = file.clone();
        damaged[at] ^= 4;
        let mut repaired = Vec::new();
        let outcome = repair(Cursor::new(damaged.clone()), &mut repaired).unwrap();
        assert!(outcome.was_truncated, "byte {at}");
        assert_eq!(outcome.damaged_parts, 0, "byte {at}");
        assert!(repaired == expected, "byte {at}");
        let mut read = Recording::read(Cursor::new(damaged)).unwrap();
        assert!(read.by_ref().all(|item| item.is_ok()) && read.is_truncated(), "byte {at}");
    }
    // An index that is whole, of a file that has lost or gained bytes before or after it.
    for (changed, parts) in [
        ([&file[..], b"\0"].concat(), 0),
        ([&file[..start], &[0x80, 0, 0, 0, 0, 0, 0, 0, 0], &file[start..]].concat(), 0),
    ] {
        let outcome = repair(Cursor::new(changed), &mut Vec::new()).unwrap();
        assert_eq!((outcome.was_truncated, outcome.damaged_parts), (true, parts));
    }
}

/// A pipe has no index to take the definition from.
#[tokio::test(start_paused = true)]
async fn messages_keep_their_type_without_its_definition() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 30).await;
    let mut file = sink.bytes();
    // In the first chunk, which has the schemas.
    file[200] ^= 1;
    let mut repaired = Vec::new();
    assert_eq!(repair(Cursor::new(file), &mut repaired).unwrap().damaged_parts, 1);
    let mut messages = mcap::MessageStream::new(&repaired).unwrap();
    assert!(messages.all(|message| message.unwrap().channel.schema.is_some()));
}
