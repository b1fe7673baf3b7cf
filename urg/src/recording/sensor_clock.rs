//! [`SensorClock`]: how fast a recorded sensor's clock runs, its jumps, and what scans it misses.

use std::time::Duration;

use serde_json::{Value, json};

use crate::format::{counted, pace};

/// The clock of SCIP 2 counts milliseconds, with 24 bits.
const WRAP: f64 = (1 << 24) as f64 / 1000.0;
/// Largest difference between the two clocks from one scan to the next: this many seconds, and this part
/// of the time between them. If there is more, the scan is late or the clock has jumped. (Even without
/// either, a poll may return a scan that is one revolution old.)
const TOLERANCE: f64 = 0.25;
const LARGEST_DRIFT: f64 = 0.01;
/// Number of scans in a row with the same difference that mean a jump.
const JUMP: u32 = 20;
/// Longest time in seconds between two scans that counts as lost scans. A longer one is a gap.
const LONGEST_LOSS: f64 = 1.0;
/// Seconds that a drift needs: each of its ends is known to about a millisecond.
const SHORTEST: f64 = 10.0;

/// What the scans read so far tell about the sensor's clock.
///
/// Nothing arrives before it is measured, so the clock runs along the earliest arrivals.
#[derive(Debug, Default)]
pub(super) struct SensorClock {
    /// Latest scan that fits.
    latest: Option<Reading>,
    /// How far off the latest scans are that do not fit, and how many of them agree.
    off: (f64, u32),
    /// Scans since the latest jump that arrived earliest: upper hull of points `(position, ahead)`.
    earliest: Vec<(f64, f64)>,
    longest: Drift,
    jumps: u64,
    /// Clock at the previous scan.
    previous: Option<f64>,
    /// Number of scans that the sensor has sent between two recorded ones.
    pub(super) lost: u64,
}

/// Reading of the sensor's clock, in seconds.
#[derive(Debug, Clone, Copy)]
struct Reading {
    clock: f64,
    /// Time since the first scan, on the computer's clock.
    position: f64,
    /// How far the sensor's clock has got ahead of the computer's.
    ahead: f64,
}

/// How fast the clock ran between two jumps.
#[derive(Debug, Clone, Copy, Default)]
struct Drift {
    seconds: f64,
    /// Seconds gained per second; negative if the clock is slow.
    rate: f64,
}

impl SensorClock {
    /// Adds a scan at `position` on a steady clock. If none is lost, scans are a `period` apart.
    pub(super) fn add(&mut self, clock: Duration, position: Duration, period: Option<Duration>) {
        let (clock, position) = (clock.as_secs_f64(), position.as_secs_f64());
        if let (Some(previous), Some(period)) = (self.previous.replace(clock), period) {
            let passed = (clock - previous).rem_euclid(WRAP);
            if passed < LONGEST_LOSS {
                let periods = (passed / period.as_secs_f64()).round();
                self.lost += (periods as u64).saturating_sub(1);
            }
        }
        let Some(latest) = self.latest else {
            return self.start(Reading { clock, position, ahead: 0.0 });
        };
        let elapsed = position - latest.position;
        // Whatever number of times it has wrapped.
        let gained = (clock - latest.clock - elapsed + WRAP / 2.0).rem_euclid(WRAP) - WRAP / 2.0;
        let reading = Reading { clock, position, ahead: latest.ahead + gained };
        if gained.abs() <= TOLERANCE + LARGEST_DRIFT * elapsed {
            self.off.1 = 0;
            return self.fit(reading);
        }
        self.off = match self.off {
            (off, count) if count > 0 && (gained - off).abs() <= TOLERANCE => (off, count + 1),
            _ => (gained, 1),
        };
        if self.off.1 == JUMP {
            self.jumps += 1;
            self.longest = self.drift();
            self.start(reading);
        }
    }

    fn start(&mut self, first: Reading) {
        (self.off, self.latest) = ((0.0, 0), Some(first));
        self.earliest = vec![(first.position, first.ahead)];
    }

    fn fit(&mut self, reading: Reading) {
        self.latest = Some(reading);
        let point = (reading.position, reading.ahead);
        // Others' log times may stand still, or run back.
        if self.earliest.last().is_some_and(|last| point.0 <= last.0) {
            return;
        }
        while let [.., first, second] = self.earliest[..]
            && slope(first, second) <= slope(first, point)
        {
            self.earliest.pop();
        }
        self.earliest.push(point);
    }

