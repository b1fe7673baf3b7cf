//! Recordings after a kill, on a full disk, on a disk that stalls, and with damage.

use std::io::{self, Write};
use std::sync::mpsc;
use std::time::Duration;

use tokio_scip::{ErrorKind, Rate, Sensor, Window};
use urg_emulator::{Emulator, Model};
use urg_recording::{Entry, Record, Recorder, Recording, RecordingError, ReplayPace};

use super::sink::{self, Sink, observed, polls, record, sensor, window};

const MODELS: [(Model, f64); 2] = [(Model::Urg04lx, 10.0), (Model::Ust10lx, 40.0)];

/// Returns the offset in `whole` at which `part` ends.
fn end_of(part: &[u8], whole: &[u8]) -> usize {
    let at = whole.windows(part.len()).position(|window| window == part);
    at.expect("not in the file") + part.len()
}

#[tokio::test(start_paused = true)]
async fn a_truncated_file_is_read_to_its_end() {
    let sink = Sink::new();
    record(sensor(), &sink, window(300, 340, 1), 6).await;
    let (file, records) = (sink.bytes(), sink.records());
    let ends: Vec<usize> =
        polls(&records).iter().map(|reply| end_of(&reply.bytes, &file)).collect();
    assert_eq!(ends.len(), 6);
    let (mut most, mut truncated) = (0, 0);
    for length in 0..file.len() {
        let recording = Recording::read(io::Cursor::new(file[..length].to_vec()));
        let mut recording = recording.unwrap_or_else(|error| panic!("{length} bytes: {error}"));
        let read: Vec<_> = recording.by_ref().collect::<Result<_, _>>().unwrap();
        assert_eq!(read, records[..read.len()], "{length} bytes");
        let whole = ends.iter().filter(|end| **end <= length).count();
        assert_eq!(polls(&read).len(), whole, "{length} bytes");
        assert!(read.len() >= most, "{length} bytes");
        most = read.len();
        truncated += usize::from(recording.is_truncated());
    }
    assert_eq!(most, records.len());
    // Every file is truncated but those that lack only the index.
    assert!(truncated > *ends.last().unwrap());
}

/// Makes a file of three chunks after the one that declares the channels.
async fn three_chunks() -> (Vec<u8>, Vec<Record>) {
    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let (sensor, mut scans) =
        observed(&recorder, sensor(), window(380, 384, 1), Rate::hz(10.0)).await;
    for _ in 0..3 {
        // Metadata is not part of a chunk, so it ends one.
        recorder.describe(&sensor, &scans).await.unwrap();
        recorder.record(&scans.next().await.unwrap()).unwrap();
    }
    recorder.finish().await.unwrap();
    (sink.bytes(), sink.records())
}

#[tokio::test(start_paused = true)]
async fn a_flipped_bit_costs_one_chunk() {
    let (file, records) = three_chunks().await;
    let end_of_data = end_of(&[0x0f, 4, 0, 0, 0, 0, 0, 0, 0], &file) - 9;
    let largest = records.len() - 2;
    let (mut damaged, mut reported) = (0, 0);
    // Every fifth bit hits each place in a byte, and each field of a record.
    for bit in (8 * 8..end_of_data * 8).step_by(5) {
        let mut changed = file.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        let items: Vec<_> = Recording::read(io::Cursor::new(changed)).unwrap().collect();
        let read: Vec<_> = items.iter().flatten().collect();
        assert!(read.iter().all(|record| records.contains(record)), "bit {bit}");
        assert!(read.len() + largest >= records.len(), "bit {bit}: {} records", read.len());
        if read.len() < records.len() {
            damaged += 1;
            let error = items.iter().find_map(|item| item.as_ref().err());
            assert!(matches!(error, Some(RecordingError::Damaged { .. })), "bit {bit}: {error:?}");
            reported += 1;
        }
    }
    assert!(damaged > file.len() / 4, "{damaged} in {} bytes", file.len());
    assert_eq!(damaged, reported);
}

