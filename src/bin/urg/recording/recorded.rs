//! A recording in the place of a port: its settings, and its replay.

use std::fmt;
use std::future::poll_fn;
use std::ops::Bound;
use std::path::{Path, PathBuf};
use std::pin::pin;
use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use tokio::sync::watch;
use tokio_scip::recording::{Recording, RecordingError, ReplayPace};
use tokio_scip::{Driver, Rate, Sensor, SensorBuilder, Version, Window};

use super::contents::{self, Row};
use super::span::TimeSpan;
use crate::delivery::Delivery;
use crate::failure::Failure;

/// A replay that waits for its consumer is at most so many scans ahead of it.
const MAX_SCANS_AHEAD: u64 = 256;

/// A recording.
#[derive(Debug, Clone)]
pub(crate) struct Recorded {
    path: PathBuf,
    window: Option<Window>,
    rate: Option<Rate>,
    pace: ReplayPace,
    /// The part that is read; all of it without one.
    range: Option<TimeSpan>,
    /// The number of scans that were taken from feeds.
    taken: Arc<watch::Sender<u64>>,
}

impl Recorded {
    /// Returns the recording that `text` names, if it names one. Fails if this
    /// build reads none.
    pub(crate) fn named(text: &str) -> Result<Option<Self>, String> {
        Ok(Self::is_name(Path::new(text)).then(|| Self {
            path: text.into(),
            window: None,
            rate: None,
            pace: ReplayPace::Recorded,
            range: None,
            taken: Arc::default(),
        }))
    }

    /// Returns whether a file of this name counts as a recording.
    pub(crate) fn is_name(path: &Path) -> bool {
        path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"))
    }

    /// Reads the recorded window and rate from the file.
    pub(crate) fn read_settings(&mut self) -> Result<(), Failure> {
        let recording = self.open()?;
        (self.window, self.rate) = (recording.window(), recording.rate());
        Ok(())
    }

    /// Restricts it to a part.
    pub(crate) fn restrict(&mut self, range: TimeSpan) {
        self.range = Some(range);
    }

    /// Returns the recorded window, if the file has it.
    pub(crate) fn window(&self) -> Option<Window> {
        self.window
    }

    /// Sets the pace: as fast as it is polled with a `rate`, else the recorded
    /// one. Returns the recorded rate, if the file has it.
    pub(crate) fn set_pace(&mut self, rate: Option<Rate>) -> Option<Rate> {
        self.pace = rate.map_or(ReplayPace::Recorded, |_| ReplayPace::Max);
        self.rate
    }

    /// Reads all of it, and returns a row for each thing to report.
    pub(crate) async fn contents(&self) -> Result<Vec<Row>, Failure> {
        let recording = self.open()?;
        let path = self.path.clone();
        let read = tokio::task::spawn_blocking(move || contents::rows(&path, recording)).await;
        match read {
            Ok(rows) => rows.map_err(|error| self.failure(&error)),
            Err(error) => Err(self.failure(&error)),
        }
    }

    /// Returns whether it is the file at `path`.
    pub(crate) fn is(&self, path: &Path) -> bool {
        let real = |path: &Path| path.canonicalize().ok();
        real(&self.path).is_some_and(|own| Some(own) == real(path))
    }

    /// Begins the replay. It waits for its consumer if that has to get all scans.
    pub(crate) fn start(
        &self,
        builder: SensorBuilder,
        delivery: Delivery,
    ) -> Result<Sensor, Failure> {
        let emulator = self.open()?.replay(self.pace).map_err(|error| self.no_scans(&error))?;
        let (sensor, driver) = builder.build(emulator);
        match delivery {
            Delivery::All => {
                tokio::spawn(run_paced(driver, sensor.clone(), self.taken.subscribe()));
            }
            Delivery::Newest => {
                tokio::spawn(driver);
            }
        }
        Ok(sensor)
    }

    /// Returns the recorded sensor's version.
    pub(crate) async fn version(&self) -> Result<Version, Failure> {
        let sensor = self.start(Sensor::builder(), Delivery::Newest)?;
        sensor.version().await.map_err(|error| self.failure(&error))
    }

    /// Counts a scan that was taken from a feed.
    pub(crate) fn record_taken(&self) {
        self.taken.send_modify(|taken| *taken += 1);
    }

    pub(super) fn open(&self) -> Result<Recording, Failure> {
        let recording = self.open_all()?;
        Ok(match self.range {
            Some(range) => recording.range(range.bounds()),
            None => recording,
        })
    }

    /// Opens it at a place behind the beginning of its part.
    pub(super) fn open_at(&self, place: Duration) -> Result<Recording, Failure> {
        let end = self.range.map_or(Bound::Unbounded, |range| range.bounds().1);
        Ok(self.open_all()?.range((Bound::Included(place), end)))
    }

    fn open_all(&self) -> Result<Recording, Failure> {
        Recording::open(&self.path).map_err(|error| self.failure(&error))
    }

    /// Describes an error of reading the first scan: the part may have none.
    pub(super) fn no_scans(&self, error: &RecordingError) -> Failure {
        match (self.range, error) {
            (Some(range), RecordingError::NoReplies) => Failure::Failed(format!(
                "{self}: no scan in --range {range}: `urg info {self}` shows how long it is"
            )),
            _ => self.failure(error),
        }
    }

    pub(super) fn failure(&self, error: &dyn std::error::Error) -> Failure {
        Failure::at(&self.to_string(), error)
    }
}

impl fmt::Display for Recorded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.path.display().fmt(f)
    }
}

/// Runs the driver, but stops polling it while it is too many scans ahead of
/// the consumer. To the driver that is a busy system.
async fn run_paced(driver: Driver, sensor: Sensor, mut taken: watch::Receiver<u64>) {
    let mut driver = pin!(driver);
    loop {
        let enough = sensor.stats().scans.saturating_sub(MAX_SCANS_AHEAD);
        // The sender lives as long as its consumers.
        let Ok(seen) = taken.wait_for(|taken| *taken >= enough).await.map(|taken| *taken) else {
            return;
        };
        let ended = poll_fn(|cx| {
            if driver.as_mut().poll(cx).is_ready() {
                return Poll::Ready(true);
            }
            if sensor.stats().scans > seen + MAX_SCANS_AHEAD {
                Poll::Ready(false)
            } else {
                Poll::Pending
            }
        });
        if ended.await {
            return;
        }
    }
}
