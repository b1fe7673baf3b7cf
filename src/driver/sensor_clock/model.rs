//! Streams, clocks and hosts at random, against the ends of revolutions that the clock cannot see: how
//! far stamps are off, and how soon there are some. Sensor and host share no code with the clock.
//!
//! `SCIP_CLOCKS=20 cargo test --release --lib sensor_clock::model -- --nocapture` draws 320 sensors for
//! each cell, prints each cell, and takes a minute; `SCIP_CLOCKS_FIRST=1000001` draws others.

use fastrand::Rng;

use super::super::motor_clock::model::{Host, ModelRandom, Slew, seeds};
use super::*;

/// Time that each sensor sends, in seconds, and the largest number of its scans.
const TIME: f64 = 3600.0;
const MOST_SCANS: usize = 10_000;
/// Time after a start or a jump after which stamps count, in seconds.
const SETTLED: f64 = 10.0;
/// Interval of the frames of USB, and of a UST on Ethernet, in seconds.
const FRAME: f64 = 1e-3;
/// 24 bits of milliseconds.
const WRAP: f64 = 16_777.216;
/// Errors of a stamp in seconds, besides a constant delay, that 99 %, and all but one in a thousand, do not exceed.
const USUAL_BOUND: f64 = 0.5e-3;
const STAMP_BOUND: f64 = 2e-3;

/// Kind of a sensor and its host.
#[derive(Debug, Clone, Copy)]
struct Kind {
    revolution: f64,
    /// Number of scans left out after each one.
    skipped: u32,
    /// Times in microseconds in place of milliseconds.
    is_fine: bool,
    is_busy: bool,
    /// Clock and motor jump, and the motor may turn at another speed than the sensor tells.
    is_odd: bool,
    /// The host's clock is steered.
    is_slewed: bool,
}

#[derive(Debug, Default)]
struct Cell {
    stamps: usize,
    /// Settled stamps that rest on the clock, and how many of them are off by more than each bound.
    settled: usize,
    unusual: usize,
    wrong: usize,
    /// Stamps of revolutions that ended before the stream began.
    early: usize,
    /// Seconds from the start to the first stamp by the clock.
    waits: Vec<f64>,
}

impl Cell {
    fn add(&mut self, kind: Kind, seed: u64) {
        let mut random = ModelRandom(Rng::with_seed(seed));
        let epoch = Instant::now();
        let error = if kind.is_odd { 0.13 } else { 0.004 };
        let mut period = kind.revolution * random.between(1.0 - error, 1.0 + error);
        let drift = random.pick(&[0.0, 0.001, -0.001]) / 3600.0;
        let rate = 1.0 + random.between(-0.002, 0.002);
        let mut offset = WRAP * random.below_one();
        let (mut host, mut slew) = (Host::draw(&mut random, kind.is_busy), Slew::default());
        let (phase, delay) = (FRAME * random.below_one(), random.between(0.0, 2e-4));
        let (mut ends, mut errors) = (Vec::new(), Vec::new());
        let mut clock = SensorClock::new(Duration::from_secs_f64(kind.revolution));
        let (mut end, mut scans, mut read) = (1.0 + random.below_one(), 0, 0.0_f64);
        let (mut unsettled, mut first) = (end + SETTLED, Some(end));
        // When the stream began, by the host's clock, and how many scans it has until a request ends it.
        let (mut stream, usual) = (0.0, random.pick(&[10.0, 100.0, f64::INFINITY]));
        while end < TIME && scans < MOST_SCANS {
            scans += 1;
            period *= 1.0 + drift * period;
            end += period * f64::from(kind.skipped + 1);
            if kind.is_odd && random.once_in(2000.0) {
                match random.below_one() {
                    // The clock jumps, or begins anew.
                    x if x < 0.3 => offset += random.between(-0.1, 0.1),
                    x if x < 0.5 => offset = -end * rate,
                    // The motor does.
                    x if x < 0.7 => end += period * random.below_one(),
                    x if x < 0.85 => period *= random.between(0.97, 1.03),
                    // The sensor was off, and its clock shows little more than before.
                    _ => {
                        let pause = 10_f64.powf(random.between(-1.0, 3.0));
                        offset += random.between(-5.0, 40.0) - pause * rate;
                        end += pause;
                        stream = end + period * random.below_one();
                        stream += slew.gained(stream);
                    }
                }
                unsettled = end + SETTLED;
            }
            if random.once_in(usual) {
                // The motor turns on meanwhile.
                let longest = if random.once_in(100.0) { 3.0 } else { 0.5 };
                let pause = 10_f64.powf(random.between(-1.0, longest));
                stream = end + (pause - random.below_one() * period).max(0.0);
                stream += slew.gained(stream);
                end += period * (pause / period).ceil();
            }
            if kind.is_slewed && end > slew.end && random.once_in(1000.0) {
                slew = slew.draw(end, &mut random);
            }
            let begun = end - period;
            let unit = if kind.is_fine { 1e-6 } else { 1e-3 };
            let wrap = if kind.is_fine { 1.8e13 } else { WRAP };
            let stamp = ((begun * rate + offset) / unit).floor() * unit;
            let stamp = Duration::from_secs_f64(stamp.rem_euclid(wrap));
            let sent = ((end + delay - phase) / FRAME).ceil() * FRAME + phase;
            // Bytes of a stream keep their order.
            read = (sent + host.delay(sent, &mut random)).max(read);
            let by_host = |at: f64| at + slew.gained(at);
            let at = epoch + Duration::from_secs_f64(by_host(read));
            let wrap = Duration::from_secs_f64(wrap);
            let stream_at = epoch + Duration::from_secs_f64(stream);
            let revolution = clock.observe(stamp, wrap, at, stream_at, kind.skipped + 1);
            self.stamps += 1;
            let lateness = revolution.lateness.filter(|_| !revolution.is_doubted);
            let Some((lateness, turn)) = lateness.zip(revolution.period) else { continue };
            self.waits.extend(first.take().map(|first| end - first));
            let found = by_host(read) - lateness.as_secs_f64();
            self.early += usize::from(found < stream - 2.0 * STAMP_BOUND);
            if end > unsettled {
                ends.push(found - by_host(end));
                errors.push(found - turn.as_secs_f64() - by_host(begun));
            }
        }
        ends.sort_by(f64::total_cmp);
        // A host that is always late looks like a line that is.
        let constant = ends.get(ends.len() / 2).copied().unwrap_or_default();
        let off = |bound: f64| errors.iter().filter(|it| (*it - constant).abs() > bound).count();
        self.settled += errors.len();
        self.unusual += off(USUAL_BOUND);
        self.wrong += off(STAMP_BOUND);
    }
}

