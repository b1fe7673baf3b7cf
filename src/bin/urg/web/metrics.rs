//! `/metrics`: the figures of sensor and stream in Prometheus' text format
//! (version 0.0.4), so that a monitor can keep and compare them.

use std::fmt::{Display, Write};

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use tokio_scip::Stats;

use super::app::App;
use super::source::Source;

const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

/// Answers `/metrics`.
pub(super) async fn metrics(State(app): State<App>) -> Response {
    let sensors: Vec<_> = app.sources.iter().map(SensorFigures::of).collect();
    let mut text = Metrics::default();
    text.metric("urg_viewers", "gauge", "Open streams of scans").sample("", "", app.viewers.len());
    text.sensors(&sensors);
    ([(header::CONTENT_TYPE, CONTENT_TYPE)], text.text).into_response()
}

/// The figures of one sensor, with its label.
#[derive(Debug, Default)]
struct SensorFigures {
    /// `sensor="front"`; empty for a sensor without a name. A name needs no escapes.
    label: String,
    is_up: bool,
    age: Option<f64>,
    jitter: Option<f64>,
    stats: Stats,
}

impl SensorFigures {
    fn of(source: &Source) -> Self {
        let live = source.hub().and_then(|hub| hub.live());
        let sensor = live.as_ref().map(|live| &live.sensor);
        Self {
            label: source
                .name
                .as_deref()
                .map(|name| format!("sensor=\"{name}\""))
                .unwrap_or_default(),
            is_up: source.health().why.is_none(),
            age: sensor.and_then(|sensor| sensor.freshness().age()).map(|age| age.as_secs_f64()),
            jitter: source.hub().and_then(|hub| hub.jitter()).map(|jitter| jitter.deviation),
            stats: sensor.map(|sensor| sensor.stats()).unwrap_or_default(),
        }
    }
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

    /// Writes a sample of the metric. `end` is the end of its name.
    fn sample(&mut self, end: &str, labels: &str, value: impl Display) -> &mut Self {
        let name = self.name;
        let _ = match labels {
            "" => writeln!(self.text, "{name}{end} {value}"),
            labels => writeln!(self.text, "{name}{end}{{{labels}}} {value}"),
        };
        self
    }

    /// Writes a metric with a sample for each sensor that has one.
    fn each<T: Display>(
        &mut self,
        (name, kind, help): (&'static str, &str, &str),
        sensors: &[SensorFigures],
        value: impl Fn(&SensorFigures) -> Option<T>,
    ) {
        self.metric(name, kind, help);
        for sensor in sensors {
            if let Some(value) = value(sensor) {
                self.sample("", &sensor.label, value);
            }
        }
    }

    fn sensors(&mut self, sensors: &[SensorFigures]) {
        type Count = fn(&Stats) -> u64;
        self.each(("urg_up", "gauge", "1 while scans arrive, else 0"), sensors, |sensor| {
            Some(u8::from(sensor.is_up))
        });
        self.each(("urg_scan_age_seconds", "gauge", "Age of the latest scan"), sensors, |sensor| {
            sensor.age
        });
        let help = "Standard deviation of the interval between scans over ten seconds";
        self.each(("urg_scan_jitter_seconds", "gauge", help), sensors, |sensor| sensor.jitter);
        let help = "Scans a second over some seconds";
        self.each(("urg_scan_rate_hertz", "gauge", help), sensors, |sensor| {
            sensor.stats.schedules.first().map(|schedule| schedule.reached)
        });
        let counters: [(&str, &str, Count); 5] = [
            ("urg_polls_total", "Polls sent to the sensor", |stats| stats.polls),
            ("urg_scans_total", "Scans received from the sensor", |stats| stats.scans),
            ("urg_polls_skipped_total", "Polls that were not sent in time", |stats| {
                stats.polls_skipped
            }),
            ("urg_disconnects_total", "Losses of the link", |stats| stats.disconnects),
            ("urg_reconnects_total", "Returns of the link", |stats| stats.reconnects),
        ];
        for (name, help, count) in counters {
            self.each((name, "counter", help), sensors, |sensor| Some(count(&sensor.stats)));
        }
        let causes: [(&str, Count); 3] = [
            ("timeout", |stats| stats.timeouts),
            ("malformed", |stats| stats.malformed.total()),
            ("refused", |stats| stats.refused),
        ];
        self.metric("urg_poll_failures_total", "counter", "Polls without a scan, by cause");
        for sensor in sensors {
            let comma = if sensor.label.is_empty() { "" } else { "," };
            for (cause, count) in causes {
                let labels = format!("{}{comma}cause=\"{cause}\"", sensor.label);
                self.sample("", &labels, count(&sensor.stats));
            }
        }
        self.metric("urg_reply_latency_seconds", "summary", "Time from a command to its reply");
        for SensorFigures { label, stats, .. } in sensors {
            let latency = stats.reply_latency;
            self.sample("_sum", label, latency.total.as_secs_f64()).sample(
                "_count",
                label,
                latency.count,
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_metric_has_its_help_and_type_once_and_before_its_samples() {
        let mut metrics = Metrics::default();
        let sensor = |label: &str| SensorFigures { label: label.to_owned(), ..Default::default() };
        metrics.sensors(&[sensor("sensor=\"front\""), sensor("sensor=\"rear\"")]);
        let losses = "urg_poll_failures_total{sensor=\"rear\",cause=\"timeout\"} 0\n";
        assert!(metrics.text.contains(losses), "{}", metrics.text);
        assert!(metrics.text.contains("urg_up{sensor=\"front\"} 0\n"), "{}", metrics.text);
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
