//! Recording as PORT, in a file or on standard input: its settings, and its replay.

use std::fmt;
use std::future::poll_fn;
use std::io::{self, Cursor, IsTerminal, Read};
use std::ops::Bound;
use std::path::{Path, PathBuf};
use std::pin::pin;
use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::watch;
use tokio_scip::port::Connect;
use tokio_scip::{Driver, Error, Rate, Scan, Sensor, SensorBuilder, Window};
use urg_emulator::Emulator;
use urg_recording::{
    LeftOut, LeftOutCounter, Recording, RecordingError, ReplayPace, recording_files,
};

use super::contents::{self, Contents};
use super::span::TimeSpan;
use crate::delivery::Delivery;
use crate::failure::Failure;

/// Number of scans that a replay may be ahead of a consumer of all scans.
const MAX_SCANS_AHEAD: u64 = 256;
/// A pipe may have no scan for as long as this: its sensor is away.
const PIPE_PATIENCE: Duration = Duration::from_secs(24 * 60 * 60);

#[derive(Debug, Clone, Default)]
pub(crate) struct Recorded {
    path: PathBuf,
    /// Standard input, once it is opened and until it is read. `None` for a file.
    stdin: Option<Arc<Mutex<Option<Recording>>>>,
    /// Beginning of standard input, as far as it was read when it was opened.
    head: Arc<[u8]>,
    window: Option<Window>,
    rate: Option<Rate>,
    pace: ReplayPace,
    /// Part to read; `None` means all of it.
    pub(crate) range: Option<TimeSpan>,
    /// Topic of the scans; `None` means `/scan`.
    pub(crate) topic: Option<String>,
    /// Number of scans that feeds have yielded.
    consumed: Arc<watch::Sender<u64>>,
    /// What the latest replay has left out.
    left_out: Arc<Mutex<LeftOutCounter>>,
}

impl Recorded {
    /// Parses the name of a recording, or of a folder with one. Does not open a file. Reading a bag
    /// in another format will say how to convert it.
    pub(crate) fn named(path: &Path) -> Option<Self> {
        let is_stdin = path.as_os_str() == "-";
        let is_other = || {
            path.is_dir()
                || matches!(recording_files(path), Err(RecordingError::OtherFormat { .. }))
        };
        (is_stdin || Self::is_name(path) || is_other()).then(|| Self {
            path: path.to_owned(),
            stdin: is_stdin.then(Arc::default),
            ..Self::default()
        })
    }

    /// Returns the name that was given: `-` for standard input.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Checks whether a file with this name is a recording: `*.mcap`.
    pub(crate) fn is_name(path: &Path) -> bool {
        path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"))
    }

    /// Reads the recorded window and rate from the file. You can drop the future while the
    /// system blocks on opening the file.
    pub(crate) async fn read_settings(&mut self) -> Result<(), Failure> {
        if self.stdin.is_some() && io::stdin().is_terminal() {
            let text = "- reads a recording from standard input, and that is a terminal: send one \
                        into it, as in `ssh robot urg record PORT - | urg stream -`";
            return Err(Failure::Usage(text.to_owned()));
        }
        let (here, head) = (self.clone(), Arc::new(Mutex::new(Some(Vec::new()))));
        let input = KeptInput(Arc::clone(&head));
        let opened = tokio::task::spawn_blocking(move || match here.stdin {
            Some(_) => Recording::read(input).map_err(|error| here.failure(&error)),
            None => here.open(),
        });
        let recording = opened.await.map_err(|error| self.failure(&error))??;
        self.head = head.lock().take().unwrap_or_default().into();
        self.window = recording.window();
        // The scans of a stream come as the motor turns: polls at the rate that was asked for fall behind.
        let is_streamed = recording.metadata().contains_key("ARES");
        self.rate = recording.rate().filter(|_| !is_streamed);
        if let Some(stdin) = &self.stdin {
            *stdin.lock() = Some(recording);
        }
        Ok(())
    }

