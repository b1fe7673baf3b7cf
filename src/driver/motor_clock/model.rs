//! Sensors on USB, hosts and rates at random, against the motor that the clock cannot see: how far
//! stamps that rest on the motor are off, and how soon there are some. None shares code with the clock.
//!
//! `SCIP_MOTORS=20 cargo test --release --lib motor_clock::model -- --nocapture` draws 320 sensors for
//! each cell, prints each cell, and takes a minute or two; `SCIP_MOTORS_FIRST=1000001` draws others.

use std::ops::Range;

use fastrand::Rng;

use super::*;

/// Time that each sensor is polled, in seconds, and its largest number of polls.
const TIME: f64 = 7200.0;
const MOST_POLLS: usize = 6000;
const RATES: [f64; 4] = [1.0, 5.0, 10.0, f64::INFINITY];
/// Interval of USB's frames in seconds.
const FRAME: f64 = 1e-3;
/// Largest error of a stamp beyond the constant delay, in seconds, and of a period, as a part of it.
const STAMP_BOUND: f64 = 2e-3;
const PERIOD_BOUND: f64 = 1e-3;

pub(in super::super) struct ModelRandom(pub(in super::super) Rng);

impl ModelRandom {
    pub(in super::super) fn below_one(&mut self) -> f64 {
        self.0.f64()
    }

    pub(in super::super) fn between(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * self.below_one()
    }

    pub(in super::super) fn once_in(&mut self, times: f64) -> bool {
        self.below_one() * times < 1.0
    }

    pub(in super::super) fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[(self.below_one() * from.len() as f64) as usize]
    }

    fn exponential(&mut self, mean: f64) -> f64 {
        -mean * (1.0 - self.below_one()).ln()
    }
}

/// Host that reads late in some spells: a part of the replies, by a mean lateness.
pub(in super::super) struct Host {
    late: f64,
    lateness: f64,
    /// Mean duration of a spell, and of the time between two.
    spells: (f64, f64),
    is_busy: bool,
    changes: f64,
}

impl Host {
    pub(in super::super) fn draw(random: &mut ModelRandom, is_busy: bool) -> Self {
        let late = if is_busy { random.pick(&[0.01, 0.2, 1.0]) } else { 0.0 };
        let lateness = random.pick(&[2e-3, 10e-3, 30e-3]);
        let spells = random.pick(&[(1e9, 0.0), (3.0, 27.0), (0.3, 3.0), (60.0, 60.0)]);
        Self { late, lateness, spells, is_busy: false, changes: 0.0 }
    }

    pub(in super::super) fn delay(&mut self, at: f64, random: &mut ModelRandom) -> f64 {
        if at > self.changes {
            self.is_busy = !self.is_busy;
            let mean = if self.is_busy { self.spells.0 } else { self.spells.1 };
            self.changes = at + random.exponential(mean);
        }
        let prompt = 1e-4 * random.below_one();
        match self.is_busy && random.below_one() < self.late {
            true => prompt + random.exponential(self.lateness),
            false => prompt,
        }
    }
}

/// Time in seconds that the host's clock gains while it is steered to the time of others.
#[derive(Debug, Clone, Copy, Default)]
pub(in super::super) struct Slew {
    before: f64,
    begin: f64,
    pub(in super::super) end: f64,
    rate: f64,
}

impl Slew {
    /// Corrects an offset as `adjtime` (500 ppm) and chrony (up to a twelfth) do.
    pub(in super::super) fn draw(self, begin: f64, random: &mut ModelRandom) -> Self {
        let some = 10_f64.powf(random.between(-3.0, -1.1));
        let rate = random.pick(&[5e-4, some, 1.0 / 12.0]) * random.pick(&[1.0, -1.0]);
        let offset = 10_f64.powf(random.between(-2.0, 0.0));
        Self { before: self.gained(begin), begin, end: begin + offset / rate.abs(), rate }
    }

