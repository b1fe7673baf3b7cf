//! Parts of recordings: which scans they have, and what of the file is read for them.

use std::io::Cursor;
use std::time::Duration;

use tokio_scip::{Rate, Window};
use urg_recording::{Record, Recorder, Recording, RecordingError};

use super::file::Folder;
use super::sink::{Sink, next, observed, record, replayed, sensor, values, window};
use crate::properties::damaged_files::of_eight_chunks;

/// Returns a recording of eight scans, each in a chunk of its own, with metadata before the first
/// and the sixth, and where its chunks begin.
fn eight_chunks() -> (Vec<u8>, Vec<usize>) {
    let file = of_eight_chunks().to_vec();
    let index = mcap::Summary::read(&file).unwrap().unwrap().chunk_indexes;
    let starts = index.iter().filter(|chunk| chunk.message_end_time > 0);
    let starts: Vec<_> = starts.map(|chunk| chunk.chunk_start_offset as usize).collect();
    assert!(starts.len() >= 8, "{starts:?}");
    (file, starts)
}

type Items = Vec<Result<Record, RecordingError>>;

/// Reads the last scan: the part from 13 s on.
fn last_scan(recording: Recording) -> Items {
    recording.range(Duration::from_secs(13)..).collect()
}

#[test]
fn a_part_is_read_without_its_past_and_future() {
    let (whole, starts) = eight_chunks();
    let mut damaged = whole.clone();
    // Damages the chunks before the last one, except those with the first scan and what
    // precedes it.
    let left_out = &starts[starts.len() - 7..starts.len() - 1];
    for start in left_out {
        damaged[start + 100] ^= 1;
    }
    let read = |file: &[u8]| Recording::read(Cursor::new(file.to_vec())).unwrap();
    let errors = last_scan(read(&damaged)).iter().filter(|item| item.is_err()).count();
    assert_eq!(errors, left_out.len());
    let folder = Folder::new("metadata-between");
    let found = last_scan(Recording::open(folder.write(&damaged)).unwrap());
    assert_eq!(format!("{found:?}"), format!("{:?}", last_scan(read(&whole))));
    // A reply to `V`, the last reply and its scan.
    assert_eq!(found.len(), 3);
    let first_scan =
        |recording: Recording| -> Items { recording.range(..Duration::from_secs(1)).collect() };
    let errors = first_scan(read(&damaged));
    assert_eq!(errors.iter().filter(|item| item.is_err()).count(), left_out.len());
    let found = first_scan(Recording::open(folder.write(&damaged)).unwrap());
    assert_eq!(format!("{found:?}"), format!("{:?}", first_scan(read(&whole))));
}

#[test]
fn a_place_where_no_record_begins_leaves_nothing_out() {
    let (whole, starts) = eight_chunks();
    let last = starts[starts.len() - 1];
    let folder = Folder::new("wrong-place");
    for (name, head) in [
        ("metadata of 2^64 - 1 bytes", [&[0x0c][..], &[0xff; 8]].concat()),
        ("metadata of 2^62 bytes", [&[0x0c][..], &(1_u64 << 62).to_le_bytes()].concat()),
        ("metadata that is none", [&[0x0c, 50][..], &[0; 7]].concat()),
        ("a chunk of the wrong length", vec![0x06, 1]),
        ("a record of no kind", vec![0]),
    ] {
        let mut file = whole.clone();
        file[last..last + head.len()].copy_from_slice(&head);
        // This damage is before the part, so that it shows whether that was read.
        file[starts[starts.len() - 3] + 100] ^= 1;
        let found = last_scan(Recording::open(folder.write(&file)).unwrap());
        let expected = last_scan(Recording::read(Cursor::new(file)).unwrap());
        assert_eq!(format!("{found:?}"), format!("{expected:?}"), "{name}");
        assert_eq!(found.iter().filter(|item| item.is_err()).count(), 2, "{name}");
    }
}

/// The driver asks for some points more in most polls. Without metadata only the polls
/// themselves show which window the stream has.
#[tokio::test(start_paused = true)]
async fn a_part_without_metadata_has_its_scans() {
    for window in [Window::DETECTION, Window::FULL, window(2, 400, 1), window(40, 99, 3)] {
        let sink = Sink::new();
        let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
        let (_sensor, mut scans) = observed(&recorder, sensor(), window, Rate::hz(10.0)).await;
        let delivered = values(&next(&mut recorder, &mut scans, 20).await);
        recorder.finish().await.unwrap();
        assert_eq!(sink.open().window(), None);
        let mut recorded = sink.open().scans();
        let mut places = Vec::new();
        while recorded.next().is_some() {
            places.push(recorded.position());
        }
        assert_eq!(places.len(), 20);
        // Fewer than four scans may all be widened.
        for (number, place) in places.into_iter().enumerate().take(17) {
            let part = || sink.open().range(place..);
            let scans = part().scans().map(|scan| scan.unwrap().raw_values().collect::<Vec<_>>());
            let rest = &delivered[number..];
            assert!(scans.eq(rest.iter().cloned()), "{window}, from {number}");
            let replayed = values(&replayed(part(), window).await);
            assert!(replayed == rest, "the replay of {window}, from {number}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_part_from_the_start_is_read_there() {
    let sink = Sink::new();
    record(sensor(), &sink, window(380, 384, 1), 20).await;
    let folder = Folder::new("from-zero");
    let path = folder.write(&sink.bytes());
    let part = Recording::open(&path).unwrap().range(..);
    assert_eq!(part.collect::<Result<Vec<_>, _>>().unwrap(), sink.records());
}