    /// Fails for standard input, which cannot be read twice.
    pub(crate) fn require_file(&self) -> Result<(), Failure> {
        match &self.stdin {
            None => Ok(()),
            Some(_) => Err(Failure::Usage(
                "standard input cannot be played to and fro: save it first, as in `cat > run.mcap`, \
                 or read it with `urg stream -`"
                    .to_owned(),
            )),
        }
    }

    pub(crate) fn topic(&self) -> &str {
        self.topic.as_deref().unwrap_or("/scan")
    }

    /// Window in the metadata, which describes the stream on `/scan` and no other topic.
    pub(super) fn described(&self) -> Option<Window> {
        self.window.filter(|_| self.topic() == "/scan")
    }

    /// Window of the described stream, or else of the first scan.
    pub(crate) fn window(&self) -> Option<Window> {
        self.described().or_else(|| Some(self.first_scan()?.window()))
    }

    /// Sets the pace: as fast as possible if you pass a `rate`, else the recorded pace. Returns
    /// the rate to poll at: `rate`, else the recorded one. Another program does not tell its own.
    pub(crate) fn set_pace(&mut self, rate: Option<Rate>) -> Rate {
        self.pace = rate.map_or(ReplayPace::Recorded, |_| ReplayPace::Max);
        rate.or(self.rate).unwrap_or(Rate::UNLIMITED)
    }

    pub(crate) async fn contents(&self) -> Result<Contents, Failure> {
        let recording = self.open()?;
        let path = self.stdin.is_none().then(|| self.path.clone());
        let read = tokio::task::spawn_blocking(move || contents::read(path.as_deref(), recording));
        read.await.map_err(|error| self.failure(&error))?.map_err(|error| self.failure(&error))
    }

    /// Starts the replay. With [`Delivery::All`], the replay waits for a slow consumer.
    pub(crate) fn start(
        &self,
        builder: SensorBuilder,
        delivery: Delivery,
    ) -> Result<Sensor, Failure> {
        let recording = self.open()?;
        *self.left_out.lock() = recording.left_out();
        if self.stdin.is_some() {
            let builder = builder.name(self.to_string()).open_timeout(PIPE_PATIENCE);
            let pipe =
                PipeReplay { recording: Some((recording, self.pace)), name: self.to_string() };
            let (sensor, driver) = builder.build(pipe);
            let run = run(driver, sensor.clone(), delivery, self.consumed.subscribe());
            // Reading a pipe blocks the thread of its driver.
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
            let runtime = runtime.map_err(|error| self.failure(&error))?;
            std::thread::Builder::new()
                .name("pipe".to_owned())
                .spawn(move || runtime.block_on(run))
                .map_err(|error| self.failure(&error))?;
            return Ok(sensor);
        }
        // A replay would invent them: the recorded model may have some.
        let builder =
            if self.may_have_intensities() { builder } else { builder.intensities(false) };
        let emulator = recording.replay(self.pace).map_err(|error| self.no_scans(&error))?;
        let (sensor, driver) = builder.build(emulator);
        tokio::spawn(run(driver, sensor.clone(), delivery, self.consumed.subscribe()));
        Ok(sensor)
    }

    /// Returns true if the first scan has intensities, or cannot be read twice.
    pub(crate) fn may_have_intensities(&self) -> bool {
        self.stdin.is_some() || self.first_scan().is_some_and(|scan| scan.intensities().is_some())
    }

    /// Reads the first scan. Of standard input, only its beginning can be read twice.
    fn first_scan(&self) -> Option<Scan> {
        let recording = match &self.stdin {
            None => self.open().ok()?,
            Some(_) => {
                Recording::read(Cursor::new(Arc::clone(&self.head))).ok()?.topic(self.topic())
            }
        };
        recording.scans().find_map(Result::ok)
    }

    /// Describes what a replay has left out of the stream, if anything.
    pub(crate) fn left_out(&self) -> Option<String> {
        let mut counts = self.left_out.lock().counts();
        counts.retain(|count| !count.reason.is_expected());
        let text: Vec<_> = counts.iter().map(LeftOut::to_string).collect();
        (!text.is_empty()).then(|| format!("{self}: left out: {}", text.join("; ")))
    }

