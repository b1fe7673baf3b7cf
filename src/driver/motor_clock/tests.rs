//! Tests the clock against simulated motors, whose truth is known, and against the times
//! of a real one.

use super::*;

const NOMINAL: Duration = Duration::from_millis(100);
/// Reply times of a URG-04LX on USB, in seconds: request, first and last byte.
const REPLY_TIMES: &str = include_str!("reply_times.csv");

/// Clock of a sensor that has shown that it follows its motor and not its requests.
fn proved() -> MotorClock {
    MotorClock { is_proved: true, doubt: 0.0, ..MotorClock::new(NOMINAL) }
}

/// Numbers that only look random (SplitMix64).
struct Draw(u64);

impl Draw {
    /// Next number, from 0 to 1.
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) as f64 / u64::MAX as f64
    }

    fn exponential(&mut self, mean: f64) -> f64 {
        -mean * (1.0 - self.next()).max(1e-9).ln()
    }
}

/// Number of replies until the clock rests on the motor, in most cases.
const SETTLING: usize = 400;

/// Sensor, line and host, with all times in seconds.
#[derive(Debug, Clone, Copy)]
struct Setup {
    period: f64,
    /// Growth of the period in an hour: 0.001 is 0.1 %.
    drift: f64,
    /// Mean time between two jumps of the phase, drawn from 0 to twice this.
    jumps_every: f64,
    /// USB's frames, or zero.
    frame: f64,
    /// Fraction of late arrivals, and the longest delay.
    late: (f64, f64),
    /// Busy host: mean lateness of the replies in a spell, which follows an exponential law;
    /// mean duration of a spell, and of the time between two.
    busy: (f64, f64, f64),
    /// Time between two requests; zero to request as soon as a reply is complete.
    interval: f64,
    /// Time from the first to the last byte.
    transfer: f64,
    answers_at_once: bool,
    seconds: f64,
    seed: u64,
}

/// Motor of the capture, requested as soon as each reply was complete.
const USB: Setup = Setup {
    period: 0.099_760_5,
    drift: 0.0,
    jumps_every: f64::INFINITY,
    frame: 1e-3,
    late: (0.0, 0.0),
    busy: (0.0, 0.0, 0.0),
    interval: 0.0,
    transfer: 5.8e-3,
    answers_at_once: false,
    seconds: 600.0,
    seed: 1,
};

/// Reply, and what the clock made of it.
#[derive(Debug, Clone, Copy)]
struct Seen {
    /// Errors in milliseconds: of the clock, and of the arrival.
    error: f64,
    arrival_error: f64,
    /// Difference to the true period, as a fraction of it.
    period_error: Option<f64>,
    is_measured: bool,
    /// Replies since the latest jump.
    since_jump: usize,
}

