//! Condition of one sensor as a ROS diagnostic status: level, message, and key-value pairs.

use std::time::Duration;

use tokio_scip::{Geometry, Rate, Sensor, State, Version, Window};
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
    pub(super) geometry: Option<Geometry>,
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
        let sensor = self.sensor.as_ref();
        let stats = sensor.map(Sensor::stats).unwrap_or_default();
        let reached = schedule(&stats, window).and_then(|schedule| schedule.reached);
        let state = sensor.map(|sensor| sensor.watch_state().get());
        let age = sensor.and_then(|sensor| sensor.freshness().age());
        let health = SensorHealth::from_sensor(sensor, window, rate);
        let link = health.link.to_owned();
        let (level, message) = self.judge(health, state.as_ref(), age.is_some(), rate, reached);
        let counted = outlet.counts.lock().clone();
        let (version, geometry) = (self.version.as_ref(), self.geometry.as_ref());
        let range =
            |range: std::ops::RangeInclusive<u32>| format!("{} to {}", range.start(), range.end());
        let steps = |geometry: &Geometry| {
            let (first, last) = geometry.steps().into_inner();
            format!("{first} to {last} of {}", geometry.steps_per_revolution())
        };
        let revolution = |geometry: &Geometry| geometry.revolution().as_secs_f64() * 1000.0;
        let serial_number = shown(version.map(|version| &version.serial_number));
        let last_published = counted.last_published.map(|at| seconds(at.elapsed()));
        let values = vec![
            ("State", link),
            ("Product", shown(version.map(|version| &version.product))),
            ("Serial number", serial_number.clone()),
            ("Firmware", shown(version.map(|version| &version.firmware))),
            ("Protocol", shown(geometry.map(Geometry::protocol))),
            ("Measures (mm)", shown(geometry.map(|geometry| range(geometry.distances())))),
            ("Measures (steps)", shown(geometry.map(steps))),
            ("Revolution (ms)", shown(geometry.map(revolution))),
            ("Baud rate", shown(state.and_then(|state| state.baud_rate()))),
            ("Rate requested (Hz)", rate.to_string().replace(" Hz", "")),
            ("Rate reached (Hz)", shown(reached.map(|rate| format!("{rate:.2}")))),
            ("Age of the last scan (s)", shown(age.map(seconds))),
            ("Scans published", counted.published.to_string()),
            ("Scans dropped", counted.dropped.to_string()),
            ("Scans possibly lost", counted.possibly_lost.to_string()),
            ("Age of the last published scan (s)", shown(last_published)),
            ("Readers", shown(counted.readers)),
            ("Engine restarts", counted.restarts.to_string()),
            ("Polls", stats.polls.to_string()),
            ("Scans", stats.scans.to_string()),
            ("Timeouts", stats.timeouts.to_string()),
            ("Refused", stats.refused.to_string()),
            ("Malformed", stats.malformed.total().to_string()),
            ("Lost", stats.lost.to_string()),
            ("Skipped", stats.polls_skipped.to_string()),
            ("Missed", stats.missed.to_string()),
            ("Disconnects", stats.disconnects.to_string()),
            ("Reconnects", stats.reconnects.to_string()),
        ];
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
        state: Option<&State>,
        has_scans: bool,
        rate: Rate,
        reached: Option<f64>,
    ) -> (DiagnosticLevel, String) {
        use DiagnosticLevel::{Error, Ok, Warn};
        match (&self.ended, health.why, state) {
            (Some(reason), ..) => (Error, reason.clone()),
            (_, _, Some(State::Connected { streaming: false, .. })) if has_scans => {
                (Warn, "the laser is off".to_owned())
            }
            (_, Some(why), Some(State::Connected { .. })) if !has_scans => (Warn, why),
            (_, Some(why), _) => (Error, why),
            _ => match reached.filter(|reached| !rate.is_reached_by(*reached)) {
                Some(reached) => (Warn, format!("{reached:.1} scans a second, {rate} requested")),
                None => (Ok, "scans flow".to_owned()),
            },
        }
    }
}

fn seconds(duration: Duration) -> String {
    format!("{:.2}", duration.as_secs_f64())
}

/// Formats a value that is not always known; else the text is empty.
fn shown(value: Option<impl ToString>) -> String {
    value.map(|value| value.to_string()).unwrap_or_default()
}
