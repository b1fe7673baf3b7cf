//! Recorders that begin and end while a sensor is in use.

use std::io::Cursor;

use tokio_scip::{Rate, Scan, ScanStream, Sensor, Window};
use urg_emulator::Emulator;
use urg_recording::{Entry, Recorder, Recording, ReplayPace};

use super::sink::{Sink, values};

const WINDOW: Window = Window::DETECTION;

async fn next(scans: &mut ScanStream, count: usize, recorder: Option<&mut Recorder>) -> Vec<Scan> {
    let mut taken = Vec::new();
    let mut recorder = recorder;
    for _ in 0..count {
        let item = scans.next().await.unwrap();
        if let Some(recorder) = &mut recorder {
            recorder.record(&item).unwrap();
        }
        taken.push(item.unwrap());
    }
    taken
}

/// Replays a file. Returns the serial number of its sensor, and its scans.
async fn replayed(sink: &Sink) -> (String, Vec<Scan>) {
    let emulator = sink.open().replay(ReplayPace::Max).unwrap();
    let sensor = Sensor::builder().depth(100).connect(emulator).await.unwrap();
    let serial_number = sensor.version().await.unwrap().serial_number.to_string();
    let mut scans = sensor.scans(WINDOW, Rate::UNLIMITED).await.unwrap();
    let mut all = Vec::new();
    while let Some(scan) = scans.next().await {
        all.push(scan.unwrap());
    }
    (serial_number, all)
}

#[tokio::test(start_paused = true)]
async fn a_sensor_in_use_is_recorded_and_replayed() {
    let sensor = Sensor::builder().depth(100).connect(Emulator::default()).await.unwrap();
    let serial_number = sensor.version().await.unwrap().serial_number.to_string();
    let mut scans = sensor.scans(WINDOW, Rate::hz(5.0)).await.unwrap();
    next(&mut scans, 3, None).await;

    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    recorder.observe(&sensor);
    recorder.describe(&sensor, &scans).await.unwrap();
    let recorded = next(&mut scans, 10, Some(&mut recorder)).await;
    let progress = recorder.finish().await.unwrap();
    next(&mut scans, 3, None).await;

    assert_eq!((progress.scans, progress.lost), (10, 0));
    // The version, and a reply to each poll.
    assert_eq!((progress.replies, progress.lost_replies), (11, 0));
    assert_eq!(sink.open().window(), Some(WINDOW));
    let read: Vec<Scan> = sink.open().scans().map(Result::unwrap).collect();
    assert_eq!(values(&read), values(&recorded));
    let (serial, replayed) = replayed(&sink).await;
    assert_eq!((serial, values(&replayed)), (serial_number, values(&recorded)));
}

#[tokio::test(start_paused = true)]
async fn an_older_version_begins_the_recording() {
    let sensor = Sensor::builder().connect(Emulator::default()).await.unwrap();
    tokio::time::sleep(std::time::Duration::from_secs(3600)).await;
    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    recorder.observe(&sensor);
    sensor.scan(WINDOW).await.unwrap();
    recorder.finish().await.unwrap();
    let records = sink.records();
    let [version, poll] = &records[..] else { panic!("{records:?}") };
    assert!(matches!(&version.entry, Entry::Reply(reply) if reply.bytes.starts_with(b"V\n0\n")));
    let between = poll.at.duration_since(version.at).unwrap();
    assert!(between < std::time::Duration::from_secs(1), "{between:?}");
}

#[tokio::test(start_paused = true)]
async fn two_recorders_record_one_sensor() {
    let sensor = Sensor::builder().depth(100).connect(Emulator::default()).await.unwrap();
    let (long, short) = (Sink::new(), Sink::new());
    let mut recorders = [&long, &short].map(|sink| {
        let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
        recorder.observe(&sensor);
        // A second call does not record each reply twice.
        recorder.observe(&sensor);
        recorder
    });
    sensor.scan(WINDOW).await.unwrap();
    let [long_recorder, short_recorder] = &mut recorders;
    assert_eq!((long_recorder.progress().replies, short_recorder.progress().replies), (3, 3));
    let [long_recorder, short_recorder] = recorders;
    short_recorder.finish().await.unwrap();
    sensor.scan(WINDOW).await.unwrap();
    long_recorder.finish().await.unwrap();
    let polls = |sink: &Sink| {
        let recording = Recording::read(Cursor::new(sink.bytes())).unwrap();
        recording.scans().map(Result::unwrap).count()
    };
    assert_eq!((polls(&long), polls(&short)), (2, 1));
}
