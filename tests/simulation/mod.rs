//! Driver, line and emulated sensor on a paused clock: a seed picks faults and
//! users, and everything that happens is held against the truth. README.md
//! tells what was run and how to run more.

mod case;
mod coverage;
mod loss;
mod random;
mod run;
pub(crate) mod truth;
mod users;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use coverage::Coverage;
use loss::poll;
use run::run;
use tokio_scip::{Rate, Window};

fn setting(name: &str) -> Option<u64> {
    std::env::var(name).ok().map(|text| text.parse().unwrap_or_else(|_| panic!("{name}={text}")))
}

#[test]
fn seeds_find_no_wrong_scan_and_no_call_without_an_answer() {
    let coverage = Arc::new(Mutex::new(Coverage::default()));
    if let Some(seed) = setting("SCIP_SIMULATION_SEED") {
        let outcome = run(seed, &coverage);
        println!("{:?}, {:?}\n{}", outcome.simulated, outcome.recovery, coverage.lock().unwrap());
        return;
    }
    let hours = setting("SCIP_SIMULATION_HOURS").unwrap_or(6);
    let first = setting("SCIP_SIMULATION_FIRST").unwrap_or(0);
    let (mut simulated, mut longest) = (Duration::ZERO, [Duration::ZERO; 2]);
    let mut seeds = 0;
    while simulated < Duration::from_secs(hours * 3600) {
        let outcome = run(first + seeds, &coverage);
        simulated += outcome.simulated;
        let (took, usb) = outcome.recovery;
        longest[usize::from(usb)] = longest[usize::from(usb)].max(took);
        seeds += 1;
    }
    let coverage = coverage.lock().unwrap();
    let [rs232, usb] = longest;
    println!("{seeds} seeds from {first}, {:.1} sensor-hours", simulated.as_secs_f64() / 3600.0);
    println!("longest recovery: {usb:?} on USB, {rs232:?} on RS-232\n{coverage}");
    coverage.check();
}

#[test]
fn the_same_seed_gives_the_same_trace() {
    let coverage = Arc::default();
    let traces = |seeds: std::ops::Range<u64>| -> Vec<u64> {
        seeds.map(|seed| run(seed, &coverage).trace).collect()
    };
    let once = traces(1000..1006);
    assert_eq!(once, traces(1000..1006));
    assert!(once.windows(2).all(|pair| pair[0] != pair[1]));
}

/// How long each of the loss figures is simulated.
fn loss_time() -> Duration {
    Duration::from_secs(60 * setting("SCIP_LOSS_MINUTES").unwrap_or(10))
}

#[test]
fn a_bad_line_costs_less_than_three_scans_in_a_hundred_and_none_is_wrong() {
    for rate in [Rate::hz(10.0), Rate::MAX] {
        let loss = poll(Window::DETECTION, rate, loss_time());
        println!("{rate}: {loss:?}, {:.2} % right", loss.share() * 100.0);
        assert_eq!(loss.wrong, 0);
        assert!(loss.share() >= 0.97, "{rate}: {loss:?}");
    }
}

#[test]
fn where_polls_cannot_differ_only_doubled_replies_are_left() {
    for rate in [Rate::hz(10.0), Rate::MAX] {
        let loss = poll(Window::FULL, rate, loss_time());
        println!("{rate}: {loss:?}, {:.2} % right", loss.share() * 100.0);
        // One doubled reply in a thousand, and of these the few that a delay
        // puts behind the next poll.
        assert!(loss.wrong * 100_000 <= loss.polls, "{rate}: {loss:?}");
        assert!(loss.share() >= 0.97, "{rate}: {loss:?}");
    }
}
