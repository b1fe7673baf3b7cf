//! `/metrics`: statistics of the sensors and their streams in the Prometheus text format,
//! version 0.0.4.

use std::fmt::{Display, Write};

use hyper::StatusCode;
use tokio_scip::Stats;
use tokio_scip::stats::Metric;

use super::Site;
use super::hub::Hub;
use super::response::{Response, whole};
use super::source::SiteSource;

const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

pub(super) fn metrics(site: &Site) -> Response {
    let sensors: Vec<_> =
        site.sources.iter().map(|source| SensorFigures::from_source(source)).collect();
    let mut text = Metrics::default();
    text.metric("urg_viewers", "gauge", "Open streams of scans").sample("", site.viewers());
    text.sensors(&sensors);
    whole(StatusCode::OK, CONTENT_TYPE, text.text)
}

#[derive(Debug, Default)]
struct SensorFigures {
    /// `sensor="front"`; empty for a sensor without a name. A name needs no escapes.
    label: String,
    is_up: bool,
    age: Option<f64>,
    jitter: Option<f64>,
    /// `None` before the driver runs.
    stats: Option<Stats>,
}

impl SensorFigures {
    fn from_source(source: &SiteSource) -> Self {
        let sensor = source.hub().and_then(Hub::sensor);
        Self {
            label: source.name().map(|name| format!("sensor=\"{name}\"")).unwrap_or_default(),
            is_up: source.health().why.is_none(),
            age: sensor.and_then(|sensor| sensor.freshness().age()).map(|age| age.as_secs_f64()),
            jitter: source.hub().and_then(Hub::jitter).map(|jitter| jitter.deviation),
            stats: sensor.map(|sensor| sensor.stats()),
        }
    }
}

#[derive(Default)]
struct Metrics {
    text: String,
    name: &'static str,
}

impl Metrics {
    /// Begins a metric. `help` must not contain a backslash or a line feed, because neither
    /// is escaped.
    fn metric(&mut self, name: &'static str, kind: &str, help: &str) -> &mut Self {
        self.name = name;
        // Writing to a `String` is infallible.
        let _ = writeln!(self.text, "# HELP {name} {help}\n# TYPE {name} {kind}");
        self
    }

    fn sample(&mut self, labels: &str, value: impl Display) {
        self.sample_of("", labels, value);
    }

    /// Writes a sample of the metric, whose name has a suffix, as in a summary.
    fn sample_of(&mut self, suffix: &str, labels: &str, value: impl Display) {
        let name = self.name;
        let _ = match labels {
            "" => writeln!(self.text, "{name}{suffix} {value}"),
            labels => writeln!(self.text, "{name}{suffix}{{{labels}}} {value}"),
        };
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
                self.sample(&sensor.label, value);
            }
        }
    }

    fn sensors(&mut self, sensors: &[SensorFigures]) {
        self.each(("urg_up", "gauge", "1 while scans arrive, else 0"), sensors, |sensor| {
            Some(u8::from(sensor.is_up))
        });
        self.each(("urg_scan_age_seconds", "gauge", "Age of the latest scan"), sensors, |sensor| {
            sensor.age
        });
        let help = "Standard deviation of the interval between scans over ten seconds";
        self.each(("urg_scan_jitter_seconds", "gauge", help), sensors, |sensor| sensor.jitter);
        self.driver(sensors);
    }

    /// Writes the metrics of the drivers. The format requires the samples of a metric to be
    /// adjacent, so this groups them first.
    fn driver(&mut self, sensors: &[SensorFigures]) {
        let mut families: Vec<Vec<(String, Metric)>> = Vec::new();
        for SensorFigures { label, stats, .. } in sensors {
            for metric in stats.iter().flat_map(Stats::metrics) {
                let own = metric.labels.iter().map(|(name, value)| format!("{name}=\"{value}\""));
                let labels = Some(label.clone()).filter(|label| !label.is_empty());
                let labels = labels.into_iter().chain(own).collect::<Vec<_>>().join(",");
                let is_name = |(_, first): &(String, Metric)| first.name == metric.name;
                match families.iter_mut().find(|family| family.first().is_some_and(is_name)) {
                    Some(family) => family.push((labels, metric)),
                    None => families.push(vec![(labels, metric)]),
                }
            }
        }
        for family in families {
            if let Some((_, first)) = family.first() {
                self.metric(first.name, &first.kind.to_string(), first.help);
            }
            for (labels, metric) in family {
                self.sample_of(metric.suffix, &labels, metric.value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_metric_has_its_help_and_type_once_and_before_its_samples() {
        let mut metrics = Metrics::default();
        let mut stats = Stats::default();
        // As after a first reply.
        stats.reply_latency.count = 1;
        let sensor = |label: &str| SensorFigures {
            label: label.to_owned(),
            stats: Some(stats.clone()),
            ..Default::default()
        };
        metrics.sensors(&[sensor("sensor=\"front\""), sensor("sensor=\"rear\"")]);
        let losses = "urg_poll_failures_total{sensor=\"rear\",cause=\"timeout\"} 0\n";
        assert!(metrics.text.contains(losses), "{}", metrics.text);
        assert!(metrics.text.contains("urg_up{sensor=\"front\"} 0\n"), "{}", metrics.text);
        let latency = "# TYPE urg_reply_latency_seconds summary\n";
        assert!(metrics.text.contains(latency), "{}", metrics.text);
        let count = "urg_reply_latency_seconds_count{sensor=\"rear\"} 1\n";
        assert!(metrics.text.contains(count), "{}", metrics.text);
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