    /// Counts a scan that a feed has yielded.
    pub(crate) fn count_consumed(&self) {
        self.consumed.send_modify(|consumed| *consumed += 1);
    }

    pub(super) fn open(&self) -> Result<Recording, Failure> {
        let recording = self.open_all()?;
        Ok(match self.range {
            Some(range) => recording.range(range.bounds()),
            None => recording,
        })
    }

    /// Opens the recording at `place` instead of the start of its range.
    pub(super) fn open_at(&self, place: Duration) -> Result<Recording, Failure> {
        let end = self.range.map_or(Bound::Unbounded, |range| range.bounds().1);
        Ok(self.open_all()?.range((Bound::Included(place), end)))
    }

    fn open_all(&self) -> Result<Recording, Failure> {
        let recording = match &self.stdin {
            None => Recording::open(&self.path).map_err(|error| self.failure(&error))?,
            Some(stdin) => stdin
                .lock()
                .take()
                .ok_or_else(|| Failure::Failed(format!("{self}: it can be read only once")))?,
        };
        Ok(recording.topic(self.topic()))
    }

    /// Describes an error at the first scan. The range may contain no scan.
    pub(super) fn no_scans(&self, error: &RecordingError) -> Failure {
        match (self.range, error) {
            (Some(range), RecordingError::NoScans { left_out, topics, .. })
                if self.stdin.is_none() && topics.is_empty() && left_out.is_empty() =>
            {
                Failure::Failed(format!(
                    "{self}: no scan in --range {range}: `urg info {self}` shows how long it is"
                ))
            }
            _ => self.failure(error),
        }
    }

    pub(super) fn failure(&self, error: &dyn std::error::Error) -> Failure {
        Failure::at(self, error)
    }
}

impl fmt::Display for Recorded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.stdin {
            Some(_) => f.write_str("standard input"),
            None => self.path.display().fmt(f),
        }
    }
}

/// Standard input, with a copy of all that is read from it until the copy is taken.
struct KeptInput(Arc<Mutex<Option<Vec<u8>>>>);

impl Read for KeptInput {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let count = io::stdin().read(bytes)?;
        if let Some(kept) = &mut *self.0.lock() {
            kept.extend(bytes.get(..count).unwrap_or_default());
        }
        Ok(count)
    }
}

/// Connects to the replay of a pipe. Waits for the first scan, as for a sensor.
struct PipeReplay {
    /// Until the first attempt.
    recording: Option<(Recording, ReplayPace)>,
    name: String,
}

impl Connect for PipeReplay {
    type Port = <Emulator as Connect>::Port;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        let failed = |error| Error::open(&self.name, error);
        let Some((recording, pace)) = self.recording.take() else {
            return Err(failed(io::ErrorKind::UnexpectedEof.into()));
        };
        // Blocks, which is all right on a thread of its own.
        recording.replay(pace).map_err(|error| failed(io::Error::other(error)))?.connect().await
    }
}

/// Runs the driver. With [`Delivery::All`], pauses it while it is more than [`MAX_SCANS_AHEAD`]
/// scans ahead of the consumer. The driver sees this as a busy machine.
async fn run(driver: Driver, sensor: Sensor, delivery: Delivery, mut taken: watch::Receiver<u64>) {
    if delivery == Delivery::Newest {
        // The driver ends with the last handle. Its end is in the state of the sensor.
        drop(sensor);
        return drop(driver.await);
    }
    let mut driver = pin!(driver);
    loop {
        let enough = sensor.stats().scans.saturating_sub(MAX_SCANS_AHEAD);
        // Fails after the last consumer is dropped.
        let Ok(seen) = taken.wait_for(|seen| *seen >= enough).await.map(|seen| *seen) else {
            return;
        };
        let ended = poll_fn(|cx| match driver.as_mut().poll(cx) {
            Poll::Ready(_) => Poll::Ready(true),
            Poll::Pending if sensor.stats().scans > seen + MAX_SCANS_AHEAD => Poll::Ready(false),
            Poll::Pending => Poll::Pending,
        });
        if ended.await {
            return;
        }
    }
}