/// At whatever byte the disk becomes full, the file can be read, and the stream goes on.
#[tokio::test(start_paused = true)]
async fn o23_a_full_disk_ends_the_recording_and_nothing_else() {
    let rooms = [1_000, 10_000, 100_000, 1_200_000];
    for (model, hz, room) in
        MODELS.into_iter().flat_map(|(model, hz)| rooms.map(|room| (model, hz, room)))
    {
        let sink = Sink::with_room(room);
        let recorder = Recorder::builder().write_to(sink.clone());
        let Ok(mut recorder) = recorder else {
            assert_eq!(room, 1_000, "no room for the head");
            continue;
        };
        let (_sensor, mut scans) =
            observed(&recorder, sink::model(model), Window::DETECTION, Rate::hz(hz)).await;
        let item = scans.next().await.unwrap();
        // Until a chunk is complete and does not fit on the disk.
        let error = loop {
            if let Err(error) = recorder.record(&item) {
                break error;
            }
        };
        assert!(is_full(&error), "{error:?}");
        // Each later record fails, too, and the stream is not affected.
        assert!(recorder.record(&scans.next().await.unwrap()).is_err());
        assert!(scans.next().await.unwrap().is_ok());
        assert!(recorder.progress().lost > 0);
        assert_eq!(recorder.progress().bytes, room as u64);
        assert!(is_full(&recorder.finish().await.unwrap_err()));
        let mut recording = sink.open();
        let scans = recording
            .by_ref()
            .filter(|record| matches!(record.as_ref().unwrap().entry, Entry::Scan(_)));
        assert!(scans.count() * 5_000 + 15_000 > room, "{room} bytes");
        assert!(recording.is_truncated());
    }
}

/// The last chunk is on the disk; only its index is not.
#[tokio::test(start_paused = true)]
async fn finish_fails_if_the_disk_is_full() {
    let sensor = Sensor::builder().connect(sensor()).await.unwrap();
    let item = sensor.scan(Window::DETECTION).await;
    let run = async |room| {
        let sink = Sink::with_room(room);
        let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
        recorder.record(&item).unwrap();
        (recorder.finish().await, sink)
    };
    let (finished, whole) = run(usize::MAX).await;
    finished.unwrap();
    let (finished, cut) = run(whole.bytes().len() - 1).await;
    assert!(is_full(&finished.unwrap_err()));
    assert_eq!((cut.records().len(), whole.records().len()), (1, 1));
}

fn is_full(error: &RecordingError) -> bool {
    matches!(error, RecordingError::Write { source } if source.kind() == io::ErrorKind::StorageFull)
}

/// A file whose writes block until they are released.
struct Slow {
    sink: Sink,
    hangs: mpsc::Sender<()>,
    go: mpsc::Receiver<()>,
}

