//! Sensors, lines, hosts and rates at random, against the motor that the clock cannot see: which
//! stamps it bases on the motor, and which periods it calls known. Sensor, motor, line and host are
//! code of their own and share nothing with the clock.
//!
//! `SCIP_MOTORS=20 cargo test --release --lib motor_clock::model -- --nocapture` draws 320 sensors
//! for each cell, prints each cell, and takes a minute; `SCIP_MOTORS_FIRST=1000000` draws others.

use std::ops::Range;

use super::*;

/// Sensors of a cell.
const SENSORS: u64 = 4;
/// Time that each sensor is polled, in seconds, and its largest number of polls.
const TIME: f64 = 7200.0;
const MOST_POLLS: usize = 6000;
/// Bytes of the detection window.
const BYTES: f64 = 1399.0;
const RATES: [f64; 7] = [0.5, 1.0, 2.0, 5.0, 7.3, 10.0, f64::INFINITY];
/// Largest error of a stamp beyond the constant delay, and of a known period.
const STAMP_BOUND: f64 = 5e-3;
const PERIOD_BOUND: f64 = 1e-3;

/// Numbers that only look random (xorshift).
pub(super) struct ModelRandom(pub(super) u64);

impl ModelRandom {
    pub(super) fn below_one(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * self.below_one()
    }

    fn once_in(&mut self, times: f64) -> bool {
        self.below_one() * times < 1.0
    }

    fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[(self.below_one() * from.len() as f64) as usize]
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Line {
    /// Frames of this many seconds.
    Usb(f64),
    /// Baud rate, and the latency timer of the adapter, which sends packets of 62 bytes.
    Serial(f64, f64),
    /// Delay each way, half as much again at random.
    Network(f64),
}

impl Line {
    fn all() -> Vec<Self> {
        let mut all: Vec<_> = [1e-3, 4e-3, 10e-3].map(Self::Usb).into();
        for baud in [19_200.0, 57_600.0, 115_200.0, 250_000.0, 500_000.0, 750_000.0] {
            all.extend([1e-3, 16e-3].map(|timer| Self::Serial(baud, timer)));
        }
        all.extend([1e-3, 3e-3, 10e-3, 30e-3].map(Self::Network));
        all
    }

    fn delay(self, random: &mut ModelRandom) -> f64 {
        match self {
            Self::Usb(_) => 1e-4 * random.below_one(),
            Self::Serial(baud, _) => 100.0 / baud + 1e-4 * random.below_one(),
            Self::Network(delay) => delay * random.between(1.0, 1.5),
        }
    }

    /// When the first byte of a reply that begins at `began` reaches the host, and the last one.
    fn deliver(self, began: f64, phase: f64, random: &mut ModelRandom) -> (f64, f64) {
        let tick = |at: f64, every: f64| ((at - phase) / every).ceil() * every + phase;
        match self {
            Self::Usb(frame) => (tick(began, frame), tick(began + 5.8e-3, frame)),
            Self::Serial(baud, timer) => {
                let byte = 10.0 / baud;
                let first = tick(began + byte, timer).min(began + 62.0 * byte);
                (first, tick(began + BYTES * byte, timer))
            }
            Self::Network(delay) => {
                let first = began + delay * random.between(1.0, 1.5);
                (first, first + 4e-3)
            }
        }
    }
}

/// Host that reads late in some spells: a part of the replies, by a mean lateness.
struct Host {
    late: f64,
    lateness: f64,
    /// Mean duration of a spell, and of the time between two.
    spells: (f64, f64),
    is_busy: bool,
    changes: f64,
}

impl Host {
    fn draw(random: &mut ModelRandom, honest: bool) -> Self {
        let late = if honest { 0.0 } else { random.pick(&[0.0, 0.0, 0.01, 0.2, 1.0]) };
        let lateness = random.pick(&[2e-3, 10e-3, 30e-3]);
        let spells = random.pick(&[(1e9, 0.0), (3.0, 27.0), (0.3, 3.0), (60.0, 60.0)]);
        Self { late, lateness, spells, is_busy: false, changes: 0.0 }
    }

