//! [`Recorder`] and its builder: the handle through which a service records. Turns scans,
//! replies and errors into items of the [`Queue`].

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use tokio::time::Instant;

use super::RecordingError;
use super::file::RecordingFile;
use super::item::WriteItem;
use super::output::Output;
use super::parts::{Limits, further_part, next_path};
use super::progress::Progress;
use super::queue::{Queue, QueueSettings};
use super::writer::Times;
use crate::event::{Event, Events};
use crate::ros;
use tokio_scip::RawReply;
use tokio_scip::{Error, ReplyObservation, Scan, ScanStream, Sensor};

/// Records the items of a [`ScanStream`] and the replies of a sensor into an
/// MCAP file.
///
/// No method waits for a disk. One thread writes the file, and ends a chunk of it at least
/// once a second. Another thread makes the system write it to the disk, once a second. If the
/// process dies or the disk is full, you lose at most one second; if the power fails, at most
/// two, unless the disk is slower ([`sync_interval`](RecorderBuilder::sync_interval)). The
/// [module](super) has an example.
///
/// Dropping a recorder ends the file as [`finish`](Self::finish) does, without
/// waiting for it.
#[derive(Debug)]
pub struct Recorder {
    queue: Arc<Queue>,
    events: Events,
    observation: Option<ReplyObservation>,
    is_complete: bool,
}

/// Settings of a [`Recorder`]; made by [`Recorder::builder`].
#[derive(Debug, Clone)]
#[must_use = "a builder does nothing until it creates a recorder"]
pub struct RecorderBuilder {
    frame_id: String,
    overwrite: bool,
    limits: Limits,
    sync_interval: Option<Duration>,
    before: Option<Duration>,
}

impl Recorder {
    /// Creates a new file and records into it. [`builder`](Self::builder) has more
    /// options.
    ///
    /// # Errors
    ///
    /// Fails with [`RecordingError::Exists`] if there is such a file,
    /// [`RecordingError::Open`] if it cannot be created, and [`RecordingError::Write`] if its
    /// head cannot be written.
    pub fn create(path: impl AsRef<Path>) -> Result<Self, RecordingError> {
        Self::builder().create(path)
    }

    /// Creates a builder with the default settings.
    pub fn builder() -> RecorderBuilder {
        RecorderBuilder {
            frame_id: "laser".to_owned(),
            overwrite: false,
            limits: Limits::default(),
            sync_interval: Some(Duration::from_secs(1)),
            before: None,
        }
    }

    /// Records the bytes of every reply of an open sensor, from now until the recorder ends: first
    /// the reply to `V` that the driver knows, and then each one that comes. A replay sends them.
    ///
    /// A recorder observes one sensor: a second call ends the first observation. To record the
    /// replies with which a sensor is opened, set an [`observer`](Self::observer) instead.
    pub fn observe(&mut self, sensor: &Sensor) {
        self.observation = None;
        self.observation = Some(sensor.observe_replies(self.observer()));
    }