impl Setup {
    fn run(self) -> Vec<Seen> {
        let epoch = Instant::now();
        let at = |seconds: f64| epoch + Duration::from_secs_f64(seconds);
        let (mut draw, mut clock) = (Draw(self.seed), MotorClock::new(NOMINAL));
        let (mut period, mut end, mut free) = (self.period, 0.037, 0.0_f64);
        let mut next_jump = 2.0 * self.jumps_every * draw.next();
        let (mut seen, mut since_jump) = (Vec::new(), 0);
        let (mut is_busy, mut spell_ends) = (true, 0.0);
        while free < self.seconds {
            let planned = match self.interval {
                0.0 => free + 1e-4,
                interval => (free / interval).ceil() * interval,
            };
            let requested = planned + clock.poll_delay(at(planned)).as_secs_f64();
            while end < requested + 5e-4 {
                period *= 1.0 + self.drift / 3600.0 * period;
                end += period;
                if end > next_jump {
                    next_jump = end + 2.0 * self.jumps_every * draw.next();
                    end += period * draw.next();
                    since_jump = 0;
                }
            }
            let truth = if self.answers_at_once { requested + 1e-3 } else { end };
            let mut arrived = truth + 1e-4 * draw.next();
            if self.frame > 0.0 {
                arrived = (arrived / self.frame).ceil() * self.frame;
            }
            if draw.next() < self.late.0 {
                arrived += self.late.1 * draw.next();
            }
            let (lateness, spell, between) = self.busy;
            if spell > 0.0 && arrived > spell_ends {
                is_busy = !is_busy;
                spell_ends = arrived + draw.exponential(if is_busy { spell } else { between });
            }
            if is_busy {
                arrived += draw.exponential(lateness);
            }
            let revolution = clock.observe(at(requested), at(arrived));
            let estimate = arrived - revolution.lateness.unwrap_or_default().as_secs_f64();
            let period_error = |found: Duration| (found.as_secs_f64() / period - 1.0).abs();
            since_jump += 1;
            seen.push(Seen {
                error: (estimate - truth).abs() * 1e3,
                arrival_error: (arrived - truth) * 1e3,
                period_error: revolution.period.map(period_error),
                is_measured: revolution.lateness.is_some(),
                since_jump,
            });
            free = arrived + self.transfer;
        }
        seen
    }

    /// 99th percentiles of the errors in milliseconds: of the clock, and of the arrivals.
    fn p99(self) -> (f64, f64) {
        p99(&self.run()[SETTLING..])
    }
}

fn p99(seen: &[Seen]) -> (f64, f64) {
    let p99 = |errors: fn(&Seen) -> f64| {
        let mut errors: Vec<_> = seen.iter().map(errors).collect();
        errors.sort_by(f64::total_cmp);
        errors[errors.len() * 99 / 100]
    };
    (p99(|seen| seen.error), p99(|seen| seen.arrival_error))
}

#[test]
fn the_replies_of_a_real_sensor_lie_on_one_line() {
    let epoch = Instant::now();
    let mut clock = proved();
    let mut ends = Vec::new();
    for line in REPLY_TIMES.lines().skip(1) {
        let mut times = line.split(',').map(|time| time.parse().unwrap());
        let mut next = || epoch + Duration::from_secs_f64(times.next().unwrap());
        let (requested, arrived) = (next(), next());
        let revolution = clock.observe(requested, arrived);
        if let Some(lateness) = revolution.lateness {
            let since = |at: Instant| (at - epoch).as_secs_f64();
            ends.push((since(arrived - lateness), since(arrived)));
        }
    }
    assert_eq!(ends.len(), 62 - 8);
    let found = clock.period;
    assert!((found - 0.099_760_5).abs() < 5e-6, "{found}");
    let (ends, arrivals): (Vec<_>, Vec<_>) = ends.into_iter().unzip();
    let (clock, arrivals) = (off_their_line(&ends), off_their_line(&arrivals));
    println!("p50, p99, max in ms: clock {clock:.2?}, arrivals {arrivals:.2?}");
    assert!(clock[1] < arrivals[1] / 2.0 && clock[2] < arrivals[2] / 2.0);
}

/// How far times are from the straight line through them, in milliseconds: median, 99th
/// percentile and maximum.
fn off_their_line(times: &[f64]) -> [f64; 3] {
    let turn = |time: &f64| ((time - times[0]) / 0.099_760_5).round();
    let count = times.len() as f64;
    let mean = |of: &dyn Fn(&f64) -> f64| times.iter().map(of).sum::<f64>() / count;
    let (x, y) = (mean(&turn), mean(&|time| *time));
    let slope =
        mean(&|time| (turn(time) - x) * (time - y)) / mean(&|time| (turn(time) - x).powi(2));
    let off = |time: &f64| (time - y - slope * (turn(time) - x)).abs() * 1e3;
    let mut off: Vec<f64> = times.iter().map(off).collect();
    off.sort_by(f64::total_cmp);
    [0.5, 0.99, 1.0].map(|share| off[((off.len() - 1) as f64 * share) as usize])
}

