//! [`Probe`]: when an idle link is due for a sign of life. Bytes from the sensor count; requests
//! do not, because some are answered without it.

use std::time::Duration;

use tokio::time::Instant;

/// Measures how long a link has been silent.
#[derive(Debug)]
pub(crate) struct Probe {
    /// Silence after which to send a fence, or `None` for no probes.
    interval: Option<Duration>,
    since: Instant,
    /// Total number of received bytes at that time.
    received: u64,
}

impl Probe {
    pub(crate) fn new(interval: Option<Duration>) -> Self {
        Self { interval, since: Instant::now(), received: 0 }
    }

    /// Time of the next probe unless bytes arrive. `received` is the total number of received
    /// bytes.
    pub(crate) fn due(&mut self, received: u64) -> Option<Instant> {
        let interval = self.interval?;
        if received != self.received {
            *self = Self { received, ..Self::new(self.interval) };
        }
        Some(self.since + interval)
    }
}
