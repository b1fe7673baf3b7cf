//! The content of a recorded file.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use tokio::time::Instant;
use tokio_scip::protocol::{Command, Reply as Parsed};
use tokio_scip::{Rate, Scan, Sensor, Window};
use urg_recording::{Entry, LaserScan, Recorder, Recording, RecordingError};

use super::sink::{Sink, polls, record, sensor, window};

/// An empty folder that is removed at the end of its test.
pub(crate) struct Folder(PathBuf);

impl Folder {
    pub(crate) fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("scip-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub(crate) fn path(&self) -> &Path {
        &self.0
    }

    /// Writes a file of these bytes.
    pub(crate) fn write(&self, bytes: &[u8]) -> PathBuf {
        let path = self.0.join("written.mcap");
        std::fs::write(&path, bytes).unwrap();
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // If this fails, the system removes it with its temporary files.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn assert_same(scan: &Scan, recorded: &LaserScan) {
    let bits = |ranges: &[f32]| ranges.iter().map(|range| range.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&scan.ranges().collect::<Vec<_>>()), bits(&recorded.ranges));
    assert_eq!(recorded.stamp, scan.first_ray_stamp());
    assert_eq!(recorded.frame_id, "laser");
    assert_eq!(
        [
            recorded.angle_min,
            recorded.angle_max,
            recorded.angle_increment,
            recorded.time_increment,
            recorded.scan_time,
            recorded.range_min,
            recorded.range_max,
        ],
        [
            scan.angle_min(),
            scan.angle_max(),
            scan.angle_increment(),
            (scan.scan_time().as_secs_f64() / 1024.0) as f32,
            scan.scan_time().as_secs_f32(),
            scan.range_min(),
            scan.range_max(),
        ]
    );
}

#[tokio::test(start_paused = true)]
async fn a_recording_is_read_as_the_driver_delivered_it() {
    let sink = Sink::new();
    let items = record(sensor(), &sink, Window::DETECTION, 30).await;
    let mut recording = sink.open();
    assert_eq!(recording.window(), Some(Window::DETECTION));
    assert_eq!(recording.rate(), Some(Rate::hz(10.0)));
    assert_eq!(recording.metadata()["serial_number"], "H0713090");
    assert_eq!(recording.metadata()["baud_rate"], "none");

    let records: Vec<_> = recording.by_ref().collect::<Result<_, _>>().unwrap();
    assert!(!recording.is_truncated());
    let scans = records.iter().filter(|record| matches!(record.entry, Entry::Scan(_)));
    let mut last = None;
    for (item, record) in items.iter().zip(scans.clone()) {
        let Entry::Scan(recorded) = &record.entry else { panic!("not a scan") };
        let scan = item.as_ref().unwrap();
        assert_same(scan, recorded);
        assert_eq!(u64::from(record.sequence), scan.sequence());
        assert!(last.replace(record.at) < Some(record.at));
    }
    assert_eq!((items.len(), scans.count()), (30, 30));

    // The reply of each scan, with the surplus points that were requested.
    let replies = polls(&records);
    for (item, reply) in items.iter().zip(&replies) {
        let scan = item.as_ref().unwrap();
        assert_eq!(reply.stamp, scan.times().stamp);
        let frame = reply.bytes.strip_suffix(b"\n\n").unwrap();
        let command = reply.command.unwrap();
        assert!(frame.starts_with(&command.bytes()));
        let parsed = Parsed::parse(&command, frame).unwrap();
        let surplus = parsed.values().len() - scan.len();
        assert!(
            scan.raw_values().eq(parsed.values()[surplus..].iter().map(|&value| u32::from(value)))
        );
    }
    assert!(replies.iter().any(|reply| reply.bytes.starts_with(b"G041725")), "no surplus groups");
    let version = records.iter().find_map(|record| match &record.entry {
        Entry::Reply(reply) if reply.command == Some(Command::Version) => Some(&reply.bytes),
        _ => None,
    });
    assert!(version.unwrap().starts_with(b"V\n0\nVEND:Hokuyo"));
    assert!(version.unwrap().ends_with(b"STAT:FW Normal[FinalDist with shadow  ]\n\n"));
}

#[tokio::test(start_paused = true)]
async fn the_log_starts_at_the_wall_clock_and_runs_steadily() {
    let (sink, second) = (Sink::new(), Duration::from_secs(1));
    tokio::time::advance(second).await;
    let wall = SystemTime::now();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let made = Instant::now();
    // One scan was received before the recorder was made.
    for at in [made - second, made + second] {
        let scan = Scan::builder(window(300, 301, 1), vec![500; 2]).received_at(at).build();
        recorder.record(&Ok(scan.unwrap())).unwrap();
    }
    recorder.finish().await.unwrap();
    let times: Vec<_> = sink.records().iter().map(|record| record.at).collect();
    assert_eq!(times[1].duration_since(times[0]).unwrap(), 2 * second);
    let late = times[1].duration_since(wall).unwrap() - second;
    assert!(late < 10 * second, "{late:?}");
}

#[tokio::test(start_paused = true)]
async fn a_file_is_overwritten_only_on_request() {
    let folder = Folder::new("exists");
    let path = folder.0.join("run.mcap");
    std::fs::write(&path, "precious").unwrap();
    let refused = Recorder::create(&path);
    assert!(matches!(refused, Err(RecordingError::Exists { .. })), "{refused:?}");
    assert_eq!(std::fs::read(&path).unwrap(), b"precious");

    let recorder = Recorder::builder().overwrite(true).create(&path).unwrap();
    recorder.finish().await.unwrap();
    assert_eq!(Recording::open(&path).unwrap().count(), 0);

    let nowhere = Recorder::create(folder.0.join("no/such/folder.mcap"));
    assert!(matches!(nowhere, Err(RecordingError::Open { .. })), "{nowhere:?}");
}

