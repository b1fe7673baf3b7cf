//! [`Recorder`]: takes scans and replies from async code to a thread of its
//! own, which writes the file.

use std::collections::BTreeMap;
use std::fs::OpenOptions;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use mcap::McapResult;
use tokio::sync::oneshot;

use super::writer::{LogClock, Times, Writer};
use super::{Event, RecordingError};
use crate::tap::Heard;
use crate::{Error, Scan, ScanStream, Sensor, State};

/// How long what was recorded may stay in memory.
const FLUSH: Duration = Duration::from_secs(1);
/// How many bytes wait for a disk that is slow; at 10 scans a second that
/// is some four minutes.
const QUEUE: usize = 8 << 20;
/// What an entry costs besides what it carries.
const OVERHEAD: usize = 128;

/// Records what a [`ScanStream`] gives and what a sensor sends, into an MCAP
/// file.
///
/// Nothing here waits for a disk: a thread of its own writes the file, and ends
/// a chunk of it at least each second. So what is older than a second survives
/// a kill and a full disk (not a loss of power, which the system's buffers do
/// not survive). The module's page shows how to use it.
///
/// Dropping it ends the file as [`finish`](Self::finish) does, without waiting
/// for that.
#[derive(Debug)]
pub struct Recorder {
    shared: Arc<Shared>,
    /// The number that the next scan should have.
    expected: Option<u64>,
    disconnected: bool,
}

/// How a file is recorded; made by [`Recorder::builder`].
#[derive(Debug, Clone)]
#[must_use = "a builder does nothing until it creates a recorder"]
pub struct RecorderBuilder {
    frame_id: String,
    overwrite: bool,
}

/// How far a recording is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct Progress {
    /// Scans in the file, or on their way into it.
    pub scans: u64,
    /// Replies in the file, or on their way into it.
    pub replies: u64,
    /// Bytes that were written.
    pub bytes: u64,
    /// Scans and replies that are not in the file, because the disk was too slow
    /// for too long (8 MiB wait for it), or had failed.
    pub lost: u64,
}

#[derive(Debug)]
struct Shared {
    queue: mpsc::Sender<Entry>,
    queued: AtomicUsize,
    scans: AtomicU64,
    replies: AtomicU64,
    bytes: AtomicU64,
    lost: AtomicU64,
    failure: Mutex<Option<RecordingError>>,
}

#[derive(Debug)]
enum Entry {
    Scan(Scan),
    Reply { command: String, bytes: Box<[u8]>, times: Times },
    Event { json: String, times: Times },
    Metadata(BTreeMap<String, String>),
    Finish(Option<oneshot::Sender<()>>),
}

impl Recorder {
    /// Records into a new file. Use [`builder`](Self::builder) for more choice.
    ///
    /// # Errors
    ///
    /// [`RecordingError::Exists`] if there is such a file, [`RecordingError::Open`]
    /// if it cannot be created, [`RecordingError::Write`] if its head cannot be
    /// written.
    pub fn create(path: impl AsRef<Path>) -> Result<Self, RecordingError> {
        Self::builder().create(path)
    }

    /// Says how to record.
    pub fn builder() -> RecorderBuilder {
        RecorderBuilder { frame_id: "laser".to_owned(), overwrite: false }
    }

