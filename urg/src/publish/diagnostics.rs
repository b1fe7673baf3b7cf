//! Condition of one sensor as a ROS diagnostic status: level, message, and key-value pairs.

use std::time::{Duration, Instant};

use tokio_scip::{Rate, Sensor, State, Stats, Version, Window};
use urg_recording::ros::{DiagnosticLevel, DiagnosticStatus};

use super::engine::Outlet;
use crate::failure::chain;
use crate::stream::rate_watch::ENOUGH;

/// Tolerance for a late scan, in addition to three periods.
const LATE: Duration = Duration::from_secs(1);

/// Condition of one sensor, updated by its scans.
#[derive(Debug, Default)]
pub(crate) struct Condition {
    /// `None` before the driver is started.
    pub(super) sensor: Option<Sensor>,
    pub(super) version: Option<Version>,
    /// Time of the latest scan.
    pub(super) scanned: Option<Instant>,
    /// Why the scans have ended, if they have.
    pub(super) ended: Option<String>,
}

impl Condition {
    /// Builds the status of a sensor whose `window` is polled at `rate`, for the node `node`.
    pub(super) fn status(
        &self,
        node: &str,
        window: Window,
        rate: Rate,
        outlet: &Outlet,
    ) -> DiagnosticStatus {
        let stats = self.sensor.as_ref().map(Sensor::stats).unwrap_or_default();
        let reached = stats
            .schedules
            .iter()
            .find(|schedule| schedule.window == window)
            .and_then(|schedule| schedule.reached);
        let state = self.sensor.as_ref().map(|sensor| sensor.watch_state().get());
        let (level, message) = self.judge(state.as_ref(), window, rate, reached);
        let version = self.version.as_ref();
        let serial_number = shown(version.map(|version| &version.serial_number));
        let counted = outlet.counts().lock().clone();
        let mut values = vec![
            ("State", state_name(state.as_ref()).to_owned()),
            ("Product", shown(version.map(|version| &version.product))),
            ("Serial number", serial_number.clone()),
            ("Firmware", shown(version.map(|version| &version.firmware))),
            ("Baud rate", shown(state.as_ref().and_then(State::baud_rate))),
            ("Rate requested (Hz)", rate.period().map_or_else(|| "max".to_owned(), hertz)),
            ("Rate reached (Hz)", shown(reached.map(|rate| format!("{rate:.2}")))),
            ("Age of the last scan (s)", shown(self.scanned.map(age))),
            ("Scans published", counted.published.to_string()),
            ("Scans dropped", counted.dropped.to_string()),
            ("Scans possibly lost", counted.possibly_lost.to_string()),
            ("Age of the last published scan (s)", shown(counted.last_published.map(age))),
            ("Readers", shown(counted.readers)),
            ("Engine restarts", counted.restarts.to_string()),
        ];
        values.extend(losses(&stats));
        DiagnosticStatus {
            level,
            name: format!("{}: Hardware Status", node.trim_start_matches('/')),
            message,
            hardware_id: serial_number,
            values,
        }
    }

    fn judge(
        &self,
        state: Option<&State>,
        window: Window,
        rate: Rate,
        reached: Option<f64>,
    ) -> (DiagnosticLevel, String) {
        use DiagnosticLevel::{Error, Ok, Warn};
        if let Some(reason) = &self.ended {
            return (Error, reason.clone());
        }
        let baud_rate = match state {
            None => return (Error, "not opened yet".to_owned()),
            Some(State::Connected { streaming: false, .. }) if self.scanned.is_some() => {
                return (Warn, "the laser is off".to_owned());
            }
            Some(State::Connected { baud_rate, .. }) => *baud_rate,
            Some(State::Connecting { error: Some(error) }) => {
                return (Error, format!("waiting for the sensor: {}", chain(error)));
            }
            Some(State::Connecting { .. }) => return (Error, "looking for the sensor".to_owned()),
            Some(State::Recovering) => return (Error, "the sensor is silent".to_owned()),
            Some(State::Disconnected { error, .. } | State::Closed { error: Some(error) }) => {
                return (Error, chain(error));
            }
            Some(_) => return (Error, "closed".to_owned()),
        };
        let wire = baud_rate.map_or(Duration::ZERO, |rate| window.wire_time(rate));
        let period = rate.period().unwrap_or_default();
        match self.scanned {
            None => (Warn, "no scan yet".to_owned()),
            Some(at) if at.elapsed() > 3 * period.max(wire) + LATE => {
                (Error, format!("no scan for {} s", age(at)))
            }
            Some(_) => match reached {
                Some(reached) if reached * period.as_secs_f64() < ENOUGH => {
                    (Warn, format!("{reached:.1} scans a second, {} requested", hertz(period)))
                }
                _ => (Ok, "scans flow".to_owned()),
            },
        }
    }
}

/// Names the state of the driver in one word.
fn state_name(state: Option<&State>) -> &'static str {
    match state {
        None | Some(State::Connecting { .. }) => "connecting",
        Some(State::Connected { .. }) => "connected",
        Some(State::Recovering) => "recovering",
        Some(State::Disconnected { .. }) => "disconnected",
        Some(_) => "closed",
    }
}

/// Lists the counters of the driver.
fn losses(stats: &Stats) -> [(&'static str, String); 9] {
    [
        ("Polls", stats.polls),
        ("Scans", stats.scans),
        ("Timeouts", stats.timeouts),
        ("Refused", stats.refused),
        ("Malformed", stats.malformed.total()),
        ("Skipped", stats.polls_skipped),
        ("Missed", stats.missed),
        ("Disconnects", stats.disconnects),
        ("Reconnects", stats.reconnects),
    ]
    .map(|(name, count)| (name, count.to_string()))
}

fn hertz(period: Duration) -> String {
    // Rounded to 10 instead of 10.000000000000002.
    let rate = 1.0 / period.as_secs_f64();
    ((rate * 1000.0).round() / 1000.0).to_string()
}

/// Formats the seconds since an instant.
fn age(instant: Instant) -> String {
    format!("{:.2}", instant.elapsed().as_secs_f64())
}

/// Formats a value that is not always known; else the text is empty.
fn shown(value: Option<impl ToString>) -> String {
    value.map(|value| value.to_string()).unwrap_or_default()
}