#[test]
fn on_usb_the_line_runs_along_the_lower_edge_of_the_arrivals() {
    for interval in [0.0, 0.1, 0.2, 0.333] {
        let (clock, arrivals) = Setup { interval, ..USB }.p99();
        assert!(clock < 0.3 && arrivals > 1.0, "{interval}: {clock}, {arrivals}");
    }
    // Few replies within the memory.
    let (clock, _) = Setup { interval: 1.0, seconds: 3600.0, ..USB }.p99();
    assert!(clock < 0.4, "{clock}");
}

#[test]
fn a_serial_line_slower_than_the_motor_does_not_matter() {
    for transfer in [0.121, 0.243, 0.729] {
        let (clock, arrivals) = Setup { transfer, frame: 0.0, seconds: 1800.0, ..USB }.p99();
        assert!(clock < 0.05 && arrivals < 0.11, "{transfer}: {clock}, {arrivals}");
    }
}

#[test]
fn late_replies_are_not_followed() {
    let (clock, arrivals) = Setup { late: (0.2, 0.03), ..USB }.p99();
    assert!(clock < 0.3 && arrivals > 28.0, "{clock}, {arrivals}");
    let (clock, _) = Setup { late: (0.2, 0.03), interval: 1.0, seconds: 7200.0, ..USB }.p99();
    assert!(clock < 0.5, "{clock}");
    // Not even a single late one, at any time.
    for late in [0.002, 0.02, 0.09] {
        let setup = Setup { late: (0.01, late), ..USB };
        let mut by_motor = setup.run().into_iter().filter(|seen| seen.is_measured);
        assert!(by_motor.all(|seen| seen.error < 0.5), "{late}");
    }
}

#[test]
fn drift_is_followed() {
    for drift in [0.001, -0.001] {
        let setup = Setup { drift, seconds: 3600.0, ..USB };
        let (clock, _) = setup.p99();
        assert!(clock < 0.5, "{drift}: {clock}");
        let periods = setup.run().into_iter().filter_map(|seen| seen.period_error);
        assert!(periods.fold(0.0, f64::max) < 1e-4, "{drift}");
    }
}

#[test]
fn a_jump_of_the_phase_is_followed_within_five_scans() {
    for interval in [0.0, 0.1, 0.2] {
        let seen = Setup { jumps_every: 20.0, interval, seconds: 40_000.0, ..USB }.run();
        let jumps = seen.iter().filter(|seen| seen.since_jump == 1).count();
        assert!(jumps > 1500);
        let after = |seen: &&Seen| seen.since_jump > 5;
        let worse = seen.iter().filter(after).filter(|seen| seen.error > seen.arrival_error + 0.2);
        // A jump that a USB frame hides is followed as drift is.
        let (count, worst) = worse.fold((0, 0.0), |(n, most), seen| (n + 1, seen.error.max(most)));
        assert!(count < jumps / 10 && worst < 1.5, "{interval}: {count} of {jumps}, {worst}");
    }
}

#[test]
fn the_period_is_reported_once_it_is_known_to_a_ten_thousandth() {
    for interval in [0.0, 0.1, 0.2, 1.0] {
        let seen = Setup { interval, ..USB }.run();
        let first = seen.iter().position(|seen| seen.period_error.is_some()).unwrap();
        assert!((10..=SETTLING).contains(&first), "{first}");
        let known = seen.iter().filter_map(|seen| seen.period_error);
        assert!(known.fold(0.0, f64::max) < 1e-4, "{interval}");
        assert!(seen[first..].iter().all(|seen| seen.period_error.is_some()));
    }
}

