//! Runs every sequence, not a sample of them: the driver on the paused clock, against a
//! sensor and a line whose every choice is enumerated. README.md has the figures.

mod chooser;
mod fate;
mod line;
mod orders;
mod scenario;
mod sensor;

use std::time::Duration;

use tokio_scip::{BaudRate, Rate, Window};

use self::fate::{FATES, Fate};
use self::line::Depth;
use self::scenario::{Deed, Scenario};

/// Events that may happen besides.
const DEEDS: &[Deed] =
    &[Deed::Scan, Deed::CancelledScan, Deed::Laser, Deed::BaudRate, Deed::Unplug, Deed::HangUp];

fn setting(name: &str) -> Option<usize> {
    std::env::var(name).ok().map(|text| text.parse().unwrap())
}

/// Returns the number of exchanges with a choice, and how many of them may have a fault.
fn depth() -> Depth {
    let exchanges = setting("SCIP_EXHAUSTIVE").unwrap_or(3);
    Depth { exchanges, faults: setting("SCIP_EXHAUSTIVE_FAULTS").unwrap_or(exchanges) }
}

fn explore(scenario: &Scenario) {
    let Depth { exchanges, faults } = depth();
    let mut total = scenario.explore(depth(), None);
    // An event in each place multiplies the runs, so there are fewer faults.
    let depth = Depth { exchanges, faults: faults.saturating_sub(2).max(1) };
    for deed in scenario.deeds {
        for place in 1..=2 * exchanges {
            total.add(&scenario.explore(depth, Some((*deed, place))));
        }
    }
    println!("{}: {total}", scenario.name);
    assert!(total.slowest < Duration::from_secs(60));
}

fn window(start: u16, end: u16, cluster_count: u8) -> Window {
    Window::new(start..=end).unwrap().with_cluster_count(cluster_count).unwrap()
}

fn can_differ() -> Window {
    window(300, 303, 1)
}

/// Returns a window without room for another group on either side.
fn cannot_differ() -> Window {
    window(44, 725, 45)
}

/// Returns all fates but those that no driver survives where polls cannot differ: a copy that
/// comes after the next poll is equal to its reply.
fn without_later_copies() -> &'static [Fate] {
    let (others, copies) = FATES.split_at(FATES.len() - 2);
    assert_eq!(copies, [Fate::DoubledSoon, Fate::DoubledAfterNext]);
    others
}

fn on_a_grid(name: &'static str, windows: &[Window]) -> Scenario {
    Scenario {
        name,
        windows: windows.to_vec(),
        rate: Rate::hz(10.0),
        baud_rate: None,
        fates: FATES,
        deeds: &[],
        chooses_while_opening: false,
    }
}

#[test]
fn opening() {
    let scenario = on_a_grid("opening", &[can_differ()]);
    explore(&Scenario { chooses_while_opening: true, ..scenario });
}

#[test]
fn opening_on_a_serial_line() {
    let scenario = on_a_grid("opening on a serial line", &[can_differ()]);
    let baud_rate = Some(BaudRate::B19200);
    explore(&Scenario { chooses_while_opening: true, baud_rate, ..scenario });
}

#[test]
fn windows_that_can_differ() {
    let scenario = on_a_grid("windows that can differ", &[can_differ()]);
    explore(&Scenario { deeds: DEEDS, ..scenario });
}

#[test]
fn windows_that_can_differ_as_fast_as_possible() {
    let scenario = on_a_grid("windows that can differ, Rate::UNLIMITED", &[can_differ()]);
    explore(&Scenario { rate: Rate::UNLIMITED, ..scenario });
}

#[test]
fn windows_that_cannot_differ() {
    let scenario = on_a_grid("windows that cannot differ", &[cannot_differ()]);
    explore(&Scenario { fates: without_later_copies(), deeds: DEEDS, ..scenario });
}

#[test]
fn windows_that_cannot_differ_as_fast_as_possible() {
    let scenario = on_a_grid("windows that cannot differ, Rate::UNLIMITED", &[cannot_differ()]);
    explore(&Scenario { rate: Rate::UNLIMITED, fates: without_later_copies(), ..scenario });
}

/// On a serial line a fence stands between two polls that follow each other at once.
#[test]
fn windows_that_cannot_differ_on_a_serial_line() {
    let scenario =
        on_a_grid("windows that cannot differ, 19,200 baud, Rate::UNLIMITED", &[cannot_differ()]);
    explore(&Scenario { rate: Rate::UNLIMITED, baud_rate: Some(BaudRate::B19200), ..scenario });
}

#[test]
fn windows_on_a_serial_line() {
    let scenario = on_a_grid("windows that can differ, 19,200 baud", &[can_differ()]);
    explore(&Scenario { baud_rate: Some(BaudRate::B19200), deeds: DEEDS, ..scenario });
}

#[test]
fn single_steps() {
    explore(&on_a_grid("a single step", &[window(0, 0, 1)]));
}

#[test]
fn two_schedules() {
    let scenario = on_a_grid("two schedules", &[can_differ(), cannot_differ()]);
    explore(&Scenario { deeds: &[Deed::CancelledScan, Deed::Laser, Deed::Unplug], ..scenario });
}
