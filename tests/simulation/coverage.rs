//! Counts of everything that happened in all runs together: each fault, each recovery.

use std::collections::BTreeMap;
use std::time::Duration;

use tokio_scip::{Error, ErrorKind, State, Stats};
use urg_emulator::{Emulator, Fault};

use super::case::CaseEvents;

/// Counters by name.
#[derive(Default)]
pub(crate) struct Coverage {
    /// Scans compared with the truth.
    pub(crate) checked: u64,
    pub(crate) missed: u64,
    /// Recoveries after which the laser was off, as requested.
    pub(crate) kept_off: u64,
    counts: BTreeMap<String, u64>,
}

/// Counters that must not be 0 after hours of simulation.
const EXPECTED: [&str; 29] = [
    "error AnotherSensor",
    "error Disconnected",
    "error LaserOff",
    "error Malformed",
    "error NotConfirmed",
    "error Timeout",
    "state Connected",
    "state Disconnected",
    "state Recovering",
    "did unplug",
    "did power_cycle",
    "did other_sensor",
    "did other_program",
    "did unrequested_bytes",
    "stats timeouts",
    "stats refused",
    "stats fences",
    "stats fence_timeouts",
    "stats disconnects",
    "stats reconnects",
    "stats bytes_skipped",
    "stats polls_skipped",
    "malformed echo",
    "malformed status",
    "malformed length",
    "malformed character",
    "malformed overlong",
    "malformed line",
    "scip2 scans",
];

impl Coverage {
    fn count(&mut self, name: String, by: u64) {
        *self.counts.entry(name).or_default() += by;
    }

    pub(crate) fn error(&mut self, error: &Error) {
        let kind = match error.kind() {
            ErrorKind::AnotherSensor { .. } => "AnotherSensor",
            ErrorKind::Disconnected { .. } => "Disconnected",
            ErrorKind::LaserOff => "LaserOff",
            ErrorKind::Malformed { .. } => "Malformed",
            ErrorKind::NotConfirmed { .. } => "NotConfirmed",
            ErrorKind::Timeout { .. } => "Timeout",
            _ => "of another kind",
        };
        self.count(format!("error {kind}"), 1);
    }

    /// Counts a stamp that rests on the sensor's clock.
    pub(crate) fn stamp(&mut self, error: Duration) {
        self.count("stamps by the clock".to_owned(), 1);
        if error > Duration::from_millis(2) {
            self.count("stamps off by 2 ms".to_owned(), 1);
        }
    }

    /// Counts simulated time of SCIP 2.
    pub(crate) fn scip2(&mut self, time: Duration) {
        self.count("scip2 ms".to_owned(), time.as_millis() as u64);
    }

    pub(crate) fn scip2_scan(&mut self) {
        self.count("scip2 scans".to_owned(), 1);
    }

    pub(crate) fn state(&mut self, state: &State) {
        self.count(format!("state {}", kind(state)), 1);
    }

    pub(crate) fn add(&mut self, stats: &Stats, emulator: &Emulator, events: CaseEvents) {
        let CaseEvents { unplug, power_cycle, other_sensor, other_program, unrequested_bytes } =
            events;
        let malformed = stats.malformed;
        for (name, by) in [
            ("did unplug", u64::from(unplug)),
            ("did power_cycle", power_cycle.into()),
            ("did other_sensor", (other_sensor && unplug).into()),
            ("did other_program", other_program.into()),
            ("did unrequested_bytes", unrequested_bytes.into()),
            ("stats polls", stats.polls),
            ("stats scans", stats.scans),
            ("stats timeouts", stats.timeouts),
            ("stats refused", stats.refused),
            ("stats fences", stats.fences),
            ("stats fence_timeouts", stats.fence_timeouts),
            ("stats disconnects", stats.disconnects),
            ("stats reconnects", stats.reconnects),
            ("stats bytes_skipped", stats.bytes_skipped),
            ("stats polls_skipped", stats.polls_skipped),
            ("malformed echo", malformed.echo),
            ("malformed status", malformed.status),
            ("malformed length", malformed.length),
            ("malformed character", malformed.character),
            ("malformed overlong", malformed.overlong),
            ("malformed line", malformed.line),
        ] {
            self.count(name.to_owned(), by);
        }
        for fault in faults() {
            self.count(format!("fault {}", kind(&fault)), emulator.fault_count(&fault));
        }
    }

    /// Returns the sums that the lines of several runs add up to.
    pub(crate) fn figures(&self) -> String {
        let faults = self.counts.iter().filter(|(name, _)| name.starts_with("fault "));
        let faults: u64 = faults.map(|(_, count)| count).sum();
        let polls = self.counts.get("stats polls").copied().unwrap_or_default();
        let [hours, scans, stamps, off] =
            ["scip2 ms", "scip2 scans", "stamps by the clock", "stamps off by 2 ms"]
                .map(|name| self.counts.get(name).copied().unwrap_or_default());
        format!(
            "polls {polls} checked {} faults {faults} scip2_hours {:.3} scip2_checked {scans} \
             stamps {stamps} off {off}",
            self.checked,
            hours as f64 / 3.6e6
        )
    }

    /// Fails if an expected counter is 0.
    pub(crate) fn check(&self) {
        let never = EXPECTED.iter().filter(|name| !self.counts.contains_key(**name));
        let zero = self.counts.iter().filter(|(_, count)| **count == 0).map(|(name, _)| &**name);
        let never: Vec<&str> = never.copied().chain(zero).collect();
        assert!(never.is_empty(), "never happened: {never:?}\n{self}");
        let [stamps, off] =
            ["stamps by the clock", "stamps off by 2 ms"].map(|name| self.counts.get(name));
        assert!(
            off.copied().unwrap_or_default() * 1000 <= stamps.copied().unwrap_or_default(),
            "{self}"
        );
        assert!(self.missed > 0 && self.checked > 0 && self.kept_off > 0, "{self}");
    }
}

impl std::fmt::Display for Coverage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "{:24} {:>12}", "scans checked", self.checked)?;
        writeln!(f, "{:24} {:>12}", "scans missed", self.missed)?;
        writeln!(f, "{:24} {:>12}", "laser kept off", self.kept_off)?;
        self.counts.iter().try_for_each(|(name, count)| writeln!(f, "{name:24} {count:>12}"))
    }
}

/// Returns the name of an enum's variant.
fn kind(value: &impl std::fmt::Debug) -> String {
    let text = format!("{value:?}");
    text.split(|c: char| !c.is_alphanumeric()).next().unwrap_or_default().to_owned()
}

/// Returns a fault of each kind that the cases draw.
fn faults() -> [Fault; 23] {
    [
        Fault::CommandLost,
        Fault::Lost,
        Fault::Late(Duration::ZERO),
        Fault::Doubled,
        Fault::Drop(0..0),
        Fault::Insert(0, Vec::new()),
        Fault::Flip(0, 0),
        Fault::Repeat(0..0),
        Fault::Cut(0),
        Fault::Damaged,
        Fault::Merged,
        Fault::Garbage(Vec::new()),
        Fault::Noise(0),
        Fault::Pause(0, Duration::ZERO),
        Fault::Trickle(Duration::ZERO),
        Fault::CrLf,
        Fault::Status(0),
        Fault::Reset(0),
        Fault::HangUp(0),
        Fault::Endless(Vec::new()),
        Fault::Ignored,
        Fault::WrongSum,
        Fault::ClockJump(0),
    ]
}
