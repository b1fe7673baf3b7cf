//! Recordings that are split into several files.

use std::collections::VecDeque;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use tokio::time::sleep;
use tokio_scip::protocol::Command;
use tokio_scip::{Error, Rate, Sensor, Window};
use urg_recording::{
    Entry, Record, Recorder, RecorderBuilder, Recording, RecordingError, ReplayPace, cut,
};

use super::file::{truth_of, write_truth};
use super::sink::{Sink, next, observed, polls, sensor};

/// Returns an empty folder for the files of a test.
pub(super) fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

/// Records 350 scans, 35 s, and returns them.
async fn record(builder: RecorderBuilder, path: &Path) -> Vec<tokio_scip::Scan> {
    let mut recorder = builder.create(path).unwrap();
    let (sensor, mut scans) =
        observed(&recorder, sensor(), Window::DETECTION, Rate::hz(10.0)).await;
    recorder.describe(&sensor, &scans).await.unwrap();
    let delivered = next(&mut recorder, &mut scans, 350).await;
    assert_eq!(recorder.progress().lost, 0);
    recorder.finish().await.unwrap();
    delivered
}

/// Returns the files of a recording, in order.
pub(super) fn parts(path: &Path) -> Vec<PathBuf> {
    let name = path.file_stem().unwrap().to_str().unwrap();
    let numbered = (2..).map(|n| path.with_file_name(format!("{name}_{n:04}.mcap")));
    [path.to_owned()].into_iter().chain(numbered.take_while(|path| path.exists())).collect()
}

fn read(path: &Path) -> Vec<Record> {
    let mut recording = Recording::open(path).unwrap();
    let records = recording.by_ref().collect::<Result<_, _>>().unwrap();
    assert!(!recording.is_truncated());
    records
}

/// Returns the numbers of the scans in a file.
fn scans(records: &[Record]) -> Vec<u32> {
    let scans = records.iter().filter(|record| matches!(record.entry, Entry::Scan(_)));
    scans.map(|record| record.sequence).collect()
}

fn is_version(record: &Record) -> bool {
    matches!(&record.entry, Entry::Reply(reply) if reply.command == Some(Command::Version))
}

#[tokio::test(start_paused = true)]
async fn each_file_of_a_split_recording_replays_alone() {
    let folder = folder("split");
    for (name, builder, count) in [
        ("duration", Recorder::builder().split_duration(Duration::from_secs(10)), 4),
        ("bytes", Recorder::builder().split_bytes(400_000), 4),
    ] {
        let path = folder.join(format!("{name}.mcap"));
        let delivered = record(builder, &path).await;
        let parts = parts(&path);
        assert_eq!(parts.len(), count, "{name}");
        let mut all = Vec::new();
        for part in &parts {
            let records = read(part);
            let scans = scans(&records);
            assert_eq!(polls(&records).len(), scans.len(), "{part:?}");
            let began = records.iter().map(|record| record.at).min().unwrap();
            let ended = records.iter().map(|record| record.at).max().unwrap();
            let seconds = ended.duration_since(began).unwrap().as_secs_f64();
            assert!(seconds <= 12.0, "{part:?}: {seconds} s");
            // Each file has the sensor's identity, so that it replays without the others.
            assert!(records.iter().any(is_version), "{part:?}");
            let replay = Recording::open(part).unwrap().replay(ReplayPace::Max).unwrap();
            let builder = Sensor::builder().depth(1 << 10);
            let sensor = builder.connect(replay).await.unwrap();
            let serial_number = sensor.version().await.unwrap().serial_number.clone();
            assert_eq!(
                serial_number.to_string(),
                Recording::open(part).unwrap().metadata()["serial_number"]
            );
            let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
            let mut replayed = Vec::new();
            while let Some(Ok(scan)) = stream.next().await {
                replayed.push(scan.raw_values().collect::<Vec<_>>());
            }
            assert_eq!(replayed.len(), scans.len(), "{part:?}");
            all.extend(replayed);
            write_truth(&part.with_extension("txt"), &truth_of(&delivered, &scans));
        }
        let delivered: Vec<_> =
            delivered.iter().map(|scan| scan.raw_values().collect::<Vec<_>>()).collect();
        assert!(all == delivered, "{name}: {} scans of {}", all.len(), delivered.len());
        // Each file repeats the sensor's version, and a part of several has it once.
        let mut part = Vec::new();
        let inputs: Vec<_> = parts.iter().map(|part| fs::File::open(part).unwrap()).collect();
        let range = Duration::from_secs(3)..Duration::from_secs(25);
        cut(inputs, range, None, &mut part).unwrap();
        let records = Sink::with_bytes(&part).records();
        assert_eq!(records.iter().filter(|record| is_version(record)).count(), 1, "{name}");
    }
}

