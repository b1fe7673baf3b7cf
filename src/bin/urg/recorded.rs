//! A recording in the place of a port: what it says of itself, and how it is
//! replayed.

use std::fmt;
use std::future::poll_fn;
use std::path::{Path, PathBuf};
use std::pin::pin;
use std::sync::Arc;
use std::task::Poll;

use tokio::sync::watch;
use tokio_scip::recording::{Recording, ReplayPace};
use tokio_scip::{Driver, Error, Rate, Sensor, SensorBuilder, Window};

use crate::contents::{self, Row};
use crate::failure::Failure;
use crate::notice::notice;

/// By how many scans a replay may be ahead of whoever takes them.
const AHEAD: u64 = 256;

/// A recording.
#[derive(Debug, Clone)]
pub(crate) struct Recorded {
    path: PathBuf,
    window: Option<Window>,
    rate: Option<Rate>,
    pace: ReplayPace,
    /// How many scans were taken from feeds.
    taken: Arc<watch::Sender<u64>>,
}

impl Recorded {
    /// The recording that `text` names, if it names one; or why there are none.
    pub(crate) fn named(text: &str) -> Result<Option<Self>, String> {
        Ok(Self::is_name(Path::new(text)).then(|| Self {
            path: text.into(),
            window: None,
            rate: None,
            pace: ReplayPace::Recorded,
            taken: Arc::default(),
        }))
    }

    /// Whether a file of this name is taken for a recording.
    pub(crate) fn is_name(path: &Path) -> bool {
        path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"))
    }

    /// Looks into the file for what was asked of the sensor.
    pub(crate) fn look(&mut self) -> Result<(), Failure> {
        let recording = self.open()?;
        (self.window, self.rate) = (recording.window(), recording.rate());
        Ok(())
    }

    /// The window that was recorded, if it was written down.
    pub(crate) fn window(&self) -> Option<Window> {
        self.window
    }

    /// Sets the pace to `rate`, or to its own: gives the rate that was
    /// recorded, if it was written down.
    pub(crate) fn paced_at(&mut self, rate: Option<Rate>) -> Option<Rate> {
        self.pace = rate.map_or(ReplayPace::Recorded, |_| ReplayPace::Max);
        self.rate
    }

    /// What is in it, to be told.
    pub(crate) async fn contents(&self) -> Result<Vec<Row>, Failure> {
        let recording = self.open()?;
        let read = tokio::task::spawn_blocking(|| contents::rows(recording)).await;
        match read {
            Ok(rows) => rows.map_err(|error| self.failure(&error)),
            Err(error) => Err(self.failure(&error)),
        }
    }

    /// Whether it is this file.
    pub(crate) fn is(&self, path: &Path) -> bool {
        let real = |path: &Path| path.canonicalize().ok();
        real(&self.path).is_some_and(|own| Some(own) == real(path))
    }

    /// Begins the replay. Where nothing is to be lost it waits for whoever
    /// takes the scans.
    pub(crate) fn start(&self, builder: SensorBuilder, lossless: bool) -> Result<Sensor, Failure> {
        let emulator = self.open()?.replay(self.pace).map_err(|error| self.failure(&error))?;
        let (sensor, driver) = builder.reconnect(false).build(emulator);
        if lossless {
            tokio::spawn(hold_back(driver, sensor.clone(), self.taken.subscribe()));
        } else {
            tokio::spawn(driver);
        }
        Ok(sensor)
    }

    /// Takes notice that a scan was taken.
    pub(crate) fn took(&self) {
        self.taken.send_modify(|taken| *taken += 1);
    }

    /// What to make of a replay that ended with `error`.
    pub(crate) fn end(&self, error: &Error) -> Result<(), Failure> {
        match error {
            Error::Disconnected { source: None } => {
                notice(format_args!("{self}: the recording has ended"));
                Ok(())
            }
            Error::Disconnected { source: Some(error) } => Err(self.failure(error)),
            error => Err(self.failure(error)),
        }
    }

    fn open(&self) -> Result<Recording, Failure> {
        Recording::open(&self.path).map_err(|error| self.failure(&error))
    }

    fn failure(&self, error: &dyn std::error::Error) -> Failure {
        Failure::at(&self.to_string(), error)
    }
}

impl fmt::Display for Recorded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.path.display().fmt(f)
    }
}

/// Runs the driver, no further than some scans ahead of those that were taken.
/// To a driver it is as if the system had no time for it.
async fn hold_back(driver: Driver, sensor: Sensor, mut taken: watch::Receiver<u64>) {
    let mut driver = pin!(driver);
    loop {
        let enough = sensor.stats().scans.saturating_sub(AHEAD);
        // The sender is there for as long as anybody takes scans.
        let Ok(seen) = taken.wait_for(|taken| *taken >= enough).await.map(|taken| *taken) else {
            return;
        };
        let ended = poll_fn(|cx| {
            if driver.as_mut().poll(cx).is_ready() {
                return Poll::Ready(true);
            }
            if sensor.stats().scans > seen + AHEAD { Poll::Ready(false) } else { Poll::Pending }
        });
        if ended.await {
            return;
        }
    }
}
