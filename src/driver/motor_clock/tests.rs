//! Tests the clock with the times of a real sensor, and with times without sense.

use super::*;

const NOMINAL: Duration = Duration::from_millis(100);
/// Reply times of a URG-04LX on USB, in seconds: request, first and last byte.
const REPLY_TIMES: &str = include_str!("reply_times.csv");

#[test]
fn replies_of_a_real_sensor_lie_on_one_line() {
    let (epoch, mut clock) = (Instant::now(), MotorClock::new(NOMINAL));
    // The earliest first bytes lie on the line from 104.8 ms with this period.
    let (first, period, mut off) = (0.1048, 0.099_760_5, Vec::new());
    for line in REPLY_TIMES.lines().skip(1) {
        let times: Vec<f64> = line.split(',').map(|time| time.parse().unwrap()).collect();
        let at = |seconds| epoch + Duration::from_secs_f64(seconds);
        if let Some(late) = clock.observe(at(times[0]), at(times[1])).lateness {
            let turns = (times[1] - late.as_secs_f64() - first) / period;
            off.push((turns - turns.round()).abs() * period * 1e3);
        }
    }
    off.sort_by(f64::total_cmp);
    println!("{} of 62 by motor; in ms from a line: {off:.2?}", off.len());
    assert!(off.len() >= 45 && off.iter().all(|off| *off < 0.6), "{off:?}");
    assert!((clock.line.slope - period).abs() < 2e-5, "{}", clock.line.slope);
}

#[test]
fn senseless_times_neither_panic_nor_bend_the_period() {
    let (mut random, mut clock) =
        (model::ModelRandom(fastrand::Rng::with_seed(7)), MotorClock::new(NOMINAL));
    let mut now = Instant::now();
    for _ in 0..200_000 {
        let requested = now;
        now += Duration::from_secs_f64(10_f64.powf(6.0 * random.below_one() - 5.0));
        assert_eq!(clock.observe(requested, now), Revolution::default());
        assert!((clock.line.slope / clock.nominal - 1.0).abs() <= LARGEST_DIFFERENCE);
        if random.below_one() < 0.1 {
            // The clock of a virtual machine may stand still.
            clock.observe(now, now);
        }
    }
}
