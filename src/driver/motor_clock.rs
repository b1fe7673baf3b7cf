//! [`MotorClock`]: estimates when the motor's revolutions ended, from the arrivals of replies.
//!
//! On its own USB port a sensor begins its reply when a revolution ends. The host reads the first byte
//! later: by up to a USB frame of 1 ms, and by 30 ms if a busy host runs the driver late. The motor is
//! steadier: in a capture of a URG-04LX the first bytes are 0.36 ms (rms) from a line with 99.7605 ms a
//! revolution, where the firmware line promises 100 ms.
//!
//! - The clock fits a line to the arrivals by least squares. Early arrivals weigh more, so the line runs
//!   along the earliest ones.
//! - An arrival farther from the line than the gate is a misfit, and does not move the line. Late
//!   replies scatter, but misfits after a jump of the phase agree: [`JUMP`] of them move the line.
//! - The line is used while most of the recent replies fit. The stamp of one late reply rests on the
//!   line. Once two misfits agree, stamps rest on the arrivals until the line has moved.
//! - A sensor that answers at once follows the polls. So the line is used only after several replies
//!   have followed the motor: they waited for long, or moved within the time between two polls.

// With their paths, because a benchmark includes this file.
#[cfg(test)]
#[path = "motor_clock/model.rs"]
pub(super) mod model;
#[cfg(test)]
#[path = "motor_clock/tests.rs"]
mod tests;

use std::time::Duration;

use tokio::time::Instant;

use super::fit::{EARLY_WEIGHT, Line, Misfits};
use crate::stats::MotorStats;

/// Time constant of the fit in seconds.
const MEMORY: f64 = 6.0;
/// The gate in seconds, without the uncertainty of the line.
const GATE: f64 = 1.5e-3;
/// Standard deviation of the nominal period, and largest difference from it, as parts of it.
const NOMINAL_DEVIATION: f64 = 0.003;
const LARGEST_DIFFERENCE: f64 = 0.02;
/// The fit starts again after a pause of this many seconds.
const LONGEST_PAUSE: f64 = 10.0;
/// Number of agreeing misfits, less the others, that are a jump of the phase.
const JUMP: u32 = 5;
/// Part of the recent replies that fit: of a line in use, and at most without replies that follow the
/// motor. 13 replies in a row reach the first, 8 the second.
const USED: f64 = 0.55;
const UNPROVED: f64 = 0.4;
const RECENT: f64 = 16.0;
/// A reply follows the motor if it waited this many seconds, or moved after the poll by this many.
const LONG_WAIT: f64 = 0.02;
const MOVED: f64 = 0.004;
/// Most revolutions between two such replies: fewer replies may show a multiple of the period.
const MOST_TURNS: f64 = 2.0;

/// What a reply shows.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Revolution {
    /// Time from the end of the revolution on the line to the arrival of the reply.
    pub(crate) lateness: Option<Duration>,
    /// True if one of the clocks may have left the line, so that a stamp should not rest on it.
    pub(crate) is_doubted: bool,
    /// Duration of a revolution, while the line is used.
    pub(crate) period: Option<Duration>,
}

/// Line through the ends of revolutions. Its times are in seconds from `origin`.
#[derive(Debug, Clone)]
pub(crate) struct MotorClock {
    origin: Instant,
    /// Seconds per revolution, from the firmware line.
    nominal: f64,
    /// Ends of revolutions by their number.
    line: Line,
    /// Part of the recent replies that fit.
    fitting: f64,
    /// Time from the poll to the end of the revolution before a reply followed the motor.
    wait: f64,
    misfits: Misfits,
    jumps: u64,
}

impl MotorClock {
    /// Creates a clock of a motor whose revolution nominally takes this long.
    pub(crate) fn new(nominal: Duration) -> Self {
        let nominal = nominal.as_secs_f64();
        Self {
            origin: Instant::now(),
            nominal,
            // The first reply starts it, as after a pause.
            line: Line::new(f64::NEG_INFINITY, nominal, NOMINAL_DEVIATION * nominal),
            fitting: 0.0,
            wait: 0.0,
            misfits: Misfits::default(),
            jumps: 0,
        }
    }