#[tokio::test(start_paused = true)]
async fn no_file_is_overwritten_by_a_further_one() {
    let path = folder("split-exists").join("run.mcap");
    let mut recorder =
        Recorder::builder().split_duration(Duration::from_secs(1)).create(&path).unwrap();
    let taken = path.with_file_name("run_0002.mcap");
    fs::write(&taken, "precious").unwrap();
    let sensor = Sensor::builder().connect(sensor()).await.unwrap();
    for _ in 0..2 {
        recorder.record(&sensor.scan(Window::DETECTION).await).unwrap();
        sleep(Duration::from_secs(2)).await;
    }
    recorder.finish().await.unwrap();
    assert_eq!(fs::read(&taken).unwrap(), b"precious");
    let (first, second) = (read(&path), read(&path.with_file_name("run_0003.mcap")));
    assert_eq!((scans(&first).len(), scans(&second).len()), (1, 1));
}

#[test]
fn files_of_another_recording_prevent_a_new_one() {
    let path = folder("split-older").join("run.mcap");
    let taken = path.with_file_name("run_0003.mcap");
    fs::write(&taken, "precious").unwrap();
    for overwrite in [false, true] {
        match Recorder::builder().overwrite(overwrite).create(&path).unwrap_err() {
            RecordingError::Exists { path } => assert_eq!(path, taken),
            other => panic!("{other:?}"),
        }
        assert!(!path.exists());
    }
}

#[tokio::test]
async fn a_second_recorder_of_the_same_parts_is_refused() {
    let path = folder("split-busy").join("run.mcap");
    fs::write(&path, "older").unwrap();
    let builder = Recorder::builder().keep_bytes(300_000);
    // It would take every second number.
    let first = builder.clone().create(&path).unwrap();
    let busy = builder.clone().create(&path).unwrap_err();
    assert!(matches!(busy, RecordingError::Busy { .. }), "{busy:?}");
    first.finish().await.unwrap();
    builder.create(&path).unwrap();
}

#[tokio::test]
async fn an_old_file_that_cannot_be_removed_is_told() {
    for (is_folder, is_gone) in [(false, false), (true, false), (false, true)] {
        let path = folder("split-stuck").join("run.mcap");
        fs::write(&path, [0; 1000]).unwrap();
        let mut recorder = Recorder::builder().keep_bytes(4000).create(&path).unwrap();
        if is_folder || is_gone {
            fs::remove_file(&path).unwrap();
        }
        if is_folder {
            fs::create_dir(&path).unwrap();
        }
        let scan = tokio_scip::Scan::builder(Window::DETECTION, [500; 682]).build().unwrap();
        recorder.record(&Ok(scan)).unwrap();
        assert_eq!(recorder.finish().await.unwrap().cannot_remove, is_folder);
        assert_eq!(path.exists(), is_folder);
    }
}

