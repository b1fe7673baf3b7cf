//! [`DeviceTiming`]: when the sensor answers, and when its bytes leave it.

use std::time::Duration;

use tokio::time::Instant;

use super::motor::Motor;

/// Longest time of a setting or a fault. Sums of them stay far below what an `Instant` can hold.
pub(super) const LONGEST: Duration = Duration::from_secs(365 * 24 * 60 * 60);

/// When the sensor answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Pace {
    /// As soon as the command has arrived.
    AtOnce,
    /// One command per revolution: the reply begins when the next revolution begins, as
    /// on a real URG-04LX on USB. The motor's phase is fixed at power-up. The first scan
    /// after the laser was switched on takes one revolution more.
    #[default]
    PerRevolution,
}

/// Times that a sensor needs.
#[derive(Debug, Clone, Default)]
pub(super) struct DeviceTiming {
    pub(super) pace: Pace,
    pub(super) latency: Duration,
    pub(super) boot: Duration,
    /// Replies begin at whole multiples of this time, as in USB's frames; zero for none.
    pub(super) frame: Duration,
    /// True if no byte 0x00 follows a change of the baud rate.
    pub(super) omits_stray_byte: bool,
    /// Time per byte, or `None` for a serial line or USB.
    pub(super) byte_time: Option<Duration>,
}

impl DeviceTiming {
    /// When a command is served that could be served from `free` on.
    pub(super) fn serve_at(&self, motor: &Motor, free: Instant) -> Instant {
        let start = match self.pace {
            Pace::AtOnce => free,
            Pace::PerRevolution => motor.next_end(free),
        };
        start + self.latency
    }

    /// Start of the first frame at or after `at`, with frames counted from `first`.
    pub(super) fn frame_at(&self, first: Instant, at: Instant) -> Instant {
        let since = at.saturating_duration_since(first).as_nanos();
        let into = since.checked_rem(self.frame.as_nanos()).unwrap_or(0);
        if into == 0 { at } else { at + self.frame - Duration::from_nanos(into as u64) }
    }
}
