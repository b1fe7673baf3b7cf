//! [`ScanBuilder`]: scans from any values, for tests and for sources other than a sensor.

use std::time::{Duration, SystemTime};

use tokio::time::Instant;

use super::values::Values;
use super::{Scan, ScanMeta};
use crate::Error;
use crate::protocol::{Geometry, Protocol, Window, WindowError};

/// Largest value of 12 bits, in SCIP 1.1.
const MAX_VALUE: u32 = (1 << 12) - 1;
/// Largest value of 18 bits, in SCIP 2.
const MAX_LONG_VALUE: u32 = (1 << 18) - 1;

impl Scan {
    /// Makes a scan of `window` from your values, one for each point, as if it had just
    /// arrived. Set the rest on the [`ScanBuilder`].
    ///
    /// ```
    /// use tokio_scip::{Scan, Window};
    ///
    /// /// Returns the distance to the nearest object in metres.
    /// fn nearest(scan: &Scan) -> Option<f32> {
    ///     scan.nearest().map(|point| point.range)
    /// }
    ///
    /// // Millimetres; values below 20 are error codes.
    /// let scan = Scan::builder(Window::new(383..=385)?, [900, 0, 1250]).build()?;
    /// assert_eq!(nearest(&scan), Some(0.9));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn builder(window: Window, values: impl Into<Vec<u32>>) -> ScanBuilder {
        let now = Instant::now();
        let meta = ScanMeta {
            sequence: 0,
            requested_at: now,
            first_byte_at: now,
            received_at: now,
            stamp: SystemTime::now(),
            lateness: None,
            postponed: Duration::ZERO,
            repeat: false,
            scan_time: Geometry::URG_04LX.revolution(),
            geometry: Geometry::URG_04LX,
            sensor_clock: None,
            reconnects: 0,
        };
        ScanBuilder { window, values: values.into(), intensities: Vec::new(), meta }
    }
}

/// Builder of a [`Scan`]; made by [`Scan::builder`].
///
/// By default, the scan is number 0 of a URG-04LX at 600 rpm, is no repeat, and was requested
/// and received when the builder was made.
#[derive(Debug, Clone)]
#[must_use = "a builder does nothing until it builds a scan"]
pub struct ScanBuilder {
    window: Window,
    values: Vec<u32>,
    intensities: Vec<u32>,
    meta: ScanMeta,
}

impl ScanBuilder {
    /// Sets [`Scan::intensities`]: one for each point, or none.
    pub fn intensities(mut self, intensities: impl Into<Vec<u32>>) -> Self {
        self.intensities = intensities.into();
        self
    }

    /// Sets [`Scan::sequence`].
    pub fn sequence(mut self, sequence: u64) -> Self {
        self.meta.sequence = sequence;
        self
    }

    /// Sets [`Scan::received_at`], and the times of the request and of the first byte to the same.
    pub fn received_at(mut self, received_at: Instant) -> Self {
        let [requested_at, first_byte_at] = [received_at; 2];
        self.meta = ScanMeta { requested_at, first_byte_at, received_at, ..self.meta };
        self
    }

    /// Sets the [`stamp`](super::ScanTimes::stamp).
    pub fn stamp(mut self, stamp: SystemTime) -> Self {
        self.meta.stamp = stamp;
        self
    }

    /// Sets [`Scan::is_repeat`].
    pub fn repeat(mut self, repeat: bool) -> Self {
        self.meta.repeat = repeat;
        self
    }

    /// Sets [`Scan::geometry`], and [`Scan::scan_time`] to the nominal revolution. The window gets
    /// the steps of this sensor: pass as many values.
    pub fn geometry(mut self, geometry: Geometry) -> Self {
        self.meta = ScanMeta { geometry, scan_time: geometry.revolution(), ..self.meta };
        self
    }

    /// Sets [`Scan::scan_time`].
    pub fn scan_time(mut self, scan_time: Duration) -> Self {
        self.meta.scan_time = scan_time;
        self
    }

    /// Takes everything but the window and the values from `scan`.
    pub fn like(self, scan: &Scan) -> Self {
        Self { meta: scan.meta, ..self }
    }

    /// Builds the scan.
    ///
    /// # Errors
    ///
    /// [`ScanError`] if you did not pass one value for each point (and as many intensities, if any), if
    /// one is above 4095 (SCIP 2: 262143), or if the sensor does not measure the window.
    pub fn build(self) -> Result<Scan, ScanError> {
        let Self { window, mut values, intensities, meta } = self;
        let window = window.resolve(&meta.geometry)?;
        let expected = window.points();
        let lengths = [Some(values.len()), Some(intensities.len()).filter(|count| *count > 0)];
        if let Some(found) = lengths.into_iter().flatten().find(|found| *found != expected) {
            return Err(ScanError::Length { window, expected, found });
        }
        let is_short = meta.geometry.protocol() == Protocol::Scip1;
        let max = if is_short { MAX_VALUE } else { MAX_LONG_VALUE };
        if let Some((index, &found)) = values.iter().enumerate().find(|(_, value)| **value > max) {
            return Err(ScanError::Value { index, found, max });
        }
        let values = if !intensities.is_empty() {
            values.extend(intensities);
            Values::WithIntensities(values.into())
        } else if is_short {
            // The casts are exact.
            Values::Short(values.into_iter().map(|value| value as u16).collect())
        } else {
            Values::Long(values.into())
        };
        Ok(Scan::new(window, values, 0, meta))
    }
}

/// Error for values that make no [`Scan`].
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ScanError {
    /// The number of values differs from the window's number of points.
    #[error("invalid scan of {window}: expected {expected} values, found {found}")]
    Length {
        /// Window of the scan.
        window: Window,
        /// Number of points in the window.
        expected: usize,
        /// Number of values.
        found: usize,
    },
    /// A value has more than 12 bits in SCIP 1.1, or 18 in SCIP 2.
    #[error("invalid scan: expected values of 0 to {max}, found {found} at index {index}")]
    Value {
        /// Index of the first such value, from 0.
        index: usize,
        /// Value.
        found: u32,
        /// Largest value allowed.
        max: u32,
    },
    /// The sensor does not measure the window.
    #[error(transparent)]
    Window(#[from] WindowError),
}

impl From<ScanError> for Error {
    fn from(error: ScanError) -> Self {
        Self::other(error)
    }
}
