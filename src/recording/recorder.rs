//! [`Recorder`] and its builder: the handle through which a service records. It
//! turns scans, replies and errors into items of the [`Queue`].

use std::collections::BTreeMap;
use std::fs::OpenOptions;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use super::RecordingError;
use super::parts::Limits;
use super::progress::Progress;
use super::queue::{Queue, WriteItem};
use super::writer::Times;
use crate::observer::RawReply;
use crate::{Error, Event, Events, Scan, ScanStream, Sensor};

/// Records the items of a [`ScanStream`] and the replies of a sensor into an
/// MCAP file.
///
/// No method waits for a disk. A thread of its own writes the file, and ends a
/// chunk of it at least each second. So a kill or a full disk costs the last
/// second at most. A loss of power may cost more: the system's buffers are lost
/// with it. The [module](super) has an example.
///
/// Dropping a recorder ends the file as [`finish`](Self::finish) does, without
/// waiting for it.
#[derive(Debug)]
pub struct Recorder {
    queue: Arc<Queue>,
    events: Events,
}

/// The settings of a [`Recorder`]; made by [`Recorder::builder`].
#[derive(Debug, Clone)]
#[must_use = "a builder does nothing until it creates a recorder"]
pub struct RecorderBuilder {
    frame_id: String,
    overwrite: bool,
    limits: Limits,
}

impl Recorder {
    /// Creates a new file and records into it. [`builder`](Self::builder) has more
    /// options.
    ///
    /// # Errors
    ///
    /// Fails with [`RecordingError::Exists`] if there is such a file,
    /// [`RecordingError::Open`] if it cannot be created, and
    /// [`RecordingError::Write`] if its head cannot be written.
    pub fn create(path: impl AsRef<Path>) -> Result<Self, RecordingError> {
        Self::builder().create(path)
    }

    /// Returns a builder with the default settings.
    pub fn builder() -> RecorderBuilder {
        RecorderBuilder {
            frame_id: "laser".to_owned(),
            overwrite: false,
            limits: Limits::default(),
        }
    }

    /// Returns an observer for
    /// [`SensorBuilder::on_reply`](crate::SensorBuilder::on_reply), which records
    /// the bytes of each reply. Without it the recording cannot be replayed.
    pub fn observer(&self) -> impl Fn(RawReply<'_>) + Send + Sync + 'static {
        let queue = Arc::clone(&self.queue);
        move |reply| {
            let command = reply.command.map_or_else(String::new, |command| command.to_string());
            let times = Times { steady: reply.received_at.into_std(), wall: reply.stamp };
            queue.push(WriteItem::Reply { command, bytes: reply.bytes.into(), times });
        }
    }

    /// Records the sensor's version, the window and rate of the stream, and the
    /// baud rate, as metadata. A replay takes the window and the rate from it.
    ///
    /// Cancel-safe: a dropped future has written nothing.
    ///
    /// # Errors
    ///
    /// Fails as [`Sensor::version`] does.
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
        self.queue.push(WriteItem::Metadata(metadata));
        Ok(())
    }

    /// Records an item of a [`ScanStream`]: a scan or an error. Also records an
    /// event for missed scans and for the first scan after a lost link. Never
    /// waits.
    ///
    /// # Errors
    ///
    /// Fails with [`RecordingError::Write`] once writing has failed: the recording
    /// has ended. The stream goes on.
    pub fn record(&mut self, item: &Result<Scan, Error>) -> Result<(), RecordingError> {
        let times = match item {
            Ok(scan) => Times { steady: scan.received_at().into_std(), wall: scan.stamp() },
            Err(_) => {
                let steady = tokio::time::Instant::now().into_std();
                Times { steady, wall: SystemTime::now() }
            }
        };
        for event in self.events.of(item) {
            self.event(&event, times);
        }
        if let Ok(scan) = item {
            self.queue.push(WriteItem::Scan(scan.clone()));
        }
        self.queue.failure().map_or(Ok(()), Err)
    }

    /// Waits until at most 1 MiB is queued for the disk, or writing has failed.
    ///
    /// This is backpressure for a source that can wait, such as a replay: it
    /// loses no scan to a slow disk. A sensor does not wait.
    ///
    /// Cancel-safe.
    pub async fn ready(&self) {
        self.queue.ready().await;
    }