#[tokio::test]
async fn old_files_are_removed_before_the_first_message() {
    let path = folder("split-empty").join("run.mcap");
    let second = path.with_file_name("run_0002.mcap");
    let record = async |builder: RecorderBuilder, path| {
        builder.create(path).unwrap().finish().await.unwrap();
    };
    record(Recorder::builder(), &path).await;
    let file = fs::read(&path).unwrap();
    // Its index does not count while it is written.
    let end_of_data = [0x0f, 4, 0, 0, 0, 0, 0, 0, 0];
    let length = file.windows(9).position(|part| part == end_of_data).unwrap();
    for (missing, is_kept) in [(0, true), (1, false)] {
        fs::write(&path, &file).unwrap();
        let keep = (file.len() + length - missing) as u64;
        record(Recorder::builder().keep_bytes(keep), &path).await;
        assert_eq!((path.exists(), second.exists()), (is_kept, true));
        fs::remove_file(&second).unwrap();
    }
}

/// The consumer is so far behind that a scan is outstanding at each place where the file could be
/// split.
#[tokio::test(start_paused = true)]
async fn a_slow_consumer_does_not_prevent_splitting() {
    let path = folder("split-behind").join("run.mcap");
    let mut recorder =
        Recorder::builder().split_duration(Duration::from_secs(5)).create(&path).unwrap();
    let builder = Sensor::builder().on_reply(recorder.observer()).depth(64);
    let sensor = builder.connect(sensor()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let mut behind = VecDeque::new();
    while behind.len() < 8 {
        behind.push_back(stream.next().await.unwrap());
    }
    for _ in 0..100 {
        behind.push_back(stream.next().await.unwrap());
        recorder.record(&behind.pop_front().unwrap()).unwrap();
    }
    recorder.finish().await.unwrap();
    let numbers: Vec<_> = parts(&path).iter().flat_map(|part| scans(&read(part))).collect();
    assert_eq!(parts(&path).len(), 2);
    assert_eq!(numbers, (0..100).collect::<Vec<_>>());
}

/// Its name is too long.
#[tokio::test(start_paused = true)]
async fn the_last_file_is_complete_if_no_other_can_be_created() {
    let path = folder("split-long").join("x".repeat(248) + ".mcap");
    let mut recorder =
        Recorder::builder().split_duration(Duration::from_secs(1)).create(&path).unwrap();
    let sensor = Sensor::builder().connect(sensor()).await.unwrap();
    let mut item: Result<_, Error> = sensor.scan(Window::DETECTION).await;
    recorder.record(&item).unwrap();
    sleep(Duration::from_secs(2)).await;
    item = sensor.scan(Window::DETECTION).await;
    let _ = recorder.record(&item);
    let error = recorder.finish().await.unwrap_err();
    let cause = std::error::Error::source(&error).unwrap().to_string();
    assert!(cause.contains("_0002.mcap"), "{cause}");
    assert_eq!(scans(&read(&path)).len(), 1);
}

/// A file can only be split at a scan, and grows until one comes. Each event is in a chunk of its own.
#[tokio::test(start_paused = true)]
async fn a_file_split_by_its_chunks_has_an_index() {
    let path = folder("split-chunks").join("run.mcap");
    let mut recorder = Recorder::builder().sync_interval(None).create(&path).unwrap();
    let emulator = sensor();
    let sensor = Sensor::builder().connect(emulator.clone()).await.unwrap();
    emulator.unplug();
    let item = sensor.scan(Window::DETECTION).await;
    drop(sensor);
    const EVENTS: u64 = 65_010;
    for _ in 0..EVENTS {
        tokio::time::advance(Duration::from_secs(1)).await;
        recorder.record(&item).unwrap();
        recorder.ready().await;
    }
    assert_eq!(recorder.finish().await.unwrap().files, 2);
    let messages = parts(&path).into_iter().map(|path| {
        let file = fs::read(path).unwrap();
        let summary = mcap::Summary::read(&file).unwrap().expect("no index");
        summary.stats.unwrap().message_count
    });
    let messages: Vec<_> = messages.collect();
    assert!(messages[1] > 0 && messages.iter().sum::<u64>() == EVENTS, "{messages:?}");
}
