//! [`Freshness`]: when the last good scan arrived, and why there is no newer one. A state
//! cannot report this: the sensor may answer every poll with a malformed reply.

use std::fmt;
use std::time::Duration;

use tokio::time::Instant;

use crate::{Error, ErrorChain};

/// When the last good scan arrived, and why there is no newer one.
///
/// Get it from [`ScanStream::freshness`](crate::ScanStream::freshness) for one stream,
/// or from [`Sensor::freshness`](crate::Sensor::freshness) for all scans of a sensor.
/// It is a snapshot: only its age changes, with the clock.
///
/// Serialises (feature `serde`) as `age` in seconds, null before the first scan, and
/// `error`, the text of the error and its causes, or null.
///
/// ```
/// # use urg_emulator::Emulator;
/// use std::time::Duration;
/// use tokio_scip::{ErrorChain, Rate, Sensor, Window};
///
/// # #[tokio::main(flavor = "current_thread", start_paused = true)]
/// # async fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let emulator = Emulator::default();
/// # let sensor = Sensor::builder().connect(emulator.clone()).await?;
/// const LIMIT: Duration = Duration::from_millis(500);
///
/// let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
/// assert!(scans.freshness().check(LIMIT).is_err(), "no scan yet");
/// scans.next().await;
/// assert!(scans.freshness().check(LIMIT).is_ok());
///
/// // A health check, when the cable has been out for two seconds.
/// # emulator.unplug();
/// # tokio::time::sleep(Duration::from_secs(2)).await;
/// let stale = scans.freshness().check(LIMIT).unwrap_err();
/// println!("not healthy: {}", ErrorChain(&stale));
/// # assert!(ErrorChain(&stale).to_string().contains("no port"), "{stale}");
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Freshness {
    #[cfg_attr(feature = "serde", serde(rename = "age", serialize_with = "super::age"))]
    last_scan: Option<Instant>,
    #[cfg_attr(feature = "serde", serde(serialize_with = "super::chain"))]
    error: Option<Error>,
}

impl Freshness {
    pub(crate) fn new(last_scan: Option<Instant>, error: Option<Error>) -> Self {
        Self { last_scan, error }
    }

    /// Time since the last good scan, or `None` before the first.
    pub fn age(&self) -> Option<Duration> {
        self.last_scan.map(|last_scan| last_scan.elapsed())
    }

    /// Checks that the last good scan is not older than `limit`.
    ///
    /// With a limit of three periods you tolerate two failed polls. Add the time of a
    /// reply: see [`Window::wire_time`](crate::Window::wire_time).
    ///
    /// # Errors
    ///
    /// [`StaleError`] with the reason if the last scan is older than `limit`, and before the first one.
    pub fn check(&self, limit: Duration) -> Result<(), StaleError> {
        match self.age() {
            Some(age) if age <= limit => Ok(()),
            age => Err(StaleError { age, limit, source: self.error.clone() }),
        }
    }
}

/// Error of [`Freshness::check`]: the last good scan is too old.
///
/// Write it with [`ErrorChain`](crate::ErrorChain) to include its cause.
#[derive(Clone, thiserror::Error)]
#[error(
    "{}",
    match age {
        Some(age) => format!("expected a scan within {limit:.1?}, but the last one is {age:.1?} old"),
        None => format!("expected a scan within {limit:.1?}, but none has arrived yet"),
    }
)]
#[non_exhaustive]
pub struct StaleError {
    /// Age of the last good scan, or `None` before the first.
    pub age: Option<Duration>,
    /// Limit of the check.
    pub limit: Duration,
    /// Latest error since that scan, if any.
    pub source: Option<Error>,
}

impl From<StaleError> for Error {
    fn from(error: StaleError) -> Self {
        Self::other(error)
    }
}

/// Writes the error and its cause, as [`Error`] does.
impl fmt::Debug for StaleError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(&ErrorChain(self), f)
    }
}
