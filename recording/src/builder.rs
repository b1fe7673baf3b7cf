//! [`RecorderBuilder`]: settings of a recorder, and where it writes.

use std::io::Write;
use std::path::Path;
use std::time::Duration;

use super::file::RecordingFile;
use super::mcap::Compression;
use super::parts::{further_part, next_path};
use super::queue::{Queue, QueueSettings};
use super::recorder::Recorder;
use super::{RecordingError, ros};

/// Settings of a [`Recorder`]; made by [`Recorder::builder`].
#[derive(Debug, Clone)]
#[must_use = "a builder does nothing until it creates a recorder"]
pub struct RecorderBuilder {
    overwrite: bool,
    settings: QueueSettings,
}

impl Recorder {
    /// Creates a new file and records into it. [`builder`](Self::builder) has more options.
    ///
    /// # Errors
    ///
    /// Fails with [`RecordingError::Exists`] if there is such a file, [`RecordingError::Open`] if it cannot
    /// be created, and [`RecordingError::Write`] if its head cannot be written.
    pub fn create(path: impl AsRef<Path>) -> Result<Self, RecordingError> {
        Self::builder().create(path)
    }

    /// Creates a builder with the default settings.
    pub fn builder() -> RecorderBuilder {
        let settings = QueueSettings {
            frame_id: "laser".to_owned(),
            sync_interval: Some(Duration::from_secs(1)),
            ..QueueSettings::default()
        };
        RecorderBuilder { overwrite: false, settings }
    }
}

impl RecorderBuilder {
    /// Sets the frame of the scans, `header.frame_id` in ROS. Default: `laser`. A name that tf2 does
    /// not accept is an [error](RecordingError::FrameId) when you open or start the recording.
    pub fn frame_id(mut self, frame_id: impl Into<String>) -> Self {
        self.settings.frame_id = frame_id.into();
        self
    }

    /// Sets whether to overwrite an existing file. Default: `false`. Always uses an empty file, and always
    /// [refuses](RecordingError::Exists) further files of an older, split recording.
    pub fn overwrite(mut self, overwrite: bool) -> Self {
        self.overwrite = overwrite;
        self
    }

    /// Sets the compression of the file. Default: [`Compression::Plain`].
    ///
    /// In a crash you lose no more: each second is compressed and written alone. A second that does not get
    /// shorter is written as it is. One that this build does not [write](Compression::is_written) is an
    /// [error](RecordingError::NotWritten) when you start the recording.
    pub fn compression(mut self, compression: Compression) -> Self {
        self.settings.compression = compression;
        self
    }

    /// Splits the recording into files of this duration.
    ///
    /// A file ends after the first scan that reaches the limit, and the recording continues in the next file:
    /// `run.mcap` is followed by `run_0002.mcap`, `run_0003.mcap` and so on. Existing numbers are skipped, so
    /// no file is overwritten. No scan is lost or doubled. You can replay each file alone: it is complete,
    /// with the metadata and a reply to `V`.
    ///
    /// Without a limit, a recording is split after 4 GB, because FAT has no longer files, and after
    /// 65,000 chunks, 18 hours or more. This bounds the index of a file, which stays in memory until
    /// its end and takes 100 bytes for each chunk.
    ///
    /// If a file may not grow (EFBIG), by its file system or a limit of the process, the recording continues in the
    /// next one, and [`has_outgrown_file`](super::Progress::has_outgrown_file) is set. The first such file may have
    /// no room for an index; later ones end in time. Ignore the signal SIGXFSZ, which a limit of the process sends.
    ///
    /// [`write_to`](Self::write_to) never splits.
    pub fn split_duration(mut self, duration: Duration) -> Self {
        self.settings.limits.duration = Some(duration);
        self
    }

    /// Splits the recording into files of this size; see [`split_duration`](Self::split_duration). The index
    /// at the end of a file is extra: less than 3 % at 10 scans per second.
    pub fn split_bytes(mut self, bytes: u64) -> Self {
        self.settings.limits.bytes = Some(bytes);
        self
    }

