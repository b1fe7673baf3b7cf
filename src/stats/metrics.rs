//! [`Metric`]: figures of [`Stats`] in the form that monitoring systems want.

use std::borrow::Cow;
use std::fmt;

use super::{ScheduleStats, Stats};

/// Figure of [`Stats::metrics`]. Its name and labels are the same as in `/metrics` of `urg serve`,
/// and follow the conventions of Prometheus: base units, and `_total` at the end of counters.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Metric {
    /// Name, such as `urg_scans_total`. Figures of the same name differ only in suffix, labels and
    /// value, and follow each other.
    pub name: &'static str,
    /// What a sample of a [`Summary`](MetricKind::Summary) adds to the name: nothing for its
    /// quantiles, `_sum` and `_count` for the rest. Nothing for the other kinds.
    pub suffix: &'static str,
    /// How the figure changes.
    pub kind: MetricKind,
    /// Description: one line without a backslash.
    pub help: &'static str,
    /// Names and values of labels, such as `cause` and `timeout`, without quotes, backslashes and
    /// line feeds.
    pub labels: Vec<(&'static str, Cow<'static, str>)>,
    /// Value.
    pub value: f64,
}

/// How a [`Metric`] changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum MetricKind {
    /// Only grows, from 0 when the driver starts.
    Counter,
    /// Rises and falls.
    Gauge,
    /// Distribution since the driver started: its quantiles, and its sum and count, which only
    /// grow.
    Summary,
}

/// Writes the word for a `# TYPE` line: `counter`, `gauge` or `summary`.
impl fmt::Display for MetricKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Counter => "counter",
            Self::Gauge => "gauge",
            Self::Summary => "summary",
        })
    }
}

impl Stats {
    /// Iterates over all figures, for an exporter. Leaves out unknown figures: latencies before the
    /// first reply, and the rate of a stream in its first three seconds.
    ///
    /// In Prometheus' text format, without a library:
    ///
    /// ```
    /// # let stats = tokio_scip::Stats::default();
    /// let mut text = String::new();
    /// let mut name = "";
    /// for metric in stats.metrics() {
    ///     if name != metric.name {
    ///         name = metric.name;
    ///         text += &format!("# HELP {name} {}\n# TYPE {name} {}\n", metric.help, metric.kind);
    ///     }
    ///     let labels = metric.labels.iter().map(|(name, value)| format!("{name}=\"{value}\""));
    ///     let (suffix, labels) = (metric.suffix, labels.collect::<Vec<_>>().join(","));
    ///     text += &format!("{name}{suffix}{{{labels}}} {}\n", metric.value);
    /// }
    /// assert!(text.contains("# TYPE urg_scans_total counter\nurg_scans_total{} 0\n"));
    /// assert!(text.contains("urg_poll_failures_total{cause=\"timeout\"} 0\n"));
    /// ```
    pub fn metrics(&self) -> impl Iterator<Item = Metric> + use<> {
        // Without `..`, so that a new field cannot be forgotten.
        let Self {
            polls,
            scans,
            repeats,
            timeouts,
            refused,
            malformed,
            fences,
            fence_timeouts,
            disconnects,
            reconnects,
            bytes_skipped,
            missed,
            polls_skipped,
            baud_rate_disproved,
            reply_latency: latency,
            motor,
            schedules,
        } = self;
        let count =
            |name, help, value: u64| Metric::new(name, MetricKind::Counter, help, value as f64);
        let gauge = |name, help, value| Metric::new(name, MetricKind::Gauge, help, value);
        let mut all = vec![
            count("urg_polls_total", "Polls sent to the sensor", *polls),
            count("urg_scans_total", "Scans received from the sensor", *scans),
            count("urg_repeats_total", "Scans equal to the one before", *repeats),
        ];
        let failed = malformed.total();
        for (cause, value) in [("timeout", *timeouts), ("malformed", failed), ("refused", *refused)]
        {
            let help = "Commands without a good reply, by cause";
            all.push(count("urg_poll_failures_total", help, value).label("cause", cause));
        }
        for (fault, value) in [
            ("echo", malformed.echo),
            ("status", malformed.status),
            ("length", malformed.length),
            ("character", malformed.character),
            ("overlong", malformed.overlong),
        ] {
            let help = "Malformed replies, by fault";
            all.push(count("urg_malformed_total", help, value).label("fault", fault));
        }
        let disproved = "1 if replies came faster than the baud rate of the port carries, else 0";
        all.extend([
            count("urg_fences_total", "Fences sent", *fences),
            count("urg_fence_timeouts_total", "Fences without an answer", *fence_timeouts),
            count("urg_disconnects_total", "Losses of the link", *disconnects),
            count("urg_reconnects_total", "Returns of the link", *reconnects),
            count("urg_missed_total", "Scans that slow consumers missed", *missed),
            count("urg_polls_skipped_total", "Polls that were not sent in time", *polls_skipped),
            count("urg_skipped_bytes_total", "Bytes that were in no reply", *bytes_skipped),
            gauge("urg_baud_rate_disproved", disproved, u8::from(*baud_rate_disproved).into()),
        ]);
        if latency.count > 0 {
            let summary = |suffix, value| {
                let help = "Time from a poll to its whole reply";
                let kind = MetricKind::Summary;
                Metric { suffix, ..Metric::new("urg_reply_latency_seconds", kind, help, value) }
            };
            for (label, q) in [("0.5", 0.5), ("0.9", 0.9), ("0.99", 0.99), ("1", 1.0)] {
                let metric = summary("", latency.quantile(q).as_secs_f64());
                all.push(metric.label("quantile", label));
            }
            all.push(summary("_sum", latency.total.as_secs_f64()));
            all.push(summary("_count", latency.count as f64));
        }
        if let Some(motor) = motor {
            let help = "Measured time of a revolution of the motor";
            let revolution = motor.revolution.as_secs_f64();
            all.push(gauge("urg_motor_revolution_seconds", help, revolution));
            let help = "Jumps of the motor's phase since the link was found";
            all.push(gauge("urg_motor_jumps", help, motor.jumps as f64));
        }
        for ScheduleStats { window, rate, reached, .. } in schedules {
            let help = "Scans a second over some seconds";
            let metric = reached.map(|reached| gauge("urg_scan_rate_hertz", help, reached));
            all.extend(metric.map(|metric| {
                metric.label("window", window.to_string()).label("rate", rate.to_string())
            }));
        }
        all.into_iter()
    }
}

