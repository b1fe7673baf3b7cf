//! The rate that a schedule reaches.

use std::time::Duration;

use tokio::time::Instant;

/// How long the rate that is reached is averaged.
const RATE_SPAN: Duration = Duration::from_secs(3);

/// Measures the rate that is reached.
#[derive(Debug)]
pub(crate) struct RateMeter {
    since: Instant,
    scans: u32,
    pub(crate) reached: f64,
    /// Whether it was said that the rate is not reached.
    pub(crate) told: bool,
}

impl RateMeter {
    pub(crate) fn new(now: Instant) -> Self {
        Self { since: now, scans: 0, reached: 0.0, told: false }
    }

    /// Counts a poll that brought so many scans; gives the rate at the end of
    /// each span.
    pub(crate) fn count(&mut self, scans: u32, now: Instant) -> Option<f64> {
        self.scans += scans;
        let span = now.saturating_duration_since(self.since);
        if span < RATE_SPAN {
            return None;
        }
        self.reached = f64::from(self.scans) / span.as_secs_f64();
        self.restart(now);
        Some(self.reached)
    }

    pub(crate) fn restart(&mut self, now: Instant) {
        (self.since, self.scans) = (now, 0);
    }
}
