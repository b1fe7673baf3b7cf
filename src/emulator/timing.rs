//! [`DeviceTiming`]: when the sensor answers, by the motor that turns from
//! power-up on.

use std::time::Duration;

use tokio::time::Instant;

/// The time at which the sensor answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Pace {
    /// As soon as the command has arrived.
    AtOnce,
    /// One command a revolution: the reply begins when the next revolution
    /// begins, as on a real URG-04LX on USB. The motor's phase is fixed at
    /// power-up. Switching the laser on takes one revolution more.
    #[default]
    PerRevolution,
}

/// The times that a sensor needs.
#[derive(Debug, Clone)]
pub(super) struct DeviceTiming {
    pub(super) pace: Pace,
    pub(super) revolution: Duration,
    pub(super) latency: Duration,
    pub(super) boot: Duration,
    pub(super) stray_byte: bool,
    /// Bytes take no time on the line.
    pub(super) instant_line: bool,
}

impl DeviceTiming {
    /// Returns the time at which a command is served that could be from `free` on.
    pub(super) fn serve_at(&self, powered_at: Instant, free: Instant) -> Instant {
        let start = match self.pace {
            Pace::AtOnce => free,
            Pace::PerRevolution => self.revolution_after(powered_at, free),
        };
        start + self.latency
    }

    /// Returns the number of revolutions that were finished at `at`.
    pub(super) fn finished_revolutions(&self, powered_at: Instant, at: Instant) -> u64 {
        let since = at.saturating_duration_since(powered_at).as_nanos();
        let revolutions = since.checked_div(self.revolution.as_nanos()).unwrap_or(0);
        u64::try_from(revolutions).unwrap_or(u64::MAX)
    }

    /// Returns the start of the first revolution after `at`.
    pub(super) fn revolution_after(&self, powered_at: Instant, at: Instant) -> Instant {
        powered_at + self.duration_of(self.finished_revolutions(powered_at, at) + 1)
    }

    /// Returns the duration of so many revolutions.
    pub(super) fn duration_of(&self, revolutions: u64) -> Duration {
        let nanos = self.revolution.as_nanos() * u128::from(revolutions);
        Duration::from_nanos(u64::try_from(nanos).unwrap_or(u64::MAX))
    }
}