#[test]
fn a_foreign_file_is_an_explained_error() {
    let read = |bytes: &'static [u8]| Recording::read(bytes).map(drop);
    assert!(matches!(read(b"sequence,stamp,step\n1,2,3\n"), Err(RecordingError::NotMcap)));
    let open = Recording::open(Path::new("no/such/file.mcap"));
    assert!(matches!(open, Err(RecordingError::Open { .. })));
    // A file of no bytes: nothing was recorded yet.
    let replayed = Recording::read(&b""[..]).unwrap().replay(Default::default());
    assert!(matches!(replayed, Err(RecordingError::NoScans { .. })));
}

#[tokio::test(start_paused = true)]
async fn a_recorder_that_is_dropped_ends_its_file_by_itself() {
    let sink = Sink::new();
    let mut length = sink.length();
    for name in ["/front", "", "a b", "a\n"] {
        let refused = Recorder::builder().frame_id(name).write_to(Sink::new()).unwrap_err();
        assert!(matches!(&refused, RecordingError::FrameId { frame_id } if frame_id == name));
    }
    let recorder = Recorder::builder().frame_id("front").write_to(sink.clone()).unwrap();
    let tap = recorder.observer();
    drop(recorder);
    length
        .wait_for(|_| sink.bytes().ends_with(b"\x89MCAP0\r\n") && sink.bytes().len() > 1000)
        .await
        .unwrap();
    assert_eq!(sink.records(), []);
    drop(tap);
}

/// A file whose bytes reach it when they are flushed.
struct Buffered {
    sink: Sink,
    bytes: Vec<u8>,
}

impl std::io::Write for Buffered {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.bytes.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        let bytes = std::mem::take(&mut self.bytes);
        std::io::Write::write_all(&mut self.sink, &bytes)
    }
}

#[tokio::test(start_paused = true)]
async fn a_buffered_writer_is_flushed_at_both_ends() {
    let sink = Sink::new();
    let buffered = Buffered { sink: sink.clone(), bytes: Vec::new() };
    let mut recorder = Recorder::builder().write_to(buffered).unwrap();
    // Readers recognise a recording by its header. The channels follow with the first message.
    assert!(sink.bytes().starts_with(b"\x89MCAP0\r\n\x01"));
    let sensor = Sensor::builder().connect(sensor()).await.unwrap();
    recorder.record(&sensor.scan(Window::DETECTION).await).unwrap();
    recorder.finish().await.unwrap();
    assert_eq!(sink.records().len(), 1);
    let mut recording = sink.open();
    recording.by_ref().for_each(drop);
    assert!(!recording.is_truncated());
}

#[tokio::test(start_paused = true)]
async fn any_requested_rate_can_be_read_again() {
    let periods =
        [Duration::from_secs(3000), Duration::from_millis(33), Duration::from_nanos(1_234_567)];
    let rates = periods.map(Rate::every).into_iter().chain([Rate::hz(30.0), Rate::UNLIMITED]);
    for rate in rates {
        let sink = Sink::new();
        let recorder = Recorder::builder().write_to(sink.clone()).unwrap();
        let sensor = Sensor::builder().connect(sensor()).await.unwrap();
        let scans = sensor.scans(Window::DETECTION, rate).await.unwrap();
        recorder.describe(&sensor, &scans).await.unwrap();
        recorder.finish().await.unwrap();
        assert_eq!(sink.open().rate(), Some(rate));
    }
}

/// Writes a recording and its content for `urg/tests/recording_readers.py`.
#[tokio::test(start_paused = true)]
async fn other_readers_have_a_recording_to_read() {
    let sink = Sink::new();
    let items = record(sensor(), &sink, Window::DETECTION, 400).await;
    let scans: Vec<Scan> = items.into_iter().map(Result::unwrap).collect();
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    std::fs::write(folder.join("recording.mcap"), sink.bytes()).unwrap();
    let numbers: Vec<u32> = (0..400).collect();
    write_truth(&folder.join("recording.txt"), &truth_of(&scans, &numbers));
}

/// Formats the scans with these numbers, a line each: stamp, frame, ranges.
pub(crate) fn truth_of<'a>(scans: &[Scan], numbers: impl IntoIterator<Item = &'a u32>) -> String {
    let mut truth = String::new();
    for number in numbers {
        let scan = scans.iter().find(|scan| scan.sequence() == u64::from(*number)).unwrap();
        let stamp = scan.first_ray_stamp().duration_since(std::time::UNIX_EPOCH).unwrap();
        write!(truth, "{} laser", stamp.as_nanos()).unwrap();
        scan.ranges().for_each(|range| write!(truth, " {range}").unwrap());
        truth.push('\n');
    }
    truth
}

pub(crate) fn write_truth(path: &Path, truth: &str) {
    std::fs::write(path, truth).unwrap();
}

/// Before a file is touched.
#[cfg(not(feature = "zstd"))]
#[test]
fn a_compression_of_other_builds_is_an_explained_error() {
    use urg_recording::{Compression, cut};

    let folder = Folder::new("other-build");
    let path = folder.write(b"precious");
    let builder = Recorder::builder().overwrite(true).compression(Compression::Zstd);
    let mut copy = Vec::new();
    for error in [
        builder.create(&path).unwrap_err(),
        cut([std::io::Cursor::new([])], .., Some(Compression::Zstd), &mut copy).unwrap_err(),
    ] {
        assert!(matches!(error, RecordingError::NotWritten { .. }), "{error:?}");
        assert!(error.to_string().ends_with("zstd: build with the feature `zstd`"), "{error}");
    }
    assert_eq!((std::fs::read(path).unwrap(), copy), (b"precious".to_vec(), vec![]));
}
