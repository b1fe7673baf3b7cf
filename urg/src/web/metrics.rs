//! `/metrics`: statistics of the sensors and their streams, as Prometheus text 0.0.4.

use std::fmt::{Display, Write};

use hyper::StatusCode;
use tokio_scip::{Sensor, Stats};

use super::Site;
use super::hub::Hub;
use super::response::{Response, whole};

const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

pub(super) fn metrics(site: &Site) -> Response {
    let mut families = Families::default();
    let viewers = ("urg_viewers", "gauge", "Open streams of scans");
    families.add(viewers, "", &[], site.viewers());
    for source in &site.sources {
        let hub = source.hub();
        let sensor = hub.and_then(Hub::sensor);
        families.sensor(
            source.name(),
            source.health().why.is_none(),
            sensor.and_then(|sensor| sensor.freshness().age()).map(|age| age.as_secs_f64()),
            hub.and_then(Hub::jitter).map(|jitter| jitter.deviation),
            sensor.map(Sensor::stats).as_ref(),
        );
    }
    whole(StatusCode::OK, CONTENT_TYPE, families.text())
}

/// Metrics by name, each with the lines of its samples: the format requires them to be adjacent.
#[derive(Default)]
pub(super) struct Families(Vec<(&'static str, String)>);

impl Families {
    /// Adds a sample of the metric `(name, kind, help)`. `suffix` extends the name, as in a
    /// summary. No help, label or value needs escapes.
    pub(super) fn add(
        &mut self,
        (name, kind, help): (&'static str, &str, &str),
        suffix: &str,
        labels: &[String],
        value: impl Display,
    ) {
        if !self.0.iter().any(|(other, _)| *other == name) {
            self.0.push((name, format!("# HELP {name} {help}\n# TYPE {name} {kind}\n")));
        }
        let labels = match labels {
            [] => String::new(),
            labels => format!("{{{}}}", labels.join(",")),
        };
        if let Some((_, text)) = self.0.iter_mut().find(|(other, _)| *other == name) {
            // Writing to a `String` is infallible.
            let _ = writeln!(text, "{name}{suffix}{labels} {value}");
        }
    }

    /// Adds the samples of a sensor. It has no statistics before its driver runs.
    fn sensor(
        &mut self,
        name: Option<&str>,
        is_up: bool,
        age: Option<f64>,
        jitter: Option<f64>,
        stats: Option<&Stats>,
    ) {
        let own: Vec<_> = name.map(|name| format!("sensor=\"{name}\"")).into_iter().collect();
        self.add(("urg_up", "gauge", "1 while scans arrive, else 0"), "", &own, u8::from(is_up));
        if let Some(age) = age {
            self.add(("urg_scan_age_seconds", "gauge", "Age of the latest scan"), "", &own, age);
        }
        if let Some(jitter) = jitter {
            let help = "Standard deviation of the interval between scans over ten seconds";
            self.add(("urg_scan_jitter_seconds", "gauge", help), "", &own, jitter);
        }
        if let Some(stats) = stats {
            self.stats(&own, stats);
        }
    }

    pub(super) fn text(self) -> String {
        self.0.into_iter().map(|(_, text)| text).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_metric_has_help_and_type_once() {
        let mut families = Families::default();
        let mut stats = Stats::default();
        // As after a first reply.
        stats.reply_latency.count = 1;
        for name in ["front", "rear"] {
            families.sensor(Some(name), false, None, None, Some(&stats));
        }
        let text = families.text();
        for line in [
            "urg_poll_failures_total{sensor=\"rear\",cause=\"timeout\"} 0\n",
            "urg_up{sensor=\"front\"} 0\n",
            "# TYPE urg_reply_latency_seconds summary\n",
            "urg_reply_latency_seconds_count{sensor=\"rear\"} 1\n",
        ] {
            assert!(text.contains(line), "{line} in {text}");
        }
        let mut current = "";
        for line in text.lines() {
            if let Some(rest) = line.strip_prefix("# HELP ") {
                current = rest.split(' ').next().unwrap();
                assert_eq!(text.matches(&format!("# TYPE {current} ")).count(), 1);
            } else if !line.starts_with("# TYPE ") {
                assert!(line.starts_with(current), "{line}");
                assert!(line.rsplit(' ').next().unwrap().parse::<f64>().is_ok(), "{line}");
            }
        }
    }
}