    fn delay(&mut self, at: f64, random: &mut ModelRandom) -> f64 {
        let exponential =
            |mean: f64, random: &mut ModelRandom| -mean * (1.0 - random.below_one()).ln();
        if at > self.changes {
            self.is_busy = !self.is_busy;
            let mean = if self.is_busy { self.spells.0 } else { self.spells.1 };
            self.changes = at + exponential(mean, random);
        }
        let prompt = 1e-4 * random.below_one();
        match self.is_busy && random.below_one() < self.late {
            true => prompt + exponential(self.lateness, random),
            false => prompt,
        }
    }
}

/// Motor whose period drifts, and which jumps or stops once an hour.
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
}

impl Motor {
    fn draw(random: &mut ModelRandom, honest: bool) -> (Self, f64) {
        let period = match honest {
            true => 0.099_76,
            false => match random.once_in(2.0) {
                true => {
                    let usual = random.pick(&[0.066_6, 0.08, 0.099_76, 0.1, 0.11, 0.15]);
                    usual * random.between(0.998, 1.002)
                }
                false => random.between(0.066, 0.15),
            },
        };
        let hour = 3600.0;
        let drift = random.pick(&[0.0, 0.001, -0.001, 0.03, -0.03]) / hour;
        let drift = if honest { 0.0 } else { drift };
        let jumps = if !honest && random.once_in(3.0) { hour } else { f64::INFINITY };
        let stops = random.pick(&[0.0, 5.0]);
        let next_jump = 2.0 * jumps * random.below_one();
        // The firmware line is right to half a percent, or says 600 rpm whatever turns.
        let told = match honest || random.once_in(3.0) {
            true => 0.1,
            false => period * random.between(0.996, 1.004),
        };
        (Self { period, drift, jumps, stops, next_jump, end: random.below_one() }, told)
    }

    /// End of the first revolution after `at`.
    fn next_end(&mut self, at: f64, random: &mut ModelRandom) -> f64 {
        while self.end <= at {
            self.period *= 1.0 + self.drift * self.period;
            self.end += self.period;
            if self.end > self.next_jump {
                self.next_jump = self.end + 2.0 * self.jumps * random.below_one();
                self.end += self.period * random.below_one() + self.stops * random.below_one();
            }
        }
        self.end
    }
}

/// What a cell showed of all stamps.
#[derive(Debug, Default, Clone)]
struct Cell {
    stamps: usize,
    /// Errors of the stamps by motor beyond the delay that explains most of their session.
    motor: Vec<f64>,
    known: usize,
    wrong_periods: usize,
    worst_period: f64,
    jumps: u64,
}

impl Cell {
    fn wrong(&self) -> usize {
        self.motor.iter().filter(|error| error.abs() > STAMP_BOUND).count()
    }

    fn p99(&self) -> f64 {
        let mut errors: Vec<_> = self.motor.iter().map(|error| error.abs()).collect();
        errors.sort_by(f64::total_cmp);
        errors.get(errors.len() * 99 / 100).copied().unwrap_or_default()
    }