    /// Creates an observer for [`SensorBuilder::on_reply`](tokio_scip::SensorBuilder::on_reply), which
    /// records the bytes of each reply, including those with which the sensor is opened. For a
    /// sensor that is open already, [`observe`](Self::observe) it. Do only one of both: otherwise
    /// each reply is recorded twice.
    pub fn observer(&self) -> impl Fn(RawReply<'_>) + Send + Sync + 'static {
        let queue = Arc::clone(&self.queue);
        let began = Instant::now();
        move |reply| {
            let command = reply.command.map_or_else(String::new, |command| command.to_string());
            // A sensor's version may have come long before the recording.
            let steady = reply.received_at.max(began).into_std();
            let times = Times { steady, wall: reply.stamp };
            queue.push(WriteItem::Reply { command, bytes: reply.bytes.into(), times });
        }
    }

    /// Records the sensor's version, the window and rate of the stream, and the baud rate, as
    /// metadata. A replay takes its window and rate from it. A baud rate that the port ignores,
    /// as fast replies have shown, is `none`.
    ///
    /// Cancel-safe: a dropped future has written nothing.
    ///
    /// # Errors
    ///
    /// The same as for [`Sensor::version`].
    pub async fn describe(&self, sensor: &Sensor, scans: &ScanStream) -> Result<(), Error> {
        let version = sensor.version().await?;
        let baud_rate = sensor.watch_state().get().baud_rate();
        let baud_rate = baud_rate.filter(|_| !sensor.stats().baud_rate_disproved);
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
    /// Fails with [`RecordingError::Write`] once writing has failed: the recording has ended,
    /// but the stream continues.
    pub fn record(&mut self, item: &Result<Scan, Error>) -> Result<(), RecordingError> {
        let times = match item {
            Ok(scan) => Times { steady: scan.received_at().into_std(), wall: scan.times().stamp },
            Err(_) => {
                let steady = Instant::now().into_std();
                Times { steady, wall: SystemTime::now() }
            }
        };
        for event in self.events.from_item(item) {
            self.event(&event, times);
        }
        if let Ok(scan) = item {
            self.queue.push(WriteItem::Scan(scan.clone()));
        }
        self.queue.failure().map_or(Ok(()), Err)
    }

    /// Writes what is held [before](RecorderBuilder::before) this call, and from now on every item.
    /// Does nothing if nothing is held back.
    pub fn trigger(&self) {
        self.queue.release();
    }

    /// Waits until at most 1 MiB is queued for the disk, or writing has failed.
    ///
    /// Use it as backpressure for a source that can wait, such as a replay, which then loses
    /// no scan to a slow disk. A sensor does not wait.
    ///
    /// Cancel-safe.
    pub async fn ready(&self) {
        self.queue.ready().await;
    }

    /// Current counts.
    pub fn progress(&self) -> Progress {
        self.queue.progress()
    }

    /// Writes all queued items, the file's index and its end. Returns the final counts once all of
    /// it is on the disk.
    ///
    /// Continues even if you drop this future.
    ///
    /// # Errors
    ///
    /// Fails with [`RecordingError::Write`] if this or any earlier write failed.
    pub async fn finish(mut self) -> Result<Progress, RecordingError> {
        if !self.is_complete {
            self.complete().await?;
        }
        self.queue.ended().await;
        self.queue.failure().map_or_else(|| Ok(self.progress()), Err)
    }

    /// Does the same as [`finish`](Self::finish), but does not wait until the file is on the disk: a
    /// slow disk may take longer for that than you want to wait. Records nothing afterwards.
    ///
    /// Continues even if you drop this future.
    ///
    /// # Errors
    ///
    /// The same as for [`finish`](Self::finish).
    pub async fn complete(&mut self) -> Result<Progress, RecordingError> {
        // First: replies that come meanwhile are not lost ones.
        self.observation = None;
        // An error means that the thread has ended; `failure` has the reason.
        let _ = self.queue.finish().await;
        self.is_complete = true;
        self.queue.failure().map_or_else(|| Ok(self.progress()), Err)
    }

    fn event(&self, event: &Event, times: Times) {
        self.queue.push(WriteItem::Event { json: event.to_string(), times });
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // Requests the end, because the observer may keep the queue open for longer. Does not
        // wait for it.
        drop(self.queue.finish());
    }
}

impl RecorderBuilder {
    /// Sets the frame of the scans, `header.frame_id` in ROS. Default: `laser`. A name that tf2 does
    /// not accept is an [error](RecordingError::FrameId) when you open or start the recording.
    pub fn frame_id(mut self, frame_id: impl Into<String>) -> Self {
        self.frame_id = frame_id.into();
        self
    }

    /// Sets whether to overwrite an existing file. Default: `false`. Always uses an empty
    /// file, and always [refuses](RecordingError::Exists) further files of an older, split
    /// recording.
    pub fn overwrite(mut self, overwrite: bool) -> Self {
        self.overwrite = overwrite;
        self
    }

    /// Splits the recording into files of this duration.
    ///
    /// A file ends after the first scan that reaches the limit, and the recording continues
    /// in the next file: `run.mcap` is followed by `run_0002.mcap`, `run_0003.mcap` and so
    /// on. Existing numbers are skipped, so no file is overwritten. No scan is lost or
    /// doubled. You can replay each file alone: it is complete, with the metadata and a reply
    /// to `V`.
    ///
    /// Without a limit, a recording is split after 65,000 chunks, 18 hours or more. This
    /// bounds the index of a file, which stays in memory until its end and takes 100 bytes
    /// for each chunk.
    ///
    /// [`write_to`](Self::write_to) never splits.
    pub fn split_duration(mut self, duration: Duration) -> Self {
        self.limits.duration = Some(duration);
        self
    }

    /// Splits the recording into files of this size; see
    /// [`split_duration`](Self::split_duration). The index at the end of a file is extra:
    /// less than 3 % at 10 scans per second.
    pub fn split_bytes(mut self, bytes: u64) -> Self {
        self.limits.bytes = Some(bytes);
        self
    }

    /// Removes the oldest files of a split recording while all files together are larger than
    /// this. Never removes the current file. If you also limit the [size of a
    /// file](Self::split_bytes) to at most half of it, the recording never takes more space, except
    /// for the metadata and the index of the current file: old files are removed before a second of
    /// data is written.
    ///
    /// If you restart and create a recorder under the same name, it continues after the last
    /// file: it neither refuses nor overwrites existing files. While another recorder writes the
    /// last file, it fails with [`RecordingError::Busy`].
    pub fn keep_bytes(mut self, bytes: u64) -> Self {
        self.limits.keep_bytes = Some(bytes);
        self
    }

    /// Removes the files of a split recording that ended longer ago than this, by the wall
    /// clock; see [`keep_bytes`](Self::keep_bytes). Keeps files from before 2020, when the
    /// clock was not set.
    pub fn keep_duration(mut self, duration: Duration) -> Self {
        self.limits.keep_duration = Some(duration);
        self
    }

    /// Sets how often to sync the written bytes to the disk. If the power fails, you lose at
    /// most this time plus one second. Default: 1 s. `None` leaves it to the system, which
    /// takes half a minute on Linux.
    ///
    /// A separate thread syncs, so a slow disk delays neither scans nor streams;
    /// [`Progress::late_syncs`] counts the syncs that took longer than this. If a sync fails,
    /// the recording ends. The name of a file is synced when the file is created. Syncs only
    /// files, not the writers of [`write_to`](Self::write_to).
    pub fn sync_interval(mut self, interval: Option<Duration>) -> Self {
        self.sync_interval = interval;
        self
    }

    /// Makes the recorder a black box: it holds the items of this time in memory, and writes them
    /// when you [trigger](Recorder::trigger) it. From then on it records everything.
    ///
    /// Holds at most 4 MiB, about a minute and a half of full scans and their replies at 10 Hz:
    /// beyond that the oldest items are dropped earlier. Without a trigger the file stays empty.
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use tokio_scip::{Rate, Sensor, Window};
    /// # use urg_emulator::Emulator;
    /// # use urg_recording::Recorder;
    /// # #[tokio::main(flavor = "current_thread", start_paused = true)]
    /// # async fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # let sensor = Sensor::builder().connect(Emulator::default()).await?;
    /// let before = Duration::from_secs(60);
    /// let mut recorder = Recorder::builder().before(before).write_to(Vec::new())?;
    /// recorder.observe(&sensor);
    /// let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
    /// recorder.describe(&sensor, &scans).await?;
    /// for n in 0..6000 {
    ///     let Some(item) = scans.next().await else { break };
    ///     recorder.record(&item)?;
    ///     if n == 5000 {
    ///         recorder.trigger(); // the vehicle has hit something
    ///     }
    /// }
    /// // 60 s before the trigger, 100 s after it.
    /// assert_eq!(recorder.finish().await?.scans, 601 + 999);
    /// # Ok(())
    /// # }
    /// ```
    pub fn before(mut self, before: Duration) -> Self {
        self.before = Some(before);
        self
    }

    /// Creates the file and records into it.
    ///
    /// # Errors
    ///
    /// The same as for [`Recorder::create`].
    pub fn create(self, path: impl AsRef<Path>) -> Result<Recorder, RecordingError> {
        let file = self.open(path)?;
        self.record_into(file)
    }

    /// Opens the file that [`create`](Self::create) would record into, for
    /// [`record_into`](Self::record_into).
    ///
    /// # Errors
    ///
    /// The same as for [`RecordingFile::open`].
    pub fn open(&self, path: impl AsRef<Path>) -> Result<RecordingFile, RecordingError> {
        self.check_frame_id()?;
        let path = path.as_ref();
        if self.limits.removes_old() {
            return RecordingFile::open_part(path.to_owned(), next_path(path)?, self.overwrite);
        }
        // Further files of an older recording would lie between the files of this one.
        if let Some(path) = further_part(path) {
            return Err(RecordingError::Exists { path });
        }
        RecordingFile::open(path, self.overwrite)
    }

    /// Records into a file that you opened, and after a split into files beside it, named as
    /// [`split_duration`](Self::split_duration) describes.
    ///
    /// # Errors
    ///
    /// The same as for [`write_to`](Self::write_to).
    pub fn record_into(self, file: RecordingFile) -> Result<Recorder, RecordingError> {
        self.check_frame_id()?;
        let (current, first) = (file.path().to_owned(), file.first().map(Path::to_owned));
        let out = file.begin().map_err(RecordingError::write)?;
        self.start(out, &current, first)
    }

    /// Records into any writer, such as a pipe. Makes no further files: after 150,000 chunks,
    /// 41 hours or more, a recording ends without an index, and other readers have to read it
    /// from its beginning.
    ///
    /// # Errors
    ///
    /// Fails with [`RecordingError::Write`] if the file's head cannot be written, or no
    /// thread can be started.
    pub fn write_to(self, out: impl Write + Send + 'static) -> Result<Recorder, RecordingError> {
        self.check_frame_id()?;
        let out = Output { writer: Box::new(out), durable: None };
        self.start(out, Path::new(""), None)
    }

    fn check_frame_id(&self) -> Result<(), RecordingError> {
        match ros::is_frame_id(&self.frame_id) {
            true => Ok(()),
            false => Err(RecordingError::FrameId { frame_id: self.frame_id.clone() }),
        }
    }

    fn start(
        self,
        out: Output,
        current: &Path,
        path: Option<PathBuf>,
    ) -> Result<Recorder, RecordingError> {
        let Self { limits, frame_id, sync_interval, before, .. } = self;
        let settings = QueueSettings { limits, frame_id, sync_interval, before };
        let queue = Queue::into_file(out, current, path, settings)?;
        Ok(Recorder { queue, events: Events::new(), observation: None, is_complete: false })
    }
}
