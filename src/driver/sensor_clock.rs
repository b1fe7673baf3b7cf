//! [`SensorClock`]: estimates when revolutions ended, from the sensor's clock and its scans' arrivals.
//!
//! A sensor of SCIP 2 stamps each scan with its own clock, in whole milliseconds, and sends it when the
//! revolution ends. The clock runs up to 0.2 % fast or slow. The host reads the first byte later: by up
//! to a frame of 1 ms, and by 30 ms if a busy host runs the driver late.
//!
//! - One line turns the sensor's clock into the host's: it runs along the earliest arrivals. An arrival
//!   that is later than the gate is left out; nothing arrives early, so one that is earlier than the
//!   gate, or several that are late by the same time, mean that the clock has jumped.
//! - The host's clock may be steered: to correct it, chrony lets it run up to a twelfth fast or slow, and
//!   the monotonic clock with it. So two late arrivals in a row put the line in doubt, unless they come
//!   at once after each other, as after a pause of the host.
//! - A second line smooths whole milliseconds: the motor is steadier than that. A scan that is a
//!   millisecond off begins the line anew.
//!
//! No scan is held back or dropped, and nothing is asked of the sensor.

// With its path, because a benchmark includes this file.
#[cfg(test)]
#[path = "sensor_clock/model.rs"]
mod model;

use std::time::Duration;

use tokio::time::Instant;

use super::fit::{EARLY_WEIGHT, Line, Misfits};
use super::motor_clock::{Revolution, duration};
use crate::stats::MotorStats;

/// Number of scans that each fit remembers, and the longest time in seconds that it remembers the
/// motor: its speed drifts.
const MEMORY: f64 = 1000.0;
const MOTOR_MEMORY: f64 = 100.0;
const LONGEST_MOTOR_MEMORY: f64 = 20.0;
/// Standard deviation of a clock's rate and of a motor's period, as parts of them.
const RATE_DEVIATION: f64 = 0.002;
const PERIOD_DEVIATION: f64 = 0.003;
/// The same of the period that a sensor tells: a UBG-04LX-F01 tells 25 ms, and takes 28.
const TOLD_PERIOD_DEVIATION: f64 = 0.05;
/// How far an arrival may be from the line of the clock, and a revolution from the line of the motor,
/// without the uncertainty of the line.
const GATE: f64 = 2.0e-3;
const MOTOR_GATE: f64 = 1.2e-3;
/// Standard deviation in seconds above which the line starts again: after a pause, if the clock's rate
/// was not known well.
const LARGEST_DEVIATION: f64 = 0.2e-3;
/// Number of agreeing late arrivals, less the others, that mean a jump of a clock that left the motor's line.
const JUMP: u32 = 5;
/// After this many late arrivals in a row, stamps rest on the arrivals until one fits again.
const DOUBTED: u32 = 2;
/// After this many, the lines start again. It takes more, because the host may only be busy.
const LOST: u32 = 50;
/// Number of arrivals that fit, less the late ones, until the lines are used.
const FIRST: u32 = 20;

/// What is known while a stream runs. Times are in seconds from `origin`.
#[derive(Debug, Clone)]
pub(crate) struct SensorClock {
    origin: Instant,
    /// When the stream of the latest scan began.
    begun: Instant,
    /// Seconds of a revolution, as the sensor tells.
    nominal: f64,
    lines: Option<Lines>,
    jumps: u64,
}

#[derive(Debug, Clone, Copy)]
struct Lines {
    /// Clock of the latest scan in seconds.
    clock: f64,
    /// Seconds since the first scan.
    age: f64,
    /// Arrivals by the sensor's clock.
    arrivals: Line,
    /// Ends of revolutions by their number.
    motor: Line,
    /// Number of arrivals that have fitted, less the late ones before the lines were used.
    count: u32,
    /// True if a revolution has left the motor's line, and no arrival fitted since: the clock may have jumped.
    has_moved: bool,
    misfits: Misfits,
    /// Number of misfits since an arrival has fitted, without those that came at once after another.
    misfits_in_row: u32,
    /// How late the latest arrival was.
    late: f64,
}

impl SensorClock {
    /// Creates the clock of a sensor whose revolution nominally takes this long.
    pub(crate) fn new(nominal: Duration) -> Self {
        let nominal = nominal.as_secs_f64();
        Self { origin: Instant::now(), begun: Instant::now(), nominal, lines: None, jumps: 0 }
    }