    /// Returns the counts up to now.
    pub fn progress(&self) -> Progress {
        self.queue.progress()
    }

    /// Writes all queued items, the file's index and its end. Returns the final
    /// counts.
    ///
    /// Dropping this future does not stop that.
    ///
    /// # Errors
    ///
    /// Fails with [`RecordingError::Write`] if this or any write before it failed.
    pub async fn finish(self) -> Result<Progress, RecordingError> {
        // An error means that the thread has ended; `failure` returns why.
        let _ = self.queue.finish().await;
        self.queue.failure().map_or_else(|| Ok(self.progress()), Err)
    }

    fn event(&self, event: &Event, times: Times) {
        self.queue.push(WriteItem::Event { json: event.to_string(), times });
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // The observer may keep the queue open for longer, so the end is
        // requested. Nobody waits for it.
        drop(self.queue.finish());
    }
}

impl RecorderBuilder {
    /// Sets the frame of the scans, `header.frame_id` in ROS. The default is
    /// `laser`.
    pub fn frame_id(mut self, frame_id: impl Into<String>) -> Self {
        self.frame_id = frame_id.into();
        self
    }

    /// Sets whether an existing file is overwritten. The default is `false`.
    pub fn overwrite(mut self, overwrite: bool) -> Self {
        self.overwrite = overwrite;
        self
    }

    /// Splits the recording into files of this duration.
    ///
    /// A file ends behind the first scan that reaches the limit, and the recording
    /// goes on in the next one: `run.mcap` is followed by `run_0002.mcap`,
    /// `run_0003.mcap` and so on. Numbers that exist already are left out, so no
    /// file is overwritten. No scan is lost or doubled, and each file is complete:
    /// it has the metadata and a reply to `V`, and can be replayed alone.
    ///
    /// Without a limit a recording is split after 65,000 chunks, which is 18 hours
    /// or more. The index of a file stays in memory until its end, 100 bytes for
    /// each chunk, and this bounds it.
    ///
    /// [`write_to`](Self::write_to) never splits.
    pub fn split_duration(mut self, duration: Duration) -> Self {
        self.limits.duration = Some(duration);
        self
    }

    /// Splits the recording into files of this size; see
    /// [`split_duration`](Self::split_duration). The index at the end of a file
    /// comes on top, less than 3 % of it at 10 scans a second.
    pub fn split_bytes(mut self, bytes: u64) -> Self {
        self.limits.bytes = Some(bytes);
        self
    }

    /// Creates the file and records into it.
    ///
    /// # Errors
    ///
    /// Fails as [`Recorder::create`] does.
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
            Ok(file) => {
                // A pipe or a device has no place for further files.
                let is_file = file.metadata().is_ok_and(|metadata| metadata.is_file());
                self.start(file, is_file.then(|| path.to_owned()))
            }
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                Err(RecordingError::Exists { path: path.to_owned() })
            }
            Err(error) => {
                Err(RecordingError::Open { path: path.to_owned(), source: Arc::new(error) })
            }
        }
    }

    /// Records into any writer, such as a pipe. There are no further files: a
    /// recording of more than 65,536 chunks ends without an index, so that other
    /// readers have to read it from its beginning.
    ///
    /// # Errors
    ///
    /// Fails with [`RecordingError::Write`] if the file's head cannot be written,
    /// or no thread can be started.
    pub fn write_to(self, out: impl Write + Send + 'static) -> Result<Recorder, RecordingError> {
        self.start(out, None)
    }

    /// Records into `first`, and after a split into files beside `path`, named as
    /// [`split_duration`](Self::split_duration) describes. For a file that is
    /// opened or wrapped by the caller.
    ///
    /// # Errors
    ///
    /// Fails as [`write_to`](Self::write_to) does.
    pub fn write_to_parts(
        self,
        first: impl Write + Send + 'static,
        path: impl Into<PathBuf>,
    ) -> Result<Recorder, RecordingError> {
        self.start(first, Some(path.into()))
    }

    fn start(
        self,
        out: impl Write + Send + 'static,
        path: Option<PathBuf>,
    ) -> Result<Recorder, RecordingError> {
        let queue = Queue::into_file(out, path, self.limits, self.frame_id)?;
        Ok(Recorder { queue, events: Events::new() })
    }
}
