//! [`Timing`]: how a sensor keeps time, by the motor that turns from power-up on.

use std::time::Duration;

use tokio::time::Instant;

/// When the sensor answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Pace {
    /// As soon as the command is in.
    AtOnce,
    /// One command a revolution: the reply begins when the next revolution
    /// begins, as on a real URG-04LX on USB. The motor's phase is fixed at
    /// power-up. Switching the laser on takes one revolution more.
    #[default]
    PerRevolution,
}

/// How a sensor keeps time.
#[derive(Debug, Clone)]
pub(super) struct Timing {
    pub(super) pace: Pace,
    pub(super) revolution: Duration,
    pub(super) latency: Duration,
    pub(super) boot: Duration,
    pub(super) stray_byte: bool,
    /// Whether bytes take no time on the line.
    pub(super) instant_line: bool,
}

impl Timing {
    /// When the sensor serves a command that could be served from `free` on.
    pub(super) fn serve_at(&self, powered_at: Instant, free: Instant) -> Instant {
        let start = match self.pace {
            Pace::AtOnce => free,
            Pace::PerRevolution => self.revolution_after(powered_at, free),
        };
        start + self.latency
    }

    /// How many revolutions have begun before `at`, the first one included.
    pub(super) fn revolutions_before(&self, powered_at: Instant, at: Instant) -> u64 {
        let since = at.saturating_duration_since(powered_at).as_nanos();
        let revolutions = since.checked_div(self.revolution.as_nanos()).unwrap_or(0);
        u64::try_from(revolutions).unwrap_or(u64::MAX)
    }

    /// When the next revolution begins after `at`.
    pub(super) fn revolution_after(&self, powered_at: Instant, at: Instant) -> Instant {
        powered_at + self.turns(self.revolutions_before(powered_at, at) + 1)
    }

    /// How long so many revolutions take.
    pub(super) fn turns(&self, revolutions: u64) -> Duration {
        let nanos = self.revolution.as_nanos() * u128::from(revolutions);
        Duration::from_nanos(u64::try_from(nanos).unwrap_or(u64::MAX))
    }
}