    /// Removes the oldest files of a split recording while all files together are larger than this. Never
    /// removes the current file. If you also limit the [size of a file](Self::split_bytes) to at most half of
    /// it, the recording never takes more space, except for the metadata and the index of the current file:
    /// old files are removed before a second of data is written.
    ///
    /// If you restart and create a recorder under the same name, it continues after the last
    /// file: it neither refuses nor overwrites existing files. While another recorder writes the
    /// last file, it fails with [`RecordingError::Busy`].
    pub fn keep_bytes(mut self, bytes: u64) -> Self {
        self.settings.limits.keep_bytes = Some(bytes);
        self
    }

    /// Removes the files of a split recording that ended longer ago than this, by the wall clock; see
    /// [`keep_bytes`](Self::keep_bytes). Keeps files from before 2020, when the clock was not set.
    pub fn keep_duration(mut self, duration: Duration) -> Self {
        self.settings.limits.keep_duration = Some(duration);
        self
    }

    /// Sets how often to sync the written bytes to the disk. If the power fails, you lose at most this time
    /// plus one second. Default: 1 s. `None` leaves it to the system, which takes half a minute on Linux.
    ///
    /// A separate thread syncs, so a slow disk delays neither scans nor streams;
    /// [`late_syncs`](super::Progress::late_syncs) counts the syncs that took longer than this. If a
    /// sync fails, the recording ends. The name of a file is synced when the file is created. Syncs
    /// only files, not the writers of [`write_to`](Self::write_to).
    pub fn sync_interval(mut self, interval: Option<Duration>) -> Self {
        self.settings.sync_interval = interval;
        self
    }

    /// Makes the recorder a black box: it holds the items of this time in memory, and writes them
    /// when you [trigger](Recorder::trigger) it. From then on it records everything.
    ///
    /// Holds at most 4 MiB, about two minutes of full scans and their replies at 10 Hz, thirteen seconds
    /// of a UST: beyond that the oldest items are dropped earlier. Without a trigger the file stays empty.
    ///
    /// ```
    /// # use {tokio_scip::{Rate, Sensor, Window}, urg_emulator::Emulator, urg_recording::Recorder};
    /// # #[tokio::main(flavor = "current_thread", start_paused = true)]
    /// # async fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # let sensor = Sensor::builder().connect(Emulator::default()).await?;
    /// let minute = std::time::Duration::from_secs(60);
    /// let mut recorder = Recorder::builder().before(minute).write_to(Vec::new())?;
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
        self.settings.before = Some(before);
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

    /// Opens the file that [`create`](Self::create) would record into, for [`record_into`](Self::record_into).
    ///
    /// # Errors
    ///
    /// The same as for [`RecordingFile::open`].
    pub fn open(&self, path: impl AsRef<Path>) -> Result<RecordingFile, RecordingError> {
        self.check()?;
        let path = path.as_ref();
        if self.settings.limits.removes_old() {
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
        self.check()?;
        Queue::into_file(file, self.settings).map(Recorder::new)
    }

    /// Records into any writer, such as a pipe. Makes no further files: after 150,000 chunks, 41 hours or
    /// more, a recording ends without an index, and other readers have to read it from its beginning.
    ///
    /// # Errors
    ///
    /// Fails with [`RecordingError::Write`] if the file's head cannot be written, or no thread can be started.
    pub fn write_to(self, out: impl Write + Send + 'static) -> Result<Recorder, RecordingError> {
        self.check()?;
        Queue::into_writer(Box::new(out), None, None, self.settings).map(Recorder::new)
    }

    fn check(&self) -> Result<(), RecordingError> {
        let QueueSettings { frame_id, compression, .. } = &self.settings;
        if !ros::is_frame_id(frame_id) {
            return Err(RecordingError::FrameId { frame_id: frame_id.clone() });
        }
        compression.check()
    }
}