    /// Drift during the longest time without a jump.
    fn drift(&self) -> Drift {
        let (Some(first), Some(last)) = (self.earliest.first(), self.earliest.last()) else {
            return self.longest;
        };
        let seconds = last.0 - first.0;
        if seconds <= self.longest.seconds {
            return self.longest;
        }
        // The longest edge of the hull bounds the arrivals for the longest time.
        let edges = self.earliest.iter().zip(self.earliest.iter().skip(1));
        let longest = edges.max_by(|one, other| length(*one).total_cmp(&length(*other)));
        Drift { seconds, rate: longest.map_or(0.0, |(begin, end)| slope(*begin, *end)) }
    }

    /// Describes the clock as JSON and as text, if the sensor has one.
    pub(super) fn describe(&self) -> Option<(Value, String)> {
        self.latest?;
        let (drift, jumps) = (self.drift(), self.jumps);
        let ppm = (drift.seconds >= SHORTEST).then(|| (drift.rate * 1e6).round());
        let mut text = match ppm {
            Some(ppm) => pace(ppm),
            None => format!("its drift needs {SHORTEST:.0} s without a jump"),
        };
        if jumps > 0 {
            text += &format!("; it jumped {}: check the power", counted(jumps, "time"));
        }
        Some((json!({ "drift_ppm": ppm, "jumps": jumps }), text))
    }
}

fn length((from, to): (&(f64, f64), &(f64, f64))) -> f64 {
    to.0 - from.0
}

fn slope(from: (f64, f64), to: (f64, f64)) -> f64 {
    (to.1 - from.1) / (to.0 - from.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Description after scans at 40 Hz by a clock that gains `ppm`, each late by `late(number)` ms.
    fn described(ppm: f64, seconds: u32, late: impl Fn(u32) -> u32) -> String {
        let mut clock = SensorClock::default();
        for number in 0..40 * seconds {
            let measured = f64::from(number) * 0.025;
            let reading = (5.0 + measured) * (1.0 + ppm / 1e6);
            let reading = Duration::from_millis((reading * 1000.0) as u64 % (1 << 24));
            let position = measured + f64::from(late(number)) / 1000.0;
            clock.add(reading, Duration::from_secs_f64(position), None);
        }
        clock.describe().unwrap().1
    }

    #[test]
    fn the_drift_is_that_of_the_earliest_arrivals() {
        assert_eq!(described(1_200.0, 60, |_| 1), "0.12 % fast");
        assert_eq!(described(-1_200.0, 60, |_| 1), "0.12 % slow");
        // Busy from half of the time on, and stopped for 5 s.
        let busy = |number| if number < 1200 { 1 } else { 7 * (number % 5) };
        assert_eq!(described(-400.0, 60, busy), "0.04 % slow");
        let stopped = |number| 5_000_u32.saturating_sub(25 * (number % 1000));
        assert_eq!(described(500.0, 60, stopped), "0.05 % fast");
        assert_eq!(described(500.0, 9, |_| 1), "its drift needs 10 s without a jump");
        // Through a wrap.
        assert_eq!(described(500.0, 17_000, |_| 1), "0.05 % fast");
    }

    #[test]
    fn a_sensor_that_restarts_has_jumped() {
        for (before, off) in [(20, 15), (20, 1_000), (1_000, 20), (20, 17_000)] {
            let mut clock = SensorClock::default();
            for (from, seconds) in [(0, before), (before + off, 30)] {
                for number in 0..seconds * 40 {
                    let since = Duration::from_millis(25) * number;
                    clock.add(since * 1001 / 1000, Duration::from_secs(from.into()) + since, None);
                }
            }
            let text = clock.describe().unwrap().1;
            assert_eq!(text, "0.10 % fast; it jumped 1 time: check the power", "{before} {off}");
        }
    }

    #[test]
    fn scans_that_the_clock_shows_to_be_missing_are_counted() {
        let mut clock = SensorClock::default();
        let at = |number: u32| Duration::from_millis(25) * number;
        // Two are missing, one is twice there, and a pause is a gap.
        for number in [0, 1, 2, 5, 6, 6, 7, 100, 101] {
            clock.add(at(number), at(number), Some(at(1)));
        }
        assert_eq!(clock.lost, 2);
    }
}
