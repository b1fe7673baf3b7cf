//! Condition of one sensor as a ROS diagnostic status: level, message, and key-value pairs.

use std::time::{Duration, Instant};

use tokio_scip::ros::{DiagnosticLevel, DiagnosticStatus};
use tokio_scip::{Rate, Sensor, State, Stats, Version, Window};

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
        let (level, message) = self.judge(window, rate, reached);
        let text =
            |text: &dyn Fn(&Version) -> String| self.version.as_ref().map(text).unwrap_or_default();
        let serial_number = text(&|version| version.serial_number.to_string());
        let mut values = vec![
            ("State", self.state()),
            ("Product", text(&|version| version.product.to_string())),
            ("Serial number", serial_number.clone()),
            ("Firmware", text(&|version| version.firmware.to_string())),
            ("Baud rate", self.baud_rate()),
            ("Rate requested (Hz)", rate.period().map_or_else(|| "max".to_owned(), hertz)),
            ("Rate reached (Hz)", reached.map_or_else(String::new, |rate| format!("{rate:.2}"))),
            (
                "Age of the last scan (s)",
                self.scanned.map_or_else(String::new, |at| seconds(at.elapsed())),
            ),
            ("Scans published", outlet.counts().published().to_string()),
            ("Scans dropped", outlet.counts().dropped().to_string()),
            ("Scans possibly lost", outlet.counts().possibly_lost().to_string()),
            (
                "Age of the last published scan (s)",
                outlet
                    .counts()
                    .last_published()
                    .map_or_else(String::new, |at| seconds(at.elapsed())),
            ),
            ("Readers", outlet.counts().readers().map_or_else(String::new, |n| n.to_string())),
            ("Engine restarts", outlet.counts().restarts().to_string()),
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

    fn judge(&self, window: Window, rate: Rate, reached: Option<f64>) -> (DiagnosticLevel, String) {
        use DiagnosticLevel::{Error, Ok, Warn};
        if let Some(reason) = &self.ended {
            return (Error, reason.clone());
        }
        let Some(sensor) = &self.sensor else { return (Error, "not opened yet".to_owned()) };
        let baud_rate = match &sensor.state().get() {
            State::Connected { streaming: false, .. } if self.scanned.is_some() => {
                return (Warn, "the laser is off".to_owned());
            }
            State::Connected { baud_rate, .. } => *baud_rate,
            State::Connecting { error: Some(error) } => {
                return (Error, format!("waiting for the sensor: {}", chain(error)));
            }
            State::Connecting { .. } => return (Error, "looking for the sensor".to_owned()),
            State::Recovering => return (Error, "the sensor is silent".to_owned()),
            State::Disconnected { error, .. } | State::Closed { error: Some(error) } => {
                return (Error, chain(error));
            }
            _ => return (Error, "closed".to_owned()),
        };
        let wire = baud_rate.map_or(Duration::ZERO, |rate| window.wire_time(rate));
        let period = rate.period().unwrap_or_default();
        match self.scanned.map(|at| at.elapsed()) {
            None => (Warn, "no scan yet".to_owned()),
            Some(age) if age > 3 * period.max(wire) + LATE => {
                (Error, format!("no scan for {} s", seconds(age)))
            }
            Some(_) => match reached {
                Some(reached) if reached * period.as_secs_f64() < ENOUGH => {
                    (Warn, format!("{reached:.1} scans a second, {} requested", hertz(period)))
                }
                _ => (Ok, "scans flow".to_owned()),
            },
        }
    }

    /// State of the driver in one word.
    fn state(&self) -> String {
        match self.sensor.as_ref().map(|sensor| sensor.state().get()) {
            None | Some(State::Connecting { .. }) => "connecting",
            Some(State::Connected { .. }) => "connected",
            Some(State::Recovering) => "recovering",
            Some(State::Disconnected { .. }) => "disconnected",
            Some(_) => "closed",
        }
        .to_owned()
    }

    /// Baud rate; empty on USB and without a link.
    fn baud_rate(&self) -> String {
        let rate = self.sensor.as_ref().and_then(|sensor| sensor.state().get().baud_rate());
        rate.map_or_else(String::new, |rate| rate.to_string())
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

fn seconds(time: Duration) -> String {
    format!("{:.2}", time.as_secs_f64())
}