#[test]
fn a_sensor_that_answers_at_once_has_no_motor_to_follow() {
    let at_once = Setup { answers_at_once: true, ..USB };
    for setup in [
        at_once,
        Setup { interval: 0.1, ..at_once },
        Setup { interval: 1.0, ..at_once },
        Setup { interval: 0.1, late: (0.3, 0.03), ..at_once },
        Setup { transfer: 0.729, ..at_once },
        Setup { transfer: 0.0985, ..at_once },
    ] {
        assert!(setup.run().iter().all(|seen| !seen.is_measured), "{setup:?}");
    }
}

#[test]
fn there_is_no_line_below_a_reply_every_three_seconds_or_far_from_the_nominal_period() {
    for (interval, has_line) in [(2.0, true), (4.0, false), (10.0, false)] {
        let seen = Setup { interval, seconds: 2000.0, ..USB }.run();
        assert_eq!(seen.iter().any(|seen| seen.is_measured), has_line, "{interval}");
    }
    for period in [0.095, 0.0975, 0.1025, 0.105] {
        let seen = Setup { period, ..USB }.run();
        let worse = seen.iter().filter(|seen| seen.error > seen.arrival_error + 0.2).count();
        assert!(worse < seen.len() / 50, "{period}: {worse} of {}", seen.len());
    }
}

#[test]
fn without_a_line_the_end_is_the_arrival() {
    let mut clock = proved();
    let start = Instant::now();
    for n in 1..=8 {
        let arrived = start + n * NOMINAL;
        let revolution = clock.observe(arrived - NOMINAL / 2, arrived);
        assert_eq!(revolution, Revolution { lateness: None, period: None });
        assert_eq!(clock.stats(), None);
    }
    let arrived = start + 9 * NOMINAL;
    assert!(clock.observe(arrived - NOMINAL / 2, arrived).lateness.is_some());
}

#[test]
fn after_a_pause_the_line_is_found_again() {
    let mut clock = proved();
    let mut arrived = Instant::now();
    let mut errors = Vec::new();
    for pause in [0, 1, 10, 100, 1000, 100_000] {
        // The phase changes, too.
        arrived += Duration::from_secs(pause) + Duration::from_millis(30);
        for n in 0..200 {
            arrived += Duration::from_micros(99_760);
            let late = Duration::from_micros(n % 5 * 200);
            let revolution = clock.observe(arrived - NOMINAL / 2, arrived + late);
            errors.extend(revolution.lateness.map(|lateness| late.abs_diff(lateness)));
        }
        // The first replies after a pause may be late for the line.
        let wrong = errors.drain(..).filter(|error| *error > Duration::from_micros(400)).count();
        assert!(wrong <= 2, "{pause}: {wrong}");
    }
}

#[test]
fn times_without_sense_neither_panic_nor_bend_the_period() {
    let mut draw = Draw(7);
    let mut clock = proved();
    let mut now = Instant::now();
    for _ in 0..200_000 {
        let wait = Duration::from_secs_f64(10_f64.powf(6.0 * draw.next() - 5.0));
        let requested = now;
        now += wait;
        let revolution = clock.observe(requested, now);
        let lateness = revolution.lateness.unwrap_or_default();
        assert!(lateness < wait.max(NOMINAL + NOMINAL / 10), "{lateness:?} after {wait:?}");
        assert!((clock.period / clock.nominal - 1.0).abs() <= LARGEST_DIFFERENCE);
        // The clock of a virtual machine may stand still.
        if draw.next() < 0.1 {
            clock.observe(now, now);
        }
    }
}

#[test]
fn few_replies_in_time_are_no_line() {
    // Half of the replies are late by more than 7 ms, 1 % by more than 46 ms.
    let busy = Setup { busy: (0.01, 1e9, 60.0), seconds: 3600.0, ..USB };
    for setup in [busy, Setup { interval: 0.1, ..busy }, Setup { drift: 0.001, ..busy }] {
        for seed in 1..=3 {
            let seen = Setup { seed, ..setup }.run();
            let (_, arrivals) = p99(&seen);
            assert!(arrivals > 45.0, "{setup:?}: {arrivals}");
            let by_motor = seen.iter().filter(|seen| seen.is_measured);
            let (count, wrong) = by_motor.fold((0, 0), |(count, wrong), seen| {
                (count + 1, wrong + usize::from(seen.error > 5.0))
            });

            assert!(wrong * 1000 <= count, "{setup:?}: {wrong} of {count}");
        }
    }
}