    /// Adds a scan of a stream that began at `begun` and has one in `turns` revolutions, with the sensor's
    /// clock and the arrival of its first byte. Returns when its revolution ended.
    pub(crate) fn observe(
        &mut self,
        clock: Duration,
        wrap: Duration,
        arrived: Instant,
        begun: Instant,
        turns: u32,
    ) -> Revolution {
        // A motor at another speed than told turns four times in what seem five revolutions. Before the
        // first scan of a stream there may be any number of them.
        let is_first = std::mem::replace(&mut self.begun, begun) < begun;
        let step = if is_first { 1.0 } else { f64::from(turns) };
        let longest = arrived.saturating_duration_since(begun).as_secs_f64();
        let arrived = arrived.saturating_duration_since(self.origin).as_secs_f64();
        let (clock, wrap) = (clock.as_secs_f64(), wrap.as_secs_f64());
        let Some(mut lines) = self.lines else { return self.start(clock, arrived) };
        let passed = (clock - lines.clock).rem_euclid(wrap);
        lines.arrivals.advance(passed, 1.0 / MEMORY);
        let late = arrived - lines.arrivals.value;
        let deviation = lines.arrivals.deviation();
        let gate = GATE + 3.0 * deviation;
        // Whole milliseconds are wrong by the same for many scans, so a line leads no further ahead than
        // it is long, whatever its deviation.
        let is_unknown = deviation > LARGEST_DEVIATION || passed > lines.age;
        // Nothing was sent before its stream began: the sensor has restarted meanwhile.
        let is_lost = lines.is_used() && is_unknown || late > longest + gate;
        lines.age += passed;
        let is_at_once = late < lines.late - passed / 2.0;
        let had_moved = lines.has_moved;
        (lines.clock, lines.late) = (clock, late);
        // Not a number if rounding has made a determinant negative.
        if gate.is_nan() || late < -gate || is_lost {
            // How far the clock has drifted in a pause, and how often it has begun anew, is not known.
            let drift = GATE + 3.0 * RATE_DEVIATION * (passed + late);
            let off = late - wrap * (late / wrap).round();
            let is_jump = !is_first || !(-drift..=longest + drift).contains(&off);
            self.jumps += u64::from(lines.is_used() && is_jump);
            return self.start(clock, arrived);
        }
        if late <= gate {
            (lines.misfits, lines.misfits_in_row, lines.has_moved) = (Misfits::default(), 0, false);
            let weight = if late < 0.0 && lines.is_used() { EARLY_WEIGHT } else { 1.0 };
            lines.arrivals.add(late, weight);
            lines.count += 1;
        } else if !is_at_once {
            lines.misfits_in_row += 1;
        }
        // By the first line.
        let end = lines.arrivals.value;
        let unit = step * lines.motor.slope;
        let turned = ((end - lines.motor.value) / unit).round() * step;
        let forgotten = (1.0 / MOTOR_MEMORY).max(passed / LONGEST_MOTOR_MEMORY);
        lines.motor.advance(turned, forgotten);
        let off = end - lines.motor.value;
        let motor_gate = MOTOR_GATE + 3.0 * lines.motor.deviation();
        // Within a wider gate, another number of revolutions would fit as well.
        if off.abs() <= motor_gate && motor_gate <= unit / 2.0 {
            lines.motor.add(off, 1.0);
        } else {
            let slope = if had_moved { self.nominal } else { lines.motor.slope };
            let deviation = if had_moved { TOLD_PERIOD_DEVIATION } else { PERIOD_DEVIATION };
            lines.motor = Line::new(end, slope, deviation * slope);
            lines.has_moved = true;
        }
        if late > gate {
            lines.count = lines.count.saturating_sub((!lines.is_used()).into());
            if lines.is_jump(late, gate) {
                self.jumps += u64::from(lines.is_used());
                return self.start(clock, arrived);
            }
        }
        let revolution = lines.revolution(arrived);
        self.lines = Some(lines);
        revolution
    }

    /// What is known about the motor, while the lines are used.
    pub(crate) fn stats(&self) -> Option<MotorStats> {
        let lines = self.lines.filter(Lines::is_used)?;
        // Arrivals by the sensor's clock: the slope is the inverse of the clock's rate.
        let drift = (1.0 / lines.arrivals.slope - 1.0) * 1e6;
        Some(MotorStats {
            revolution: duration(lines.motor.slope),
            jumps: self.jumps,
            clock_drift_ppm: Some(drift.round() as i32),
        })
    }

    fn start(&mut self, clock: f64, arrived: f64) -> Revolution {
        self.lines = Some(Lines {
            clock,
            age: 0.0,
            arrivals: Line::new(arrived, 1.0, RATE_DEVIATION),
            motor: Line::new(arrived, self.nominal, TOLD_PERIOD_DEVIATION * self.nominal),
            count: 0,
            has_moved: false,
            misfits: Misfits::default(),
            misfits_in_row: 0,
            late: 0.0,
        });
        Revolution::default()
    }
}

impl Lines {
    fn is_used(&self) -> bool {
        self.count >= FIRST
    }

    /// Judges an arrival later than the gate: the host is busy unless several agree, or none fits.
    fn is_jump(&mut self, late: f64, gate: f64) -> bool {
        self.misfits.count(late, gate);
        self.has_moved && self.misfits.votes >= JUMP || self.misfits_in_row >= LOST
    }

    fn revolution(&self, arrived: f64) -> Revolution {
        if !self.is_used() {
            return Revolution::default();
        }
        let [lateness, period] = [arrived - self.motor.value, self.motor.slope]
            .map(|seconds| (!self.has_moved).then(|| duration(seconds)));
        Revolution { lateness, is_doubted: self.misfits_in_row >= DOUBTED, period }
    }
}
