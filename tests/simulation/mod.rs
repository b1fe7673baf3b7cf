//! Driver, line and emulated sensor on a paused clock: a seed selects faults and users,
//! and every scan and event is compared with the truth. README.md has the results and
//! the commands.

mod alternatives;
mod case;
mod coverage;
mod loss;
mod run;
pub(crate) mod truth;
mod users;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use alternatives::Remedy;
use coverage::Coverage;
use loss::{Loss, bad_line, line_with_late_copies};
use run::run;
use tokio_scip::{Rate, Window};
use urg_emulator::Faults;

use crate::common::limit::limit;
use crate::common::random::times;

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
    let first = setting("SCIP_SIMULATION_FIRST").unwrap_or(0);
    let hours = setting("SCIP_SIMULATION_HOURS").unwrap_or(times());
    // A number of seeds has precedence over a number of hours.
    let last = setting("SCIP_SIMULATION_SEEDS").map(|seeds| first + seeds);
    let (mut simulated, mut longest) = (Duration::ZERO, [Duration::ZERO; 3]);
    for seed in first.. {
        if last.map_or(simulated >= Duration::from_secs(hours * 3600), |last| seed == last) {
            let [rs232, usb, scip2] = longest.map(|longest| longest.as_secs_f64());
            let (seeds, hours) = (seed - first, simulated.as_secs_f64() / 3600.0);
            // `pieces.sh` adds such lines up.
            println!(
                "piece {first} seeds {seeds} hours {hours:.3} usb {usb:.3} rs232 {rs232:.3} scip2 {scip2:.3} {}",
                coverage.lock().unwrap().figures()
            );
            break;
        }
        let outcome = run(seed, &coverage);
        simulated += outcome.simulated;
        let (took, port) = outcome.recovery;
        longest[port] = longest[port].max(took);
    }
    let coverage = coverage.lock().unwrap();
    println!("{coverage}");
    // In less time something rare may not occur.
    if simulated >= Duration::from_secs(3 * 3600) {
        coverage.check();
    }
}

#[test]
fn the_same_seed_gives_the_same_trace() {
    let coverage = Arc::default();
    let traces = |seeds: std::ops::Range<u64>| -> Vec<u64> {
        seeds.map(|seed| run(seed, &coverage).trace).collect()
    };
    let once = traces(1000..1003);
    assert_eq!(once, traces(1000..1003));
    assert!(once.windows(2).all(|pair| pair[0] != pair[1]));
}

/// Returns the simulated time of each loss figure.
fn loss_time() -> Duration {
    Duration::from_secs(60 * setting("SCIP_LOSS_MINUTES").unwrap_or(5))
}

fn on_paused_clock<T>(work: impl Future<Output = T>) -> T {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    runtime.enable_time().start_paused(true).build().unwrap().block_on(work)
}

/// Polls through the driver for that time, and prints the loss.
fn poll(window: Window, rate: Rate, faults: Faults) -> Loss {
    limit();
    let loss = on_paused_clock(loss::poll(window, rate, faults, loss_time()));
    println!("{rate}: {loss:?}, {:.2} % right", loss.share() * 100.0);
    loss
}

#[test]
fn a_bad_line_costs_few_scans() {
    for rate in [Rate::hz(10.0), Rate::UNLIMITED] {
        let loss = poll(Window::DETECTION, rate, bad_line(1.0));
        assert_eq!(loss.wrong, 0);
        assert!(loss.share() >= 0.97, "{rate}: {loss:?}");
    }
}

#[test]
fn t03_late_copies_of_replies_are_not_delivered() {
    for rate in [Rate::hz(10.0), Rate::UNLIMITED] {
        let loss = poll(Window::DETECTION, rate, line_with_late_copies());
        assert_eq!(loss.wrong, 0);
        assert!(loss.share() >= 0.97, "{rate}: {loss:?}");
    }
}

#[test]
fn equal_polls_deliver_few_doubled_replies() {
    for rate in [Rate::hz(10.0), Rate::UNLIMITED] {
        let loss = poll(Window::FULL, rate, bad_line(1.0));
        // One reply in a thousand is doubled; a delay puts a few of the copies after the
        // next poll.
        assert!(loss.wrong * 100_000 <= loss.polls, "{rate}: {loss:?}");
        assert!(loss.share() >= 0.97, "{rate}: {loss:?}");
    }
}

/// Polls through a client with another remedy than the fence, and prints the loss.
fn poll_with(remedy: Remedy, window: Window, rate: Rate, faults: Faults) -> Loss {
    limit();
    let work = alternatives::poll(remedy, window, rate, faults, loss_time());
    let loss = on_paused_clock(work);
    println!("{rate}: {remedy:?}: {loss:?}, {:.2} % right", loss.share() * 100.0);
    loss
}

/// Uses the window in which polls cannot differ, so that only the remedies are compared.
#[test]
fn other_remedies_than_the_fence_deliver_stale_scans_or_cost_more() {
    let (window, rates) = (Window::FULL, [Rate::hz(10.0), Rate::UNLIMITED]);
    // The other half of the table in README.md takes too long for a test.
    let lines: &[f64] = if setting("SCIP_LOSS_MINUTES").is_some() { &[1.0, 5.0] } else { &[5.0] };
    for (times, rate) in lines.iter().flat_map(|times| rates.map(|rate| (*times, rate))) {
        println!("faults {times} times as often:");
        let with = |remedy| poll_with(remedy, window, rate, bad_line(times));
        let fence = poll(window, rate, bad_line(times));
        let (clear, short) = (with(Remedy::Clear), with(Remedy::Quiet(Duration::from_millis(200))));
        let (long, version) = (with(Remedy::Quiet(Duration::from_secs(3))), with(Remedy::Version));
        assert!(clear.wrong > 0 && short.wrong > 0, "{rate}: {clear:?}, {short:?}");
        assert!(long.right < fence.right * 3 / 4, "{rate}: {long:?}, {fence:?}");
        // `V` delivers a wrong scan only where the replies to two of them are late one
        // after the other, which takes longer than minutes to happen.
        assert!(version.share() > 0.8, "{rate}: {version:?}");
    }
}