    pub(in super::super) fn gained(&self, at: f64) -> f64 {
        self.before + self.rate * (at.clamp(self.begin, self.end) - self.begin)
    }
}

/// Motor whose period drifts, and whose phase may jump once an hour.
struct Motor {
    period: f64,
    /// Growth of the period in a second.
    drift: f64,
    /// Mean time between two jumps.
    jumps: f64,
    /// Longest standstill at a jump.
    stops: f64,
    next_jump: f64,
    end: f64,
    has_jumped: bool,
}

impl Motor {
    /// Draws a motor, and the period that the firmware line promises.
    fn draw(random: &mut ModelRandom, is_odd: bool) -> (Self, f64) {
        const HOUR: f64 = 3600.0;
        let jumps = random.pick(&[f64::INFINITY, HOUR]);
        let usual = Self {
            period: 0.1 * random.between(0.996, 1.004),
            drift: random.pick(&[0.0, 0.001, -0.001]) / HOUR,
            jumps,
            stops: 0.0,
            next_jump: jumps * random.below_one(),
            end: random.below_one(),
            has_jumped: true,
        };
        if !is_odd {
            return (usual, 0.1);
        }
        // The firmware line is right to a percent, or there is none.
        let (period, told) = match random.once_in(3.0) {
            true => (random.between(0.08, 0.125), 0.1),
            false => {
                let period = random.between(0.066, 0.15);
                (period, period * random.between(0.99, 1.01))
            }
        };
        let drift = random.pick(&[0.01, -0.01, 0.03, -0.03]) / HOUR;
        (Self { period, drift, stops: random.pick(&[0.0, 5.0]), ..usual }, told)
    }

    /// End of the first revolution after `at`.
    fn next_end(&mut self, at: f64, random: &mut ModelRandom) -> f64 {
        while self.end <= at {
            self.period *= 1.0 + self.drift * self.period;
            self.end += self.period;
            if self.end > self.next_jump {
                self.next_jump = self.end + 2.0 * self.jumps * random.below_one();
                self.end += self.period * random.below_one() + self.stops * random.below_one();
                self.has_jumped = true;
            }
        }
        self.end
    }
}

/// Kind of a sensor and its host.
#[derive(Debug, Clone, Copy)]
struct Kind {
    /// It answers at once, and not when its motor ends a revolution.
    at_once: bool,
    is_odd: bool,
    is_busy: bool,
    is_slewed: bool,
    rate: f64,
}

/// What a cell showed of all stamps.
#[derive(Debug, Default)]
struct Cell {
    stamps: usize,
    /// Stamps that rest on the motor, and how many are farther off than the delay that explains most.
    motor: usize,
    wrong: usize,
    wrong_periods: usize,
    /// Seconds from a start or a jump to the first stamp by motor.
    waits: Vec<f64>,
}

