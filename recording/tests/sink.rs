//! Files in memory, some on a full disk, and recording into them.

use std::io::{self, Write};
use std::sync::{Arc, Mutex};

use tokio::sync::watch;
use tokio_scip::{Error, Rate, Scan, ScanStream, Sensor, Window};
use urg_emulator::{Emulator, Model, Values, WorldTime};
use urg_recording::Event;
use urg_recording::{Entry, Record, RecordedReply, Recorder, Recording, ReplayPace};

/// A file in memory. Clones are the same file.
#[derive(Clone)]
pub(crate) struct Sink {
    bytes: Arc<Mutex<Vec<u8>>>,
    room: usize,
    /// Number of bytes written, to be awaited.
    length: watch::Sender<usize>,
}

impl Sink {
    /// Returns a file on a disk that holds this many bytes.
    pub(crate) fn with_room(room: usize) -> Self {
        Self { bytes: Arc::default(), room, length: watch::Sender::new(0) }
    }

    pub(crate) fn new() -> Self {
        Self::with_room(usize::MAX)
    }

    /// Returns a file of these bytes.
    pub(crate) fn with_bytes(bytes: &[u8]) -> Self {
        Self { bytes: Arc::new(Mutex::new(bytes.to_vec())), ..Self::new() }
    }

    pub(crate) fn bytes(&self) -> Vec<u8> {
        self.bytes.lock().unwrap().clone()
    }

    pub(crate) fn length(&self) -> watch::Receiver<usize> {
        self.length.subscribe()
    }

    pub(crate) fn open(&self) -> Recording {
        Recording::read(io::Cursor::new(self.bytes())).unwrap()
    }

    pub(crate) fn records(&self) -> Vec<Record> {
        self.open().collect::<Result<_, _>>().unwrap()
    }
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut file = self.bytes.lock().unwrap();
        let fits = bytes.len().min(self.room - file.len());
        if fits == 0 {
            return Err(io::ErrorKind::StorageFull.into());
        }
        file.extend_from_slice(&bytes[..fits]);
        let length = file.len();
        // Unlocks first, because the woken task reads the file.
        drop(file);
        self.length.send_replace(length);
        Ok(fits)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Returns a sensor whose scans all differ.
pub(crate) fn sensor() -> Emulator {
    model(Model::Urg04lx)
}

/// Returns a sensor of this model whose scans all differ. In SCIP 2, values have all 18 bits.
pub(crate) fn model(model: Model) -> Emulator {
    let (factor, most) = match model {
        Model::Urg04lx => (3, 4096),
        Model::Urg04lxUg01 => (5, 8192),
        _ => (331, 1 << 18),
    };
    let world = move |time: WorldTime, codes: &mut Values| {
        for (step, slot) in codes.iter_mut().enumerate() {
            *slot = ((time.request * 7 + step as u64 * factor) % most) as u32;
        }
    };
    Emulator::builder().model(model).world(world).build()
}

/// Records `count` scans, and returns them.
pub(crate) async fn record(
    emulator: Emulator,
    sink: &Sink,
    window: Window,
    count: usize,
) -> Vec<Result<Scan, Error>> {
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let (sensor, mut scans) = observed(&recorder, emulator, window, Rate::hz(10.0)).await;
    recorder.describe(&sensor, &scans).await.unwrap();
    let mut items = Vec::new();
    while items.iter().filter(|item: &&Result<_, _>| item.is_ok()).count() < count {
        let item = scans.next().await.unwrap();
        recorder.record(&item).unwrap();
        items.push(item);
    }
    assert_eq!(recorder.progress().lost, 0);
    recorder.finish().await.unwrap();
    items
}

/// Polls a sensor whose replies are recorded.
pub(crate) async fn observed(
    recorder: &Recorder,
    emulator: Emulator,
    window: Window,
    rate: Rate,
) -> (Sensor, ScanStream) {
    fastrand::seed(7);
    let builder = Sensor::builder().on_reply(recorder.observer()).depth(1 << 16);
    let sensor = builder.connect(emulator).await.unwrap();
    let scans = sensor.scans(window, rate).await.unwrap();
    (sensor, scans)
}

/// Records the next `count` scans, and returns them.
pub(crate) async fn next(
    recorder: &mut Recorder,
    scans: &mut ScanStream,
    count: usize,
) -> Vec<Scan> {
    let mut taken = Vec::new();
    while taken.len() < count {
        let item = scans.next().await.unwrap();
        recorder.record(&item).unwrap();
        taken.push(item.unwrap());
    }
    taken
}

/// Returns the scans of a replay of `window`, as fast as possible.
pub(crate) async fn replayed(recording: Recording, window: Window) -> Vec<Scan> {
    let replay = recording.replay(ReplayPace::Max).unwrap();
    // A sensor that measures none sends none.
    let builder = Sensor::builder().depth(1 << 16).intensities(true);
    let sensor = builder.connect(replay).await.unwrap();
    let mut stream = sensor.scans(window, Rate::UNLIMITED).await.unwrap();
    let mut scans = Vec::new();
    while let Some(scan) = stream.next().await {
        scans.push(scan.unwrap());
    }
    scans
}

pub(crate) fn values<'a>(scans: impl IntoIterator<Item = &'a Scan>) -> Vec<Vec<u32>> {
    scans.into_iter().map(|scan| scan.raw_values().collect::<Vec<_>>()).collect()
}

/// Returns the replies to polls.
pub(crate) fn polls(records: &[Record]) -> Vec<RecordedReply> {
    let replies = records.iter().filter_map(|record| match &record.entry {
        Entry::Reply(reply) if reply.bytes.starts_with(b"G") => Some(reply.clone()),
        _ => None,
    });
    replies.filter(|reply| reply.command.is_some()).collect()
}

pub(crate) fn events(records: &[Record]) -> Vec<Event> {
    let events = records.iter().filter_map(|record| match &record.entry {
        Entry::Event(event) => Some(event.clone()),
        _ => None,
    });
    events.collect()
}

pub(crate) fn window(from: u16, to: u16, cluster_count: u8) -> Window {
    Window::new(from..=to).unwrap().with_cluster_count(cluster_count).unwrap()
}