    /// Adds a reply whose first byte arrived at `arrived`.
    pub(crate) fn observe(&mut self, requested: Instant, arrived: Instant) -> Revolution {
        let seconds = |at: Instant| at.saturating_duration_since(self.origin).as_secs_f64();
        let (requested, arrived) = (seconds(requested), seconds(arrived));
        let mut line = self.line;
        let since = arrived - line.value;
        // Rounds without a call of libm.
        let turns = ((since / line.slope + 0.5) as i64) as f64;
        line.advance(turns, since / MEMORY);
        let lag = arrived - line.value;
        let gate = GATE + 3.0 * line.deviation();
        if gate.is_nan() || gate > line.slope / 4.0 || since > LONGEST_PAUSE {
            return self.start(arrived);
        }
        if lag.abs() > gate {
            return self.judge_misfit(requested, arrived, lag, gate);
        }
        self.misfits = Misfits::default();
        // While the period is unknown, an early arrival says nothing about the edge.
        let weight = if lag < 0.0 && self.is_used() { EARLY_WEIGHT } else { 1.0 };
        line.add(lag, weight);
        if (line.slope - self.nominal).abs() > LARGEST_DIFFERENCE * self.nominal {
            return self.start(arrived);
        }
        self.line = line;
        self.count_fit(turns, line.value - requested);
        self.revolution(Some(arrived - line.value))
    }

    /// What is known about the motor, while the line is used.
    pub(crate) fn stats(&self) -> Option<MotorStats> {
        self.is_used().then(|| MotorStats {
            revolution: duration(self.line.slope),
            jumps: self.jumps,
            clock_drift_ppm: None,
        })
    }

    fn is_used(&self) -> bool {
        self.fitting >= USED
    }

    /// Counts a reply that fits. Its revolution ended `wait` seconds after the poll.
    fn count_fit(&mut self, turns: f64, wait: f64) {
        let is_unproved = self.fitting < UNPROVED;
        if is_unproved {
            self.wait = wait;
        }
        // A reply that is late by a whole revolution has not moved.
        let moved = (wait - self.wait) / self.line.slope;
        let has_moved = (moved - moved.round()).abs() * self.line.slope > MOVED;
        let follows_motor = (1.0..=MOST_TURNS).contains(&turns) && (wait > LONG_WAIT || has_moved);
        if is_unproved || self.is_used() || follows_motor {
            self.fitting += (1.0 - self.fitting) / RECENT;
        }
    }

    /// Judges a reply that does not fit: it is late unless the phase has changed.
    #[cold]
    fn judge_misfit(&mut self, requested: f64, arrived: f64, lag: f64, gate: f64) -> Revolution {
        let was_used = self.is_used();
        self.fitting -= self.fitting / RECENT;
        let period = self.line.slope;
        let late = if lag < 0.0 { lag + period } else { lag };
        self.misfits.count(late, gate);
        let (end, votes) = (arrived - late, self.misfits.votes);
        if votes == JUMP {
            self.jumps += u64::from(was_used);
            self.line.jump(end + self.misfits.late, JUMP);
            self.misfits = Misfits::default();
        }
        // The sensor answers when the first revolution after a poll ends.
        let is_late = lag > 0.0 && votes < 2 && (0.0..period).contains(&(end - requested));
        self.revolution(is_late.then_some(late))
    }

    /// Starts the fit again with one arrival and the nominal period.
    fn start(&mut self, arrived: f64) -> Revolution {
        self.line = Line::new(arrived, self.nominal, NOMINAL_DEVIATION * self.nominal);
        (self.fitting, self.misfits) = (0.0, Misfits::default());
        Revolution::default()
    }

    fn revolution(&self, lateness: Option<f64>) -> Revolution {
        let period = Some(duration(self.line.slope));
        let used = Revolution { lateness: lateness.map(duration), is_doubted: false, period };
        if self.is_used() { used } else { Revolution::default() }
    }
}

/// Duration of these seconds, or zero if they are negative.
pub(super) fn duration(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or_default()
}