impl Metric {
    fn new(name: &'static str, kind: MetricKind, help: &'static str, value: f64) -> Self {
        Self { name, suffix: "", kind, help, labels: Vec::new(), value }
    }

    fn label(mut self, name: &'static str, value: impl Into<Cow<'static, str>>) -> Self {
        self.labels.push((name, value.into()));
        self
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};
    use std::time::Duration;

    use super::super::MalformedCounts;
    use super::*;
    use crate::{Rate, Window};

    #[test]
    fn each_figure_has_a_name_and_labels() {
        let malformed = MalformedCounts { echo: 1, ..MalformedCounts::default() };
        let mut stats = Stats { scans: 7, malformed, ..Stats::default() };
        stats.reply_latency.add(Duration::from_millis(250));
        let keyed = stats.metrics().map(|metric| {
            ((format!("{}{}", metric.name, metric.suffix), metric.labels), metric.value)
        });
        let metrics: BTreeMap<_, _> = keyed.collect();
        assert_eq!(metrics.len(), stats.metrics().count());
        let value = |name: &str, labels: &[(&'static str, &'static str)]| {
            let labels = labels.iter().map(|(name, value)| (*name, Cow::from(*value))).collect();
            metrics.get(&(name.to_owned(), labels)).copied()
        };
        assert_eq!(value("urg_scans_total", &[]), Some(7.0));
        assert_eq!(value("urg_malformed_total", &[("fault", "echo")]), Some(1.0));
        assert_eq!(value("urg_poll_failures_total", &[("cause", "malformed")]), Some(1.0));
        assert_eq!(value("urg_reply_latency_seconds", &[("quantile", "0.5")]), Some(0.25));
        assert_eq!(value("urg_reply_latency_seconds_sum", &[]), Some(0.25));
        assert_eq!(value("urg_reply_latency_seconds_count", &[]), Some(1.0));
    }

    #[test]
    fn what_is_not_known_is_left_out() {
        let schedule = |reached| ScheduleStats {
            window: Window::FULL,
            rate: Rate::hz(10.0),
            reached,
            failed: 0,
            shortfall: None,
        };
        let mut stats = Stats { schedules: vec![schedule(None)], ..Stats::default() };
        let names: BTreeSet<_> = stats.metrics().map(|metric| metric.name).collect();
        assert!(names.contains("urg_scans_total"));
        assert!(
            !names.contains("urg_scan_rate_hertz") && !names.contains("urg_reply_latency_seconds")
        );
        stats.schedules = vec![schedule(Some(0.0))];
        let rate = stats.metrics().find(|metric| metric.name == "urg_scan_rate_hertz").unwrap();
        let labels = vec![("window", "steps 0..=768".into()), ("rate", "10 Hz".into())];
        assert_eq!((rate.value, rate.labels), (0.0, labels));
    }

    #[test]
    fn figures_of_one_name_stay_together() {
        let mut stats = Stats::default();
        stats.reply_latency.add(Duration::from_millis(250));
        let mut seen: Vec<Metric> = Vec::new();
        for metric in stats.metrics() {
            if let Some(first) = seen.iter().find(|first| first.name == metric.name) {
                assert_eq!(seen.last().unwrap().name, metric.name);
                assert_eq!((first.kind, first.help), (metric.kind, metric.help));
            }
            // Prometheus reserves both ends and the label for a summary.
            let is_total = metric.name.ends_with("_total");
            assert_eq!(is_total, metric.kind == MetricKind::Counter, "{metric:?}");
            assert!(!metric.name.ends_with("_sum") && !metric.name.ends_with("_count"));
            let is_quantile = metric.labels.iter().any(|(name, _)| *name == "quantile");
            let is_summary = is_quantile || !metric.suffix.is_empty();
            assert_eq!(is_summary, metric.kind == MetricKind::Summary, "{metric:?}");
            seen.push(metric);
        }
    }
}
