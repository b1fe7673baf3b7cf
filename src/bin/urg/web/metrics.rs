//! `/metrics`: the figures of sensor and stream in Prometheus' text format
//! (version 0.0.4), so that a monitor can keep and compare them.

use std::fmt::{Display, Write};

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use tokio_scip::Stats;

use super::app::App;

const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

/// `/metrics`
pub(super) async fn metrics(State(app): State<App>) -> Response {
    let live = app.hub.live();
    let stats = live.as_ref().map(|live| live.sensor.stats()).unwrap_or_default();
    let mut text = Metrics::default();
    let is_up = u8::from(app.hub.health().why.is_none());
    text.metric("urg_up", "gauge", "1 while scans flow, else 0").sample("", is_up);
    if let Some(age) = live.and_then(|live| live.sensor.freshness().age()) {
        text.metric("urg_scan_age_seconds", "gauge", "Age of the latest scan")
            .sample("", age.as_secs_f64());
    }
    text.metric("urg_viewers", "gauge", "Open streams of scans").sample("", app.viewers.len());
    text.driver(&stats);
    ([(header::CONTENT_TYPE, CONTENT_TYPE)], text.text).into_response()
}

/// The text, as it grows.
#[derive(Default)]
struct Metrics {
    text: String,
    name: &'static str,
}

impl Metrics {
    /// Begins a metric. `help` holds no backslash and no line feed, which would
    /// have to be escaped.
    fn metric(&mut self, name: &'static str, kind: &str, help: &str) -> &mut Self {
        self.name = name;
        // Writing to a string does not fail.
        let _ = writeln!(self.text, "# HELP {name} {help}\n# TYPE {name} {kind}");
        self
    }

    /// Writes a sample of the metric. `rest` is the end of its name, or its labels.
    fn sample(&mut self, rest: &str, value: impl Display) -> &mut Self {
        let _ = writeln!(self.text, "{}{rest} {value}", self.name);
        self
    }

    fn driver(&mut self, stats: &Stats) {
        let reached = stats.schedules.first().map_or(0.0, |schedule| schedule.reached);
        self.metric("urg_scan_rate_hertz", "gauge", "Scans a second over some seconds")
            .sample("", reached);
        for (name, help, count) in [
            ("urg_polls_total", "Polls sent to the sensor", stats.polls),
            ("urg_scans_total", "Scans received from the sensor", stats.scans),
            ("urg_polls_skipped_total", "Polls that were not sent in time", stats.polls_skipped),
            ("urg_disconnects_total", "Losses of the link", stats.disconnects),
            ("urg_reconnects_total", "Returns of the link", stats.reconnects),
        ] {
            self.metric(name, "counter", help).sample("", count);
        }
        self.metric("urg_poll_failures_total", "counter", "Polls without a scan, by cause")
            .sample("{cause=\"timeout\"}", stats.timeouts)
            .sample("{cause=\"malformed\"}", stats.malformed.total())
            .sample("{cause=\"refused\"}", stats.refused);
        let latency = stats.reply_latency;
        self.metric("urg_reply_latency_seconds", "summary", "Time from a command to its reply")
            .sample("_sum", latency.total.as_secs_f64())
            .sample("_count", latency.count);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_metric_has_its_help_and_type_once_and_before_its_samples() {
        let mut metrics = Metrics::default();
        metrics.driver(&Stats::default());
        let mut current = "";
        for line in metrics.text.lines() {
            if let Some(rest) = line.strip_prefix("# HELP ") {
                current = rest.split(' ').next().unwrap();
                assert_eq!(metrics.text.matches(&format!("# TYPE {current} ")).count(), 1);
            } else if !line.starts_with("# TYPE ") {
                assert!(line.starts_with(current), "{line}");
                let value = line.rsplit(' ').next().unwrap();
                assert!(value.parse::<f64>().is_ok(), "{line}");
            }
        }
    }
}