impl Write for Slow {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.sink.bytes().len() > 1_000 {
            // Writes block from the second chunk on, until `go` is dropped.
            let _ = self.hangs.send(());
            let _ = self.go.recv();
        }
        self.sink.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[tokio::test(start_paused = true)]
async fn a_stalled_disk_costs_only_scans() {
    for (model, _) in MODELS {
        stall(sink::model(model)).await;
    }
}

async fn stall(emulator: Emulator) {
    let sink = Sink::new();
    let ((go, wait), (hangs, hung)) = (mpsc::channel(), mpsc::channel());
    let slow = Slow { sink: sink.clone(), hangs, go: wait };
    let mut recorder = Recorder::builder().write_to(slow).unwrap();
    let sensor = Sensor::builder().on_reply(recorder.observer()).connect(emulator).await.unwrap();
    let item = sensor.scan(Window::DETECTION).await;
    // These are twice as many as the queue holds: recording them must not block,
    // not even once the writer hangs and takes nothing from the queue.
    for _ in 0..12_000 {
        recorder.record(&item).unwrap();
    }
    hung.recv_timeout(Duration::from_secs(60)).unwrap();
    for _ in 0..12_000 {
        recorder.record(&item).unwrap();
    }
    let progress = recorder.progress();
    assert!(progress.lost > 4_000, "{progress:?}");
    assert_eq!((progress.scans + progress.lost, progress.lost_replies), (24_000, 0));
    // Its reply waits for it.
    let item = sensor.scan(Window::DETECTION).await;
    let lost = progress.lost;
    let progress = recorder.progress();
    assert_eq!((progress.lost, progress.lost_replies), (lost, 0));
    recorder.record(&item).unwrap();
    let progress = recorder.progress();
    assert_eq!((progress.lost, progress.lost_replies), (lost + 1, 1));
    drop(go);
    recorder.finish().await.unwrap();
    assert_eq!(sink.records().len() as u64, progress.scans + progress.replies);
}

#[tokio::test]
async fn waiting_for_ready_survives_a_stalled_disk() {
    let sink = Sink::new();
    let ((go, wait), (hangs, _hung)) = (mpsc::channel(), mpsc::channel());
    let slow = Slow { sink: sink.clone(), hangs, go: wait };
    let mut recorder = Recorder::builder().write_to(slow).unwrap();
    let sensor = Sensor::builder().connect(sensor()).await.unwrap();
    let item = sensor.scan(Window::DETECTION).await;
    let mut go = Some(go);
    for _ in 0..12_000 {
        recorder.record(&item).unwrap();
        let must_wait = tokio::select! {
            biased;
            () = recorder.ready() => false,
            () = async {} => true,
        };
        if must_wait {
            drop(go.take());
            tokio::time::timeout(Duration::from_secs(60), recorder.ready()).await.unwrap();
        }
    }
    assert!(go.is_none(), "`ready` never waited");
    assert_eq!((recorder.progress().scans, recorder.progress().lost), (12_000, 0));
    recorder.finish().await.unwrap();
    assert_eq!(sink.records().len(), 12_000);
}

#[tokio::test(start_paused = true)]
async fn ready_does_not_wait_for_a_full_disk() {
    let mut recorder = Recorder::builder().write_to(Sink::with_room(10_000)).unwrap();
    let sensor = Sensor::builder().connect(sensor()).await.unwrap();
    let item = sensor.scan(Window::DETECTION).await;
    while recorder.record(&item).is_ok() {}
    for _ in 0..12_000 {
        assert!(recorder.record(&item).is_err());
        recorder.ready().await;
    }
}

/// File that panics when more bytes are written than it has room for.
struct Panics(usize);

impl Write for Panics {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0 = self.0.checked_sub(bytes.len()).expect("room");
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[tokio::test(start_paused = true)]
async fn a_writer_that_panics_fails_the_recording_and_blocks_nothing() {
    let sensor = Sensor::builder().connect(sensor()).await.unwrap();
    let item = sensor.scan(Window::DETECTION).await;
    // One scan is written by `finish`; many are written before it.
    for scans in [1, 12_000] {
        let mut recorder = Recorder::builder().write_to(Panics(4_000)).unwrap();
        for _ in 0..scans {
            // Fails once the writer has panicked.
            let _ = recorder.record(&item);
        }
        if scans > 1 {
            recorder.ready().await;
        }
        match recorder.finish().await.unwrap_err() {
            RecordingError::Write { source } => {
                assert_eq!(source.to_string(), "the writer panicked")
            }
            other => panic!("{other:?}"),
        }
    }
}

/// In real time, because the test waits for a file.
#[tokio::test]
async fn recorded_scans_are_in_the_file_before_it_is_finished() {
    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let sensor = Sensor::builder().on_reply(recorder.observer()).connect(sensor()).await.unwrap();
    recorder.record(&sensor.scan(Window::DETECTION).await).unwrap();
    let mut length = sink.length();
    // It is written after a second.
    let written = length.wait_for(|length| *length > 4_000);
    tokio::time::timeout(Duration::from_secs(60), written).await.unwrap().unwrap();
    let mut recording = sink.open();
    let scans =
        recording.by_ref().filter(|item| matches!(item.as_ref().unwrap().entry, Entry::Scan(_)));
    assert_eq!(scans.count(), 1);
    assert!(recording.is_truncated());
    drop(recorder);
}

#[tokio::test(start_paused = true)]
async fn a_replay_that_ends_at_damage_reports_it() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 400).await;
    for damaged in [false, true] {
        let mut file = sink.bytes();
        // The damage is in the second of two chunks.
        let late = file.len() / 8 * 7;
        file[late] ^= u8::from(damaged);
        let recording = Recording::read(io::Cursor::new(file)).unwrap();
        let replay = recording.replay(ReplayPace::Max).unwrap();
        let sensor = Sensor::builder().connect(replay).await.unwrap();
        let mut scans = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        let mut end = None;
        while let Some(item) = scans.next().await {
            end = item.err();
        }
        if !damaged {
            assert!(end.is_none(), "{end:?}");
            continue;
        }
        let end = end.unwrap();
        let ErrorKind::Disconnected { source: Some(source), .. } = end.kind() else {
            panic!("{end:?}")
        };
        let cause = source.get_ref().and_then(|error| error.downcast_ref());
        assert!(matches!(cause, Some(RecordingError::Damaged { .. })), "{source:?}");
    }
}
