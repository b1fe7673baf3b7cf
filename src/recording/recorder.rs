//! [`Recorder`]: takes scans and replies from async code to the queue of the
//! thread that writes the file.

use std::collections::BTreeMap;
use std::fs::OpenOptions;
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::SystemTime;

use super::queue::{Entry, Queue};
use super::writer::Times;
use super::{Event, RecordingError};
use crate::observer::RawReply;
use crate::{Error, Scan, ScanStream, Sensor};

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
    queue: Arc<Queue>,
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
    /// Scans that are not in the file, because the disk was too slow for too long
    /// (8 MiB wait for it), or had failed.
    pub lost: u64,
    /// Replies that are not in the file, for the same reasons.
    pub lost_replies: u64,
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

    /// For [`SensorBuilder::on_reply`](crate::SensorBuilder::on_reply): records each reply's
    /// bytes, so that the recording can be replayed.
    pub fn observer(&self) -> impl Fn(RawReply<'_>) + Send + Sync + 'static {
        let queue = Arc::clone(&self.queue);
        move |heard| {
            let command = heard.command.map_or_else(String::new, |command| command.to_string());
            let times = Times { steady: heard.received_at, wall: heard.stamp };
            queue.push(Entry::Reply { command, bytes: heard.bytes.into(), times });
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
        let baud_rate = sensor.state().borrow().baud_rate();
        let baud_rate = baud_rate.map_or_else(|| "none".to_owned(), |rate| rate.to_string());
        let window = scans.window();
        let mut metadata: BTreeMap<_, _> = [
            ("vendor", version.vendor.to_string()),
            ("product", version.product.to_string()),
            ("firmware", version.firmware.to_string()),
            ("protocol", version.protocol.to_string()),
            ("serial_number", version.serial_number.to_string()),
            ("baud_rate", baud_rate),
            ("start", window.start().to_string()),
            ("end", window.end().to_string()),
            ("cluster", window.cluster_count().to_string()),
            ("rate", scans.rate().to_string()),
        ]
        .map(|(key, value)| (key.to_owned(), value))
        .into();
        metadata.extend(version.status.map(|status| ("status".to_owned(), status.to_string())));
        self.queue.push(Entry::Metadata(metadata));
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
                self.queue.push(Entry::Scan(scan.clone()));
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
        self.queue.failure().map_or(Ok(()), Err)
    }

    /// Waits until at most 1 MiB waits for the disk, or writing has failed. For
    /// scans from what can be made to wait, such as a replay: none of them is
    /// lost to a slow disk. A sensor does not wait.
    ///
    /// Cancel-safe.
    pub async fn ready(&self) {
        self.queue.room().await;
    }

    /// How far it is.
    pub fn progress(&self) -> Progress {
        self.queue.progress()
    }

    /// Writes what is left, the file's index and its end. If this future is
    /// dropped that goes on all the same.
    ///
    /// # Errors
    ///
    /// [`RecordingError::Write`] if that, or any writing before it, failed.
    pub async fn finish(self) -> Result<(), RecordingError> {
        // A thread that has failed is gone.
        let _ = self.queue.finish().await;
        self.queue.failure().map_or(Ok(()), Err)
    }

    fn event(&self, event: &Event, times: Times) {
        self.queue.push(Entry::Event { json: event.to_string(), times });
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // The tap may keep the queue open for longer. Nobody waits for the end.
        drop(self.queue.finish());
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
        let queue = Queue::into_file(out, self.frame_id)?;
        Ok(Recorder { queue, expected: None, disconnected: false })
    }
}
