//! [`Clock`]: the sensor's own clock, which SCIP 2 sends with each scan.

use std::time::Duration;

use tokio::time::Instant;

/// Clock that starts at power-up, runs fast or slow, and may jump.
#[derive(Debug, Clone)]
pub(super) struct Clock {
    origin: Instant,
    /// Microseconds at the origin.
    at_origin: i128,
    /// How much faster it runs than the host's, as a fraction.
    rate: f64,
}

impl Clock {
    pub(super) fn new(now: Instant, first: Duration, rate: f64) -> Self {
        Self { origin: now, at_origin: first.as_micros() as i128, rate: rate.clamp(-0.5, 0.5) }
    }

    /// Microseconds since the clock was last at zero.
    pub(super) fn read(&self, at: Instant) -> u64 {
        let micros = |since: Duration| {
            since.as_micros() as i128 + (since.as_secs_f64() * 1e6 * self.rate) as i128
        };
        let since = micros(at.saturating_duration_since(self.origin));
        let before = micros(self.origin.saturating_duration_since(at));
        u64::try_from(self.at_origin + since - before).unwrap_or(0)
    }

    pub(super) fn restart(&mut self, now: Instant) {
        (self.origin, self.at_origin) = (now, 0);
    }

    /// Moves the clock forward by this number of milliseconds, or back.
    pub(super) fn jump(&mut self, milliseconds: i64) {
        self.at_origin += i128::from(milliseconds) * 1000;
    }

    pub(super) fn set_rate(&mut self, now: Instant, rate: f64) {
        *self = Self::new(now, Duration::from_micros(self.read(now)), rate);
    }
}