    /// For [`SensorBuilder::tap`](crate::SensorBuilder::tap): records each reply's
    /// bytes, so that the recording can be replayed.
    pub fn tap(&self) -> impl Fn(Heard<'_>) + Send + Sync + 'static {
        let shared = Arc::clone(&self.shared);
        move |heard| {
            let command = heard.command.map_or_else(String::new, |command| command.to_string());
            let times = Times { steady: heard.received_at, wall: heard.stamp };
            let entry = Entry::Reply { command, bytes: heard.bytes.into(), times };
            if shared.push(entry, heard.bytes.len()) {
                shared.replies.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// Writes down who the sensor is, what is asked of it and at which line
    /// speed, as metadata. A replay takes the window and the rate from it.
    ///
    /// Cancel-safe: nothing is written then.
    ///
    /// # Errors
    ///
    /// Those of [`Sensor::version`].
    pub async fn describe(&self, sensor: &Sensor, scans: &ScanStream) -> Result<(), Error> {
        let version = sensor.version().await?;
        let line_speed = match &*sensor.state().borrow() {
            State::Connected { line_speed: Some(speed), .. } => speed.to_string(),
            _ => "none".to_owned(),
        };
        let window = scans.window();
        let mut metadata: BTreeMap<_, _> = [
            ("vendor", version.vendor.to_string()),
            ("product", version.product.to_string()),
            ("firmware", version.firmware.to_string()),
            ("protocol", version.protocol.to_string()),
            ("serial_number", version.serial_number.to_string()),
            ("line_speed", line_speed),
            ("start", window.start().to_string()),
            ("end", window.end().to_string()),
            ("cluster", window.cluster_count().to_string()),
            ("rate", scans.rate().to_string()),
        ]
        .map(|(key, value)| (key.to_owned(), value))
        .into();
        metadata.extend(version.status.map(|status| ("status".to_owned(), status.to_string())));
        self.shared.push(Entry::Metadata(metadata), 0);
        Ok(())
    }

    /// Records an item of a [`ScanStream`]: a scan, or what kept it from coming.
    /// A gap in the scans' numbers and the first scan after a disconnection are
    /// recorded as events, too. Never waits.
    ///
    /// # Errors
    ///
    /// The reason, from the first time on that writing has failed: this
    /// recording has ended. The stream is none the worse for it.
    pub fn record(&mut self, item: &Result<Scan, Error>) -> Result<(), RecordingError> {
        match item {
            Ok(scan) => {
                let expected = self.expected.replace(scan.sequence() + 1);
                let missed =
                    expected.map_or(0, |expected| scan.sequence().saturating_sub(expected));
                let times = Times { steady: scan.received_at(), wall: scan.stamp() };
                if std::mem::take(&mut self.disconnected) {
                    self.event(&Event::Reconnected, times);
                }
                if missed > 0 {
                    self.event(&Event::Missed { scans: missed }, times);
                }
                let weight = scan.len() * size_of::<u16>();
                if self.shared.push(Entry::Scan(scan.clone()), weight) {
                    self.shared.scans.fetch_add(1, Ordering::Relaxed);
                }
            }
            Err(error) => {
                let times = Times {
                    steady: tokio::time::Instant::now().into_std(),
                    wall: SystemTime::now(),
                };
                let text = error.to_string();
                let event = match error {
                    Error::Disconnected { .. } => Event::Disconnected { error: text },
                    _ => Event::Error { error: text },
                };
                self.disconnected |= matches!(error, Error::Disconnected { .. });
                self.event(&event, times);
            }
        }
        self.failure().map_or(Ok(()), Err)
    }

    /// How far it is.
    pub fn progress(&self) -> Progress {
        let Shared { scans, replies, bytes, lost, .. } = &*self.shared;
        let [scans, replies, bytes, lost] =
            [scans, replies, bytes, lost].map(|count| count.load(Ordering::Relaxed));
        Progress { scans, replies, bytes, lost }
    }

    /// Writes what is left, the file's index and its end. If this future is
    /// dropped that goes on all the same.
    ///
    /// # Errors
    ///
    /// [`RecordingError::Write`] if that, or any writing before it, failed.
    pub async fn finish(self) -> Result<(), RecordingError> {
        let (done, finished) = oneshot::channel();
        // A thread that has failed is gone.
        let _ = self.shared.queue.send(Entry::Finish(Some(done)));
        let _ = finished.await;
        self.failure().map_or(Ok(()), Err)
    }

    fn event(&self, event: &Event, times: Times) {
        let json = event.to_string();
        let weight = json.len();
        self.shared.push(Entry::Event { json, times }, weight);
    }

    fn failure(&self) -> Option<RecordingError> {
        self.shared.failure.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // The tap may keep the queue open for longer. No thread: no need.
        let _ = self.shared.queue.send(Entry::Finish(None));
    }
}

impl RecorderBuilder {
    /// The frame that the scans are in, `header.frame_id` in ROS: `laser`
    /// unless set.
    pub fn frame_id(mut self, frame_id: impl Into<String>) -> Self {
        self.frame_id = frame_id.into();
        self
    }

    /// Whether a file that exists is written over: it is not unless set.
    pub fn overwrite(mut self, overwrite: bool) -> Self {
        self.overwrite = overwrite;
        self
    }

    /// Records into a file.
    ///
    /// # Errors
    ///
    /// Those of [`Recorder::create`].
    pub fn create(self, path: impl AsRef<Path>) -> Result<Recorder, RecordingError> {
        let path = path.as_ref();
        let mut options = OpenOptions::new();
        options.write(true);
        if self.overwrite {
            options.create(true).truncate(true);
        } else {
            options.create_new(true);
        }
        match options.open(path) {
            Ok(file) => self.write_to(file),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                Err(RecordingError::Exists { path: path.to_owned() })
            }
            Err(error) => {
                Err(RecordingError::Open { path: path.to_owned(), source: Arc::new(error) })
            }
        }
    }

    /// Records into anything that can be written to, such as a pipe.
    ///
    /// # Errors
    ///
    /// [`RecordingError::Write`] if the file's head cannot be written, or no
    /// thread can be had.
    pub fn write_to(self, out: impl Write + Send + 'static) -> Result<Recorder, RecordingError> {
        let (queue, entries) = mpsc::channel();
        let shared = Arc::new(Shared {
            queue,
            queued: AtomicUsize::new(0),
            scans: AtomicU64::new(0),
            replies: AtomicU64::new(0),
            bytes: AtomicU64::new(0),
            lost: AtomicU64::new(0),
            failure: Mutex::new(None),
        });
        let counted = Counted { out, shared: Arc::clone(&shared) };
        let writer = Writer::new(BufWriter::new(counted), LogClock::starting_now(), self.frame_id)
            .map_err(RecordingError::write)?;
        let thread = {
            let shared = Arc::clone(&shared);
            move || shared.fail(write_all(writer, &entries, &shared))
        };
        std::thread::Builder::new()
            .name("recorder".to_owned())
            .spawn(thread)
            .map_err(|error| RecordingError::Write { source: Arc::new(error) })?;
        Ok(Recorder { shared, expected: None, disconnected: false })
    }
}

impl Shared {
    /// Queues an entry, unless too much is queued already or nobody writes any
    /// more: then it is lost, which false tells.
    fn push(&self, entry: Entry, weight: usize) -> bool {
        let weight = weight + OVERHEAD;
        let room = self.queued.fetch_add(weight, Ordering::Relaxed) + weight <= QUEUE;
        let queued = room && self.queue.send(entry).is_ok();
        if !queued {
            self.queued.fetch_sub(weight, Ordering::Relaxed);
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
        queued
    }

    /// Keeps why writing failed, for the recorder to tell; one line of log.
    fn fail(&self, outcome: McapResult<()>) {
        if let Err(error) = outcome.map_err(RecordingError::write) {
            let cause = std::error::Error::source(&error);
            tracing::error!(cause = cause.map(tracing::field::display), "{error}");
            *self.failure.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
        }
    }
}

/// Writes the file until it is finished.
fn write_all<W: Write>(
    mut writer: Writer<W>,
    entries: &mpsc::Receiver<Entry>,
    shared: &Shared,
) -> McapResult<()> {
    // When the oldest thing came that is not in the file.
    let mut unwritten: Option<Instant> = None;
    loop {
        let entry = match unwritten {
            None => entries.recv().map_err(|_| RecvTimeoutError::Disconnected),
            Some(since) => entries.recv_timeout(FLUSH.saturating_sub(since.elapsed())),
        };
        let weight = match entry {
            Ok(Entry::Scan(scan)) => {
                writer.scan(&scan)?;
                scan.len() * size_of::<u16>()
            }
            Ok(Entry::Reply { command, bytes, times }) => {
                writer.reply(&command, &bytes, times)?;
                bytes.len()
            }
            Ok(Entry::Event { json, times }) => {
                writer.event(&json, times)?;
                json.len()
            }
            Ok(Entry::Metadata(metadata)) => {
                writer.metadata(metadata)?;
                0
            }
            Err(RecvTimeoutError::Timeout) => {
                writer.flush()?;
                unwritten = None;
                continue;
            }
            Ok(Entry::Finish(done)) => {
                // Before whoever waits looks for it.
                shared.fail(writer.finish());
                // They may have given up.
                let _ = done.map(|done| done.send(()));
                return Ok(());
            }
            Err(RecvTimeoutError::Disconnected) => return writer.finish(),
        };
        shared.queued.fetch_sub(weight + OVERHEAD, Ordering::Relaxed);
        if unwritten.get_or_insert_with(Instant::now).elapsed() >= FLUSH {
            writer.flush()?;
            unwritten = None;
        }
    }
}

/// Counts the bytes that get through.
struct Counted<W> {
    out: W,
    shared: Arc<Shared>,
}

impl<W: Write> Write for Counted<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.shared.bytes.fetch_add(written as u64, Ordering::Relaxed);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}