#[test]
fn a_spell_of_late_replies_does_not_move_the_line() {
    // For 3 s each half minute nearly all replies are late, by 20 ms on average.
    for seed in 1..=3 {
        let seen = Setup { busy: (0.02, 3.0, 27.0), seconds: 3600.0, seed, ..USB }.run();
        let by_motor: Vec<_> = seen.into_iter().filter(|seen| seen.is_measured).collect();
        let wrong = by_motor.iter().filter(|seen| seen.error > 5.0).count();
        assert!(wrong * 1000 <= by_motor.len(), "{seed}: {wrong}");
    }
}

#[test]
fn replies_late_by_a_revolution_rest_on_arrival() {
    let mut clock = proved();
    let start = Instant::now();
    let end = |n: u32| start + n * NOMINAL;
    for n in 1..=20 {
        clock.observe(end(n) - NOMINAL / 2, end(n));
    }
    let lateness = |after| {
        let arrived = end(21) + after;
        clock.clone().observe(end(21) - NOMINAL / 2, arrived).lateness
    };
    for late in [0, 20, 80].map(Duration::from_millis) {
        assert!(lateness(late).unwrap().abs_diff(late) < Duration::from_millis(1), "{late:?}");
    }
    // Late, early, or of a later revolution.
    for late in [85, 95, 120, 180, 250, 390].map(Duration::from_millis) {
        assert_eq!(lateness(late), None, "{late:?}");
    }
}

#[test]
fn late_replies_that_agree_by_chance_are_forgotten() {
    let mut clock = proved();
    let start = Instant::now();
    let mut observe = |n: u32, late: u64| {
        let (end, late) = (start + n * NOMINAL, Duration::from_millis(late));
        let lateness = clock.observe(end - NOMINAL / 2, end + late).lateness;
        (lateness.map(|lateness| lateness.abs_diff(late)), clock.jumps)
    };
    for n in 1..=100 {
        observe(n, 0);
    }
    for n in 101..=106 {
        let (error, _) = observe(n, 30);
        assert!(error.is_none_or(|error| error < NOMINAL / 100));
    }
    for n in 107..200 {
        let (error, jumps) = observe(n, 0);
        assert!(error.is_none_or(|error| error < NOMINAL / 1000));
        assert_eq!(jumps, 0);
    }
}

#[test]
fn two_jumps_within_few_scans_are_both_followed() {
    let mut clock = proved();
    let mut end = Instant::now();
    for (count, jump) in [(100, 40), (2, 12), (100, 0)] {
        let mut late = 0;
        for _ in 0..count {
            end += NOMINAL;
            let revolution = clock.observe(end - NOMINAL / 2, end);
            late += usize::from(revolution.lateness.unwrap_or_default() > NOMINAL / 100);
        }
        assert!(late <= 6, "{late}");
        end += Duration::from_millis(jump);
    }
    assert!(clock.jumps >= 1);
}

#[test]
fn a_jump_is_followed_beside_late_replies() {
    let late = Setup { late: (0.2, 0.03), jumps_every: 60.0, seconds: 40_000.0, ..USB };
    let seen = late.run();
    let jumps = seen.iter().filter(|seen| seen.since_jump == 1).count();
    let after = |seen: &&Seen| seen.since_jump > 5;
    let worse = seen.iter().filter(after).filter(|seen| seen.error > seen.arrival_error + 0.5);
    // The sixth or seventh scan is worse if several of the five were late.
    let worse = worse.count();
    assert!(jumps > 500 && worse < jumps, "{worse} scans after {jumps} jumps");
}
