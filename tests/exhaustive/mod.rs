//! Runs every sequence, not a sample of them: the driver on the paused clock, against a
//! sensor and a line whose every choice is enumerated. README.md has the figures.

mod chooser;
mod fate;
mod line;
mod orders;
mod scenario;
mod scip2;
mod sensor;

use std::time::Duration;

use tokio_scip::protocol::Protocol::{self, Scip1, Scip2};
use tokio_scip::{Rate, Window};

use self::fate::{FATES, Fate, SCIP2_FATES};
use self::line::{Cut, Depth};
use self::scenario::{Deed, Scenario};
use crate::common::random::times;

/// Events that may happen besides.
const DEEDS: &[Deed] = &[
    Deed::Scan,
    Deed::CancelledScan,
    Deed::Stream,
    Deed::Laser,
    Deed::BaudRate,
    Deed::Cut(Cut::Cable),
    Deed::Cut(Cut::Port),
    Deed::Cut(Cut::Power),
    Deed::Cut(Cut::PowerAndCable),
];

/// Stream of another program.
const LEFT_OVER: &[u8] = b"MD0500050101000";

fn setting(name: &str) -> Option<usize> {
    std::env::var(name).ok().map(|text| text.parse().unwrap())
}

/// Returns the number of exchanges with a choice, and how many of them may have a fault. On a desk
/// fewer in SCIP 2, which has more fates.
fn depth(protocol: Protocol) -> Depth {
    let usual = if protocol == Scip2 && times() == 1 { 2 } else { 3 };
    let exchanges = setting("SCIP_EXHAUSTIVE").unwrap_or(usual);
    Depth { exchanges, faults: setting("SCIP_EXHAUSTIVE_FAULTS").unwrap_or(exchanges) }
}

fn explore(scenario: &Scenario) {
    let depth = depth(scenario.protocols.1);
    let Depth { exchanges, faults } = depth;
    let mut total = scenario.explore(depth, None);
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
        protocols: (Scip1, Scip1),
        streams: windows.iter().map(|window| (*window, Rate::hz(10.0))).collect(),
        has_baud_rate: false,
        fates: FATES,
        deeds: &[],
        chooses_while_opening: false,
        left_over: None,
    }
}

fn unlimited(name: &'static str, window: Window) -> Scenario {
    Scenario { streams: vec![(window, Rate::UNLIMITED)], ..on_a_grid(name, &[]) }
}

/// Returns a scenario in SCIP 2. At a high rate on a fast line the sensor sends a stream, otherwise it is
/// polled.
fn in_scip2(name: &'static str, streams: &[(Window, Rate)]) -> Scenario {
    Scenario {
        protocols: (Scip2, Scip2),
        streams: streams.to_vec(),
        fates: SCIP2_FATES,
        ..on_a_grid(name, &[])
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
    explore(&Scenario { chooses_while_opening: true, has_baud_rate: true, ..scenario });
}

#[test]
fn windows_that_can_differ() {
    let scenario = on_a_grid("windows that can differ", &[can_differ()]);
    explore(&Scenario { deeds: DEEDS, ..scenario });
}

#[test]
fn windows_that_can_differ_as_fast_as_possible() {
    explore(&unlimited("windows that can differ, Rate::UNLIMITED", can_differ()));
}

#[test]
fn windows_that_cannot_differ() {
    let scenario = on_a_grid("windows that cannot differ", &[cannot_differ()]);
    explore(&Scenario { fates: without_later_copies(), deeds: DEEDS, ..scenario });
}

#[test]
fn windows_that_cannot_differ_as_fast_as_possible() {
    let scenario = unlimited("windows that cannot differ, Rate::UNLIMITED", cannot_differ());
    explore(&Scenario { fates: without_later_copies(), ..scenario });
}

/// On a serial line a fence stands between two polls that follow each other at once.
#[test]
fn windows_that_cannot_differ_on_a_serial_line() {
    let name = "windows that cannot differ, 19,200 baud, Rate::UNLIMITED";
    explore(&Scenario { has_baud_rate: true, ..unlimited(name, cannot_differ()) });
}

#[test]
fn windows_on_a_serial_line() {
    let scenario = on_a_grid("windows that can differ, 19,200 baud", &[can_differ()]);
    explore(&Scenario { has_baud_rate: true, deeds: DEEDS, ..scenario });
}

#[test]
fn single_steps() {
    explore(&on_a_grid("a single step", &[window(0, 0, 1)]));
}

#[test]
fn two_schedules() {
    let scenario = on_a_grid("two schedules", &[can_differ(), cannot_differ()]);
    let deeds = &[Deed::CancelledScan, Deed::Laser, Deed::Cut(Cut::Cable)];
    explore(&Scenario { deeds, ..scenario });
}

#[test]
fn opening_in_scip_2() {
    let scenario = |name, rate| Scenario {
        chooses_while_opening: true,
        ..in_scip2(name, &[(can_differ(), rate)])
    };
    let unlimited = |name| scenario(name, Rate::UNLIMITED);
    explore(&unlimited("SCIP 2, opening"));
    let serial = Scenario { has_baud_rate: true, ..unlimited("SCIP 2, opening on a serial line") };
    explore(&serial);
    let name = "SCIP 2, opening from SCIP 1.1";
    explore(&Scenario { name, protocols: (Scip1, Scip2), ..serial });
    // No stream of the driver's own takes its place.
    let polls = scenario("SCIP 2, opening with a stream left over", Rate::hz(0.5));
    explore(&Scenario { left_over: Some(LEFT_OVER), ..polls });
}

#[test]
fn polls_in_scip_2() {
    let scenario = in_scip2("SCIP 2, polls", &[(can_differ(), Rate::hz(0.5))]);
    explore(&Scenario { deeds: DEEDS, ..scenario });
}

/// The line is too slow for a stream.
#[test]
fn polls_in_scip_2_on_a_serial_line() {
    let name = "SCIP 2, polls at 19,200 baud, Rate::UNLIMITED";
    let scenario = in_scip2(name, &[(window(300, 403, 1), Rate::UNLIMITED)]);
    explore(&Scenario { has_baud_rate: true, deeds: DEEDS, ..scenario });
}

#[test]
fn a_stream_in_scip_2() {
    let scenario = in_scip2("SCIP 2, a stream", &[(can_differ(), Rate::UNLIMITED)]);
    explore(&Scenario { deeds: DEEDS, ..scenario });
}

#[test]
fn a_stream_in_scip_2_on_a_serial_line() {
    let name = "SCIP 2, a stream at 19,200 baud";
    let scenario = in_scip2(name, &[(can_differ(), Rate::UNLIMITED)]);
    explore(&Scenario { has_baud_rate: true, deeds: DEEDS, ..scenario });
}

#[test]
fn a_stream_and_polls_in_scip_2() {
    let streams = [(can_differ(), Rate::hz(5.0)), (window(302, 310, 1), Rate::hz(0.5))];
    explore(&Scenario { deeds: DEEDS, ..in_scip2("SCIP 2, a stream and polls", &streams) });
}