    fn add(&mut self, line: Line, at_once: bool, rate: f64, honest: bool, seed: u64) {
        let mut random = ModelRandom(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        let epoch = Instant::now();
        let at = |seconds: f64| epoch + Duration::from_secs_f64(seconds);
        let (mut motor, told) = Motor::draw(&mut random, honest);
        let mut clock = MotorClock::new(Duration::from_secs_f64(told));
        let mut host = Host::draw(&mut random, honest);
        let (phase, answer) = (random.between(-0.02, 0.0), random.between(1e-4, 15e-3));
        let (mut free, mut errors, mut polls, mut delay) = (1.0, Vec::new(), 0, 0.0);
        while free < TIME && polls < MOST_POLLS {
            polls += 1;
            if !honest && random.once_in(4000.0) {
                // The laser is off, or nothing is polled.
                free += 10_f64.powf(random.between(-1.0, 3.0));
            }
            let due = if rate.is_finite() { (free * rate).ceil() / rate } else { free };
            let turnaround = random.between(2e-5, 2e-4);
            let requested = due + delay + turnaround;
            let heard = requested + line.delay(&mut random);
            let end = motor.next_end(heard, &mut random);
            let (began, truth) = match at_once {
                true => (heard + answer, end - motor.period),
                false => (end, end),
            };
            if began > requested + 1.0 {
                free = requested + 1.0;
                continue;
            }
            let (first, last) = line.deliver(began, phase, &mut random);
            let first = first + host.delay(first, &mut random);
            let last = last.max(first);
            let revolution = clock.observe(at(requested), at(first));
            (free, delay) = (last, revolution.delay.as_secs_f64());
            self.stamps += 1;
            if let Some(lateness) = revolution.lateness {
                errors.push(first - lateness.as_secs_f64() - truth);
            }
            if let Some(period) = revolution.period {
                let error = (period.as_secs_f64() / motor.period - 1.0).abs();
                self.known += 1;
                self.wrong_periods += usize::from(error > PERIOD_BOUND);
                self.worst_period = self.worst_period.max(error);
            }
        }
        self.jumps += clock.jumps;
        errors.sort_by(f64::total_cmp);
        // The delay that explains most stamps.
        let within =
            |first: &f64| errors.partition_point(|error| *error <= first + 2.0 * STAMP_BOUND);
        let explained = |at: usize| within(&errors[at]) - at;
        if let Some(best) = (0..errors.len()).max_by_key(|at| explained(*at)) {
            let delay = (errors[best] + errors[best + explained(best) - 1]) / 2.0;
            self.motor.extend(errors.iter().map(|error| error - delay));
        }
    }
}

fn seeds() -> Range<u64> {
    let number = |name: &str| std::env::var(name).ok().map(|text| text.parse::<u64>().unwrap());
    let first = number("SCIP_MOTORS_FIRST").unwrap_or(1);
    first..first + number("SCIP_MOTORS").map_or(SENSORS, |times| 16 * times)
}

#[test]
fn stamps_and_periods_are_as_promised() {
    let mut failed = Vec::new();
    let (mut all, mut cells) = (Cell::default(), 0);
    for at_once in [false, true] {
        for line in Line::all() {
            for rate in RATES {
                let mut cell = Cell::default();
                for seed in seeds() {
                    cell.add(line, at_once, rate, false, seed);
                }
                let (wrong, motor) = (cell.wrong(), cell.motor.len());
                let told = format!(
                    "{line:?} at once {at_once} {rate} Hz: of {} stamps {motor} by motor, {wrong} \
                     wrong; of {} periods {} wrong, worst {:.5}; {} jumps",
                    cell.stamps, cell.known, cell.wrong_periods, cell.worst_period, cell.jumps
                );
                println!("{told}");
                if wrong * 1000 > motor || cell.wrong_periods * 1000 > cell.known {
                    failed.push(told);
                }
                cells += 1;
                all.stamps += cell.stamps;
                all.known += cell.known;
                all.wrong_periods += cell.wrong_periods;
                all.motor.append(&mut cell.motor);
            }
        }
    }
    println!(
        "{cells} cells, {} failed; of {} stamps {} by motor, {} wrong; of {} periods {} wrong",
        failed.len(),
        all.stamps,
        all.motor.len(),
        all.wrong(),
        all.known,
        all.wrong_periods
    );
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn a_usual_sensor_has_stamps_by_motor() {
    for rate in [0.25, 1.0, 2.0, 5.0, 10.0, f64::INFINITY] {
        let mut cell = Cell::default();
        for seed in seeds() {
            cell.add(Line::Usb(1e-3), false, rate, true, seed);
        }
        let part = |count: usize| count as f64 / cell.stamps as f64;
        let (motor, known, p99) = (part(cell.motor.len()), part(cell.known), cell.p99());
        println!(
            "{rate} Hz: {motor:.4} by motor, p99 {:.3} ms, periods known {known:.4}, worst {:.6}",
            p99 * 1e3,
            cell.worst_period
        );
        // At less than a reply in three seconds there is no line.
        let least = if rate < 0.3 { 0.0 } else { 0.95 * (1.0 - 150.0 / (rate * TIME).min(6000.0)) };
        assert!(motor >= least && p99 < 0.5e-3, "{rate} Hz: {motor}, {p99}");
        assert!(cell.worst_period < 1e-4 && known > least - 0.3, "{rate} Hz: {known}");
        assert!(rate > 0.3 || motor == 0.0, "{rate} Hz: {motor}");
    }
}