fn draw(kind: Kind) -> Cell {
    let mut cell = Cell::default();
    seeds("SCIP_CLOCKS", 2).for_each(|seed| cell.add(kind, seed));
    let Cell { stamps, settled, unusual, wrong, waits, early } = &cell;
    let latest = waits.iter().copied().fold(0.0, f64::max);
    println!(
        "{kind:?}: {settled} of {stamps} stamps settled, {unusual} off by 0.5 ms, {wrong} by 2 ms, first after {latest:.1} s"
    );
    assert_eq!(*early, 0, "scans from before their stream");
    cell
}

#[test]
fn few_stamps_by_the_clock_are_wrong() {
    // Settled stamps, and those off by each bound, of idle, of busy and of steered hosts.
    let mut sums = [[0; 3]; 3];
    let mut all = 0;
    for revolution in [0.025, 0.1] {
        for skipped in [0, 3, 9] {
            for bits in 0..16 {
                let [is_fine, is_busy, is_odd, is_slewed] = [1, 2, 4, 8].map(|bit| bits & bit > 0);
                let kind = Kind { revolution, skipped, is_fine, is_busy, is_odd, is_slewed };
                let Cell { stamps, settled, unusual, wrong, .. } = draw(kind);
                all += stamps;
                let sum = &mut sums[if is_slewed { 2 } else { usize::from(is_busy) }];
                sum.iter_mut().zip([settled, unusual, wrong]).for_each(|(sum, one)| *sum += one);
            }
        }
    }
    println!("idle, busy and steered: {sums:?}");
    let settled: usize = sums.iter().map(|[settled, ..]| settled).sum();
    assert!(settled * 5 >= all * 4, "{settled} of {all}");
    let bounds = [(100, 50_000), (100, 20_000), (25, 1000)];
    for ([settled, unusual, wrong], (usual, right)) in sums.into_iter().zip(bounds) {
        assert!(unusual * usual <= settled && wrong * right <= settled, "{sums:?}");
    }
}

#[test]
fn scans_that_waited_for_the_host_keep_the_time_of_the_clock() {
    const REVOLUTION: Duration = Duration::from_millis(25);
    let begun = Instant::now();
    let wrap = Duration::from_secs_f64(WRAP);
    let mut clock = SensorClock::new(REVOLUTION);
    let mut observe = |scan: u32, late: Duration| {
        let end = REVOLUTION * scan;
        let revolution = clock.observe(end, wrap, begun + end + late, begun, 1);
        assert!(scan < FIRST || !revolution.is_doubted, "{scan}");
        revolution.lateness
    };
    for scan in 1..400 {
        observe(scan, Duration::ZERO);
    }
    for scan in 400..404 {
        let late = REVOLUTION * (404 - scan);
        let found = observe(scan, late).expect("a stamp by the clock");
        assert!(found.abs_diff(late).as_secs_f64() < USUAL_BOUND, "{found:?} of {late:?}");
    }
}
