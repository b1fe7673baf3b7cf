//! Recorded scans as [`Scan`]s, without a replay.

use std::io::Cursor;
use std::time::Duration;

use tokio_scip::emulator::{Fault, Faults};
use tokio_scip::recording::{Recorder, RecordingError, ReplayPace};
use tokio_scip::{Rate, Scan, Sensor, Window};

use super::sink::{Sink, record, sensor, window};

/// An example of a function that is written for live scans.
fn summary(scan: &Scan) -> (Window, Vec<u16>, std::time::SystemTime, u64, f32, bool) {
    let values = scan.values().to_vec();
    (scan.window(), values, scan.stamp(), scan.sequence(), scan.scan_time(), scan.is_repeat())
}

#[tokio::test(start_paused = true)]
async fn recorded_scans_are_those_that_the_driver_delivered() {
    for window in [Window::DETECTION, Window::FULL, window(2, 2, 1), window(100, 103, 3)] {
        let sink = Sink::new();
        let delivered = record(sensor(), &sink, window, 20).await;
        let delivered: Vec<Scan> = delivered.into_iter().map(Result::unwrap).collect();
        let scans: Vec<Scan> = sink.open().scans().collect::<Result<_, _>>().unwrap();
        assert_eq!(
            scans.iter().map(summary).collect::<Vec<_>>(),
            delivered.iter().map(summary).collect::<Vec<_>>(),
            "{window}"
        );
        let times: Vec<_> =
            scans.windows(2).map(|pair| pair[1].received_at() - pair[0].received_at()).collect();
        let live: Vec<_> = delivered
            .windows(2)
            .map(|pair| pair[1].received_at() - pair[0].received_at())
            .collect();
        let is_near = |(a, b): (&Duration, &Duration)| a.abs_diff(*b) < Duration::from_millis(1);
        assert!(times.iter().zip(&live).all(is_near), "{times:?} {live:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn refused_and_malformed_replies_are_skipped_and_a_missing_end_ends_the_scans() {
    let sink = Sink::new();
    let emulator = sensor();
    emulator.set_faults(Faults::none().at(5, Fault::Drop(700..701)).at(9, Fault::Status(b'7')));
    let delivered = record(emulator, &sink, Window::DETECTION, 10).await;
    assert!(delivered.iter().any(Result::is_err));
    let mut scans = sink.open().scans();
    let values: Vec<_> = scans.by_ref().map(|scan| scan.unwrap().values().to_vec()).collect();
    let expected: Vec<_> = delivered.iter().flatten().map(|scan| scan.values().to_vec()).collect();
    assert_eq!(values, expected);
    assert!(scans.next().is_none() && !scans.is_truncated());
}

#[tokio::test(start_paused = true)]
async fn a_recording_without_replies_is_an_error_and_not_an_empty_replay() {
    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let sensor = Sensor::builder().connect(sensor()).await.unwrap();
    recorder.record(&sensor.scan(Window::DETECTION).await).unwrap();
    recorder.finish().await.unwrap();
    let items: Vec<_> = sink.open().scans().collect();
    assert!(matches!(items[..], [Err(RecordingError::NoReplies)]), "{items:?}");
}

#[tokio::test(start_paused = true)]
async fn a_damaged_chunk_is_an_item_between_the_scans() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 600).await;
    let mut file = sink.bytes();
    let middle = file.len() / 2;
    file[middle] ^= 1;
    let recording = tokio_scip::recording::Recording::read(Cursor::new(file)).unwrap();
    let items: Vec<_> = recording.scans().collect();
    let at = items.iter().position(Result::is_err).unwrap();
    assert!(matches!(items[at], Err(RecordingError::Damaged { .. })));
    assert!(at > 0 && items.len() > at + 100, "{at} of {}", items.len());
    assert_eq!(items.iter().filter(|item| item.is_err()).count(), 1);
}

#[tokio::test(start_paused = true)]
async fn a_part_of_a_recording_has_the_scans_of_its_time_and_no_others() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 50).await;
    let all: Vec<Scan> = sink.open().scans().collect::<Result<_, _>>().unwrap();
    let (from, to) = (Duration::from_secs(1), Duration::from_secs(3));
    let is_inside =
        |scan: &&Scan| (from..to).contains(&(scan.received_at() - all[0].received_at()));
    let expected: Vec<_> = all.iter().filter(is_inside).map(|scan| scan.values()).collect();
    assert!((15..=25).contains(&expected.len()), "{}", expected.len());
    let part: Vec<Scan> = sink.open().range(from..to).scans().collect::<Result<_, _>>().unwrap();
    assert_eq!(part.iter().map(Scan::values).collect::<Vec<_>>(), expected);

    let replay = sink.open().range(from..to).replay(ReplayPace::Recorded).unwrap();
    let sensor = Sensor::builder().reconnect(false).ring_depth(64).connect(replay).await.unwrap();
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let mut replayed = Vec::new();
    while let Some(Ok(scan)) = scans.next().await {
        replayed.push(scan.values().to_vec());
    }
    assert_eq!(replayed, expected);
    // A part without a scan.
    let mut none = sink.open().range(Duration::from_secs(99)..).scans();
    assert!(matches!(none.next(), Some(Err(RecordingError::NoReplies))));
}