impl Cell {
    fn add(&mut self, kind: Kind, seed: u64) {
        let mut random = ModelRandom(Rng::with_seed(seed));
        let epoch = Instant::now();
        let (mut motor, told) = Motor::draw(&mut random, kind.is_odd);
        let mut clock = MotorClock::new(Duration::from_secs_f64(told));
        let (mut host, mut slew) = (Host::draw(&mut random, kind.is_busy), Slew::default());
        let (phase, answer) = (FRAME * random.below_one(), random.between(1e-4, 10e-3));
        let next_frame = |at: f64| ((at - phase) / FRAME).ceil() * FRAME + phase;
        let (mut free, mut errors, mut polls, mut begun) = (1.0, Vec::new(), 0, None);
        while free < TIME && polls < MOST_POLLS {
            polls += 1;
            if kind.is_odd && random.once_in(4000.0) {
                // The laser is off, or nothing is polled.
                free += 10_f64.powf(random.between(-1.0, 3.0));
            }
            if kind.is_slewed && free > slew.end && random.once_in(1000.0) {
                slew = slew.draw(free, &mut random);
            }
            let grid = kind.rate;
            let due = if grid.is_finite() { (free * grid).ceil() / grid } else { free };
            let requested = due + random.between(2e-5, 2e-4);
            let heard = requested + 1e-4 * random.below_one();
            let end = motor.next_end(heard, &mut random);
            if std::mem::take(&mut motor.has_jumped) {
                begun = Some(end);
            }
            let (began, truth) = match kind.at_once {
                true => (heard + answer, end - motor.period),
                false => (end, end),
            };
            if began > requested + 1.0 {
                free = requested + 1.0;
                continue;
            }
            let first = next_frame(began);
            let first = first + host.delay(first, &mut random);
            free = next_frame(began + 5.8e-3).max(first);
            let by_host = |at: f64| at + slew.gained(at);
            let at = |seconds: f64| epoch + Duration::from_secs_f64(by_host(seconds));
            let revolution = clock.observe(at(requested), at(first));
            self.stamps += 1;
            if let Some(lateness) = revolution.lateness {
                errors.push(by_host(first) - lateness.as_secs_f64() - by_host(truth));
                self.waits.extend(begun.take().map(|begun| first - begun));
            }
            if let Some(period) = revolution.period {
                let error = (period.as_secs_f64() / motor.period - 1.0).abs();
                self.wrong_periods += usize::from(error > PERIOD_BOUND);
            }
        }
        errors.sort_by(f64::total_cmp);
        // The delay that explains most stamps.
        let within = |least: f64| errors.partition_point(|it| *it <= least + 2.0 * STAMP_BOUND);
        let right = (0..errors.len()).map(|at| within(errors[at]) - at).max();
        self.motor += errors.len();
        self.wrong += errors.len() - right.unwrap_or_default();
    }
}

/// Seeds of the sensors of a cell: 16 times as many as the variable says, or the usual number.
pub(in super::super) fn seeds(variable: &str, usual: u64) -> Range<u64> {
    let number = |name: &str| std::env::var(name).ok().map(|text| text.parse::<u64>().unwrap());
    let first = number(&format!("{variable}_FIRST")).unwrap_or(1);
    first..first + number(variable).map_or(usual, |times| 16 * times)
}

fn draw(kind: Kind) -> Cell {
    let mut cell = Cell::default();
    seeds("SCIP_MOTORS", 8).for_each(|seed| cell.add(kind, seed));
    let Cell { stamps, motor, wrong, wrong_periods, .. } = cell;
    println!(
        "{kind:?}: {motor} of {stamps} stamps by motor, {wrong} wrong, {wrong_periods} periods"
    );
    // A steered clock takes the periods with it.
    match kind.is_slewed {
        true => assert!(wrong * 500 <= motor),
        false => assert!(wrong * 1000 <= motor && wrong_periods * 1000 <= motor),
    }
    cell
}

#[test]
fn few_stamps_by_motor_are_wrong() {
    for rate in RATES {
        for (is_odd, is_busy) in [(false, false), (false, true), (true, false), (true, true)] {
            let kind = Kind { at_once: false, is_odd, is_busy, is_slewed: false, rate };
            let cell = draw(kind);
            // Fewer replies than one in two revolutions do not show which line is the motor's.
            assert_eq!(cell.motor > 0, rate > 4.0);
            if !is_odd && !is_busy && rate > 4.0 {
                assert!(cell.motor as f64 > 0.98 * cell.stamps as f64);
                let within_3s = cell.waits.iter().filter(|wait| **wait < 3.0).count();
                println!("{within_3s} of {} within 3 s", cell.waits.len());
                let least = if rate > 10.0 { 1.0 } else { 0.75 };
                assert!(within_3s as f64 >= least * cell.waits.len() as f64, "{:?}", cell.waits);
            }
            assert_eq!(draw(Kind { at_once: true, ..kind }).motor, 0);
            draw(Kind { is_slewed: true, ..kind });
            assert_eq!(draw(Kind { at_once: true, is_slewed: true, ..kind }).motor, 0);
        }
    }
}
