//! Condition of one sensor as a ROS diagnostic status: level, message, and key-value pairs.

use std::time::Duration;

use tokio_scip::{Rate, Sensor, State, Version, Window};
use urg_recording::ros::{DiagnosticLevel, DiagnosticStatus};

use super::engine::Outlet;
use crate::stream::health::SensorHealth;
use crate::stream::rate_watch::schedule;

/// Condition of one sensor, updated by its scans.
#[derive(Debug, Default)]
pub(crate) struct Condition {
    /// `None` before the driver is started.
    pub(super) sensor: Option<Sensor>,
    pub(super) version: Option<Version>,
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
        let reached = schedule(&stats, window).and_then(|schedule| schedule.reached);
        let health = SensorHealth::from_sensor(self.sensor.as_ref(), window, rate);
        let link = health.link;
        let (level, message) = self.judge(health, rate, reached);
        let baud_rate =
            self.sensor.as_ref().and_then(|sensor| sensor.watch_state().get().baud_rate());
        let age = self.sensor.as_ref().and_then(|sensor| sensor.freshness().age());
        let counted = outlet.counts().lock().clone();
        let version = self.version.as_ref();
        let serial_number = shown(version.map(|version| &version.serial_number));
        let mut values = vec![
            ("State", link.to_owned()),
            ("Product", shown(version.map(|version| &version.product))),
            ("Serial number", serial_number.clone()),
            ("Firmware", shown(version.map(|version| &version.firmware))),
            ("Baud rate", shown(baud_rate)),
            ("Rate requested (Hz)", rate.period().map_or_else(|| "max".to_owned(), hertz)),
            ("Rate reached (Hz)", shown(reached.map(|rate| format!("{rate:.2}")))),
            ("Age of the last scan (s)", shown(age.map(seconds))),
            ("Scans published", counted.published.to_string()),
            ("Scans dropped", counted.dropped.to_string()),
            ("Scans possibly lost", counted.possibly_lost.to_string()),
            (
                "Age of the last published scan (s)",
                shown(counted.last_published.map(|at| seconds(at.elapsed()))),
            ),
            ("Readers", shown(counted.readers)),
            ("Engine restarts", counted.restarts.to_string()),
        ];
        let losses = [
            ("Polls", stats.polls),
            ("Scans", stats.scans),
            ("Timeouts", stats.timeouts),
            ("Refused", stats.refused),
            ("Malformed", stats.malformed.total()),
            ("Skipped", stats.polls_skipped),
            ("Missed", stats.missed),
            ("Disconnects", stats.disconnects),
            ("Reconnects", stats.reconnects),
        ];
        values.extend(losses.map(|(name, count)| (name, count.to_string())));
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
        health: SensorHealth,
        rate: Rate,
        reached: Option<f64>,
    ) -> (DiagnosticLevel, String) {
        use DiagnosticLevel::{Error, Ok, Warn};
        if let Some(reason) = &self.ended {
            return (Error, reason.clone());
        }
        let has_scans = self.sensor.as_ref().is_some_and(|it| it.freshness().age().is_some());
        let state = self.sensor.as_ref().map(|sensor| sensor.watch_state().get());
        let is_connected = matches!(state, Some(State::Connected { .. }));
        match (health.why, reached) {
            _ if has_scans && matches!(state, Some(State::Connected { streaming: false, .. })) => {
                (Warn, "the laser is off".to_owned())
            }
            (Some(why), _) if is_connected && !has_scans => (Warn, why),
            (Some(why), _) => (Error, why),
            (None, Some(reached)) if !rate.is_reached_by(reached) => {
                (Warn, format!("{reached:.1} scans a second, {rate} requested"))
            }
            (None, _) => (Ok, "scans flow".to_owned()),
        }
    }
}

fn hertz(period: Duration) -> String {
    // Rounded to 10 instead of 10.000000000000002.
    let rate = 1.0 / period.as_secs_f64();
    ((rate * 1000.0).round() / 1000.0).to_string()
}

fn seconds(duration: Duration) -> String {
    format!("{:.2}", duration.as_secs_f64())
}

/// Formats a value that is not always known; else the text is empty.
fn shown(value: Option<impl ToString>) -> String {
    value.map(|value| value.to_string()).unwrap_or_default()
}
