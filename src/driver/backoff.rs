//! [`Backoff`]: how long to wait before something that failed is tried again.

use std::time::Duration;

/// Waits that double, each with a random part, so that many drivers that lost a
/// bus together do not come back together.
pub(crate) struct Backoff {
    shortest: Duration,
    longest: Duration,
    next: Duration,
    seed: u64,
}

impl Backoff {
    pub(crate) fn new((shortest, longest): (Duration, Duration), seed: u64) -> Self {
        Self { shortest, longest, next: shortest, seed }
    }

    /// Notes how long a link lasted. Only one that outlasts the next wait starts
    /// over with the shortest wait: a link that comes and goes is not reopened in
    /// a hurry.
    pub(crate) fn note_uptime(&mut self, up: Duration) {
        if up > self.next {
            self.restart();
        }
    }

    /// Starts over with the shortest wait.
    pub(crate) fn restart(&mut self) {
        self.next = self.shortest;
    }

    /// Returns the next wait: up to a tenth longer than half of the one after it.
    pub(crate) fn next(&mut self) -> Duration {
        // A step of a linear congruential generator; its upper bits are good.
        self.seed = self.seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        let jitter = 1.0 + 0.1 * (self.seed >> 40) as f64 / f64::from(1 << 24);
        let wait = self.next;
        self.next = (wait * 2).min(self.longest);
        wait.mul_f64(jitter)
    }
}
