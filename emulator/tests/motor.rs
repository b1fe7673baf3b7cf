//! Period, drift and phase of the motor, as the sent scans tell them.

use std::time::Duration;

use tokio::time::{Instant, advance, sleep};
use urg_emulator::{Emulator, Fixed};

use super::ask;

const MS: Duration = Duration::from_millis(1);
const HOUR: Duration = Duration::from_secs(3600);

/// Polls for this time, and returns the ends of the revolutions seen.
async fn ends(emulator: &Emulator, time: Duration) -> Vec<Instant> {
    let (mut link, until) = (emulator.link(), Instant::now() + time);
    let mut ends = Vec::new();
    while Instant::now() < until {
        ask(&mut link, "G38438401").await;
        ends.push(emulator.sent_scans().last().unwrap().revolution_end);
    }
    ends
}

fn drifting(an_hour: f64) -> Emulator {
    Emulator::builder().drift(an_hour).world(Fixed::filled(1234)).build()
}

#[tokio::test(start_paused = true)]
async fn the_period_grows_by_the_drift() {
    for drift in [0.001, -0.001] {
        let emulator = drifting(drift);
        advance(HOUR).await;
        let ends = ends(&emulator, 10_000 * MS).await;
        let expected = (100 * MS).mul_f64(1.0 + drift);
        assert!(ends.len() > 95);
        for two in ends.windows(2) {
            let period = two[1] - two[0];
            assert!(period.abs_diff(expected) < Duration::from_micros(1), "{period:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_change_of_drift_keeps_phase_and_period() {
    let (changed, unchanged) = (drifting(0.001), drifting(0.001));
    advance(HOUR).await;
    changed.set_drift(0.0);
    let seen = async {
        let (after, before) =
            tokio::join!(ends(&changed, 10_000 * MS), ends(&unchanged, 10_000 * MS));
        assert!(before[0].duration_since(after[0]) < Duration::from_nanos(10));
        let grown = before[90] - after[90];
        assert!(
            grown > Duration::from_micros(10) && grown < Duration::from_micros(13),
            "{grown:?}"
        );
    };
    seen.await;
}

#[tokio::test(start_paused = true)]
async fn a_delay_moves_all_ends_and_loses_no_revolution() {
    let emulator = Emulator::builder().world(Fixed::filled(1234)).build();
    let start = Instant::now();
    let mut link = emulator.link();
    sleep(1050 * MS).await;
    for (delay, end, revolution) in [(30 * MS, 1130 * MS, 10), (30 * MS, 1260 * MS, 11)] {
        emulator.delay_motor(delay);
        ask(&mut link, "G38438401").await;
        let sent = *emulator.sent_scans().last().unwrap();
        assert_eq!((sent.revolution_end - start, sent.time.revolution), (end, revolution));
    }
    emulator.power_cycle();
    ask(&mut link, "G38438401").await;
    assert_eq!(emulator.sent_scans().last().unwrap().time.revolution, 0);
}
