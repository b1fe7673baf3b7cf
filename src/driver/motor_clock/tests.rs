//! Tests the clock with the times of a real sensor, and with times without sense.

use super::*;

const NOMINAL: Duration = Duration::from_millis(100);
/// Reply times of a URG-04LX on USB, in seconds: request, first and last byte.
const REPLY_TIMES: &str = include_str!("reply_times.csv");

/// Clock of a sensor that has shown that it follows its motor and not its requests.
fn proved() -> MotorClock {
    let proof = Proof { votes: PROVED, ..Proof::default() };
    MotorClock { proof, doubt: 0, ..MotorClock::new(NOMINAL) }
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
fn times_without_sense_neither_panic_nor_bend_the_period() {
    let mut random = model::ModelRandom(7);
    let mut clock = proved();
    let mut now = Instant::now();
    for _ in 0..200_000 {
        let wait = Duration::from_secs_f64(10_f64.powf(6.0 * random.below_one() - 5.0));
        let requested = now;
        now += wait;
        let revolution = clock.observe(requested, now);
        let lateness = revolution.lateness.unwrap_or_default();
        assert!(lateness < wait.max(NOMINAL + NOMINAL / 10), "{lateness:?} after {wait:?}");
        assert!((clock.period / clock.nominal - 1.0).abs() <= LARGEST_DIFFERENCE);
        // The clock of a virtual machine may stand still.
        if random.below_one() < 0.1 {
            clock.observe(now, now);
        }
    }
}
