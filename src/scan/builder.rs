//! [`ScanBuilder`]: scans from any values, for tests and for other sources of scans
//! than a sensor.

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use tokio::time::Instant;

use super::{Scan, ScanMeta};
use crate::protocol::Window;

/// The largest 12-bit value.
const MAX_VALUE: u16 = 4095;
/// A revolution at 600 rpm.
pub(super) const REVOLUTION: Duration = Duration::from_millis(100);

/// A builder of a [`Scan`]; made by [`Scan::builder`].
///
/// Unless set, the scan is number 0 of a sensor at 600 rpm, is no repeat, and was
/// requested and received at the time of [`build`](Self::build).
#[derive(Debug, Clone)]
#[must_use = "a builder does nothing until it builds a scan"]
pub struct ScanBuilder {
    window: Window,
    values: Arc<[u16]>,
    sequence: u64,
    requested_at: Option<Instant>,
    received_at: Option<Instant>,
    stamp: Option<SystemTime>,
    repeat: bool,
    scan_time: Duration,
    reconnects: u64,
}

impl ScanBuilder {
    pub(super) fn new(window: Window, values: Arc<[u16]>) -> Self {
        Self {
            window,
            values,
            sequence: 0,
            requested_at: None,
            received_at: None,
            stamp: None,
            repeat: false,
            scan_time: REVOLUTION,
            reconnects: 0,
        }
    }

    /// Sets [`Scan::sequence`].
    pub fn sequence(mut self, sequence: u64) -> Self {
        self.sequence = sequence;
        self
    }

    /// Sets [`Scan::requested_at`]. Unless set, it is the same as `received_at`.
    pub fn requested_at(mut self, requested_at: Instant) -> Self {
        self.requested_at = Some(requested_at);
        self
    }

    /// Sets [`Scan::received_at`].
    pub fn received_at(mut self, received_at: Instant) -> Self {
        self.received_at = Some(received_at);
        self
    }

    /// Sets [`Scan::stamp`].
    pub fn stamp(mut self, stamp: SystemTime) -> Self {
        self.stamp = Some(stamp);
        self
    }

    /// Sets [`Scan::is_repeat`].
    pub fn repeat(mut self, repeat: bool) -> Self {
        self.repeat = repeat;
        self
    }

    /// Sets [`Scan::scan_time`].
    pub fn scan_time(mut self, scan_time: Duration) -> Self {
        self.scan_time = scan_time;
        self
    }

    /// Sets [`Scan::reconnects`].
    pub fn reconnects(mut self, reconnects: u64) -> Self {
        self.reconnects = reconnects;
        self
    }

    /// Makes the scan.
    ///
    /// # Errors
    ///
    /// [`InvalidScan`] if there is not one value for each point of the window, or if a
    /// value is above 4095.
    pub fn build(self) -> Result<Scan, InvalidScan> {
        let (expected, found) = (self.window.points(), self.values.len());
        if expected != found {
            return Err(InvalidScan::Length { window: self.window, expected, found });
        }
        if let Some(index) = self.values.iter().position(|&value| value > MAX_VALUE) {
            let found = self.values.get(index).copied().unwrap_or_default();
            return Err(InvalidScan::Value { index, found });
        }
        let received_at = self.received_at.unwrap_or_else(Instant::now);
        let meta = ScanMeta {
            sequence: self.sequence,
            requested_at: self.requested_at.unwrap_or(received_at),
            received_at,
            stamp: self.stamp.unwrap_or_else(SystemTime::now),
            repeat: self.repeat,
            scan_time: self.scan_time,
            reconnects: self.reconnects,
        };
        Ok(Scan::new(self.window, self.values, 0, meta))
    }
}

/// The error of values that make no [`Scan`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum InvalidScan {
    /// The number of values is not that of the window's points.
    #[error("invalid scan of {window}: expected {expected} values, found {found}")]
    Length {
        /// The window of the scan.
        window: Window,
        /// The number of its points.
        expected: usize,
        /// The number of values.
        found: usize,
    },
    /// A value has more than 12 bits.
    #[error("invalid scan: expected values of 0 to 4095, found {found} at index {index}")]
    Value {
        /// The place of the first such value, from 0.
        index: usize,
        /// The value.
        found: u16,
    },
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn what_is_set_is_what_the_scan_has() {
        let at = Instant::now();
        let later = at + Duration::from_millis(95);
        let stamp = SystemTime::UNIX_EPOCH + Duration::from_secs(1_800_000_000);
        let window = Window::new(384..=385).unwrap();
        let scan = Scan::builder(window, vec![1234, 7])
            .sequence(3)
            .requested_at(at)
            .received_at(later)
            .stamp(stamp)
            .repeat(true)
            .scan_time(Duration::from_millis(50))
            .reconnects(2)
            .build()
            .unwrap();
        assert_eq!((scan.window(), scan.values()), (window, &[1234, 7][..]));
        assert_eq!((scan.sequence(), scan.reconnects(), scan.is_repeat()), (3, 2, true));
        assert_eq!((scan.requested_at(), scan.received_at(), scan.stamp()), (at, later, stamp));
        assert_eq!(scan.scan_time(), 0.05);
    }

    #[test]
    fn values_that_do_not_fit_their_window_are_refused() {
        let build = |values: &[u16]| Scan::builder(Window::DETECTION, values).build();
        let error = build(&[1000; 681]).unwrap_err();
        let text = "invalid scan of steps 44..=725: expected 682 values, found 681";
        assert_eq!(error.to_string(), text);
        let mut values = [1000; 682];
        assert!(build(&values).is_ok());
        (values[9], values[10]) = (4095, 4096);
        assert_eq!(build(&values).unwrap_err(), InvalidScan::Value { index: 10, found: 4096 });
    }
}
