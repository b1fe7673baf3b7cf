//! [`Stats`]: counters of everything that the driver does, and their names.

use crate::protocol::{Malformed, ReplyError};
use crate::{LatencyStats, Rate, Window};

/// Counters since the driver started: a copy, returned by
/// [`Sensor::stats`](crate::Sensor::stats). No count ever goes back, also when the link
/// is lost. As data (feature `serde`) it has its fields by name;
/// [`metrics`](Self::metrics) iterates over them.
#[derive(Debug, Clone, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct Stats {
    /// `G`s sent for streams and single scans.
    pub polls: u64,
    /// Whole scans.
    pub scans: u64,
    /// Scans equal to the one before.
    pub repeats: u64,
    /// Commands that were not answered in time, fences not counted.
    pub timeouts: u64,
    /// Commands that the sensor refused.
    pub refused: u64,
    /// Malformed replies, by fault.
    pub malformed: MalformedCounts,
    /// Fences sent: single-step `G`s that prove that no older reply is on its way.
    pub fences: u64,
    /// Fences that were not answered in time.
    pub fence_timeouts: u64,
    /// Losses of the link.
    pub disconnects: u64,
    /// Times that a sensor was found again, on the same port or a new one.
    pub reconnects: u64,
    /// Bytes that belonged to no reply of the driver's commands.
    pub bytes_skipped: u64,
    /// Scans that streams missed because their consumers were slow.
    pub missed: u64,
    /// Polls that were not sent because the line was busy from the time they were due
    /// until the next one was.
    pub polls_skipped: u64,
    /// True if a reply came faster than the baud rate of the port can carry, so that the
    /// port has another one or none that matters: a pseudo-terminal, a sensor on USB, a
    /// serial server. Limits computed from the baud rate do not hold then.
    pub baud_rate_outrun: bool,
    /// Times from a `G` to the last byte of its reply.
    pub reply_latency: LatencyStats,
    /// The windows that are polled now, each with its rate.
    pub schedules: Vec<ScheduleStats>,
}

impl Stats {
    /// Iterates over all counters and latencies with their names, for a metrics
    /// exporter.
    ///
    /// The names are those of the fields, such as `scans` and `malformed_echo`;
    /// latencies are in seconds, such as `reply_latency_p99_seconds`. All but the
    /// latencies are counters, which only grow. [`schedules`](Self::schedules) are left
    /// out: they have no fixed names.
    ///
    /// ```
    /// # let stats = tokio_scip::Stats::default();
    /// for (name, value) in stats.metrics() {
    ///     println!("urg_{name} {value}");
    /// }
    /// # assert!(stats.metrics().any(|(name, _)| name == "malformed_echo"));
    /// ```
    pub fn metrics(&self) -> impl Iterator<Item = (&'static str, f64)> + use<> {
        // Without `..`, so that a new field cannot be forgotten.
        let Self {
            polls,
            scans,
            repeats,
            timeouts,
            refused,
            malformed: MalformedCounts { echo, status, length, character, overlong },
            fences,
            fence_timeouts,
            disconnects,
            reconnects,
            bytes_skipped,
            missed,
            polls_skipped,
            baud_rate_outrun,
            reply_latency: latency,
            schedules: _,
        } = self;
        let counters = [
            ("polls", *polls),
            ("scans", *scans),
            ("repeats", *repeats),
            ("timeouts", *timeouts),
            ("refused", *refused),
            ("malformed_echo", *echo),
            ("malformed_status", *status),
            ("malformed_length", *length),
            ("malformed_character", *character),
            ("malformed_overlong", *overlong),
            ("fences", *fences),
            ("fence_timeouts", *fence_timeouts),
            ("disconnects", *disconnects),
            ("reconnects", *reconnects),
            ("bytes_skipped", *bytes_skipped),
            ("missed", *missed),
            ("polls_skipped", *polls_skipped),
            ("baud_rate_outrun", u64::from(*baud_rate_outrun)),
            ("reply_latency_count", latency.count),
        ];
        let latencies = [
            ("reply_latency_total_seconds", latency.total),
            ("reply_latency_last_seconds", latency.last),
            ("reply_latency_min_seconds", latency.min),
            ("reply_latency_max_seconds", latency.max),
            ("reply_latency_p50_seconds", latency.quantile(0.5)),
            ("reply_latency_p90_seconds", latency.quantile(0.9)),
            ("reply_latency_p99_seconds", latency.quantile(0.99)),
        ];
        let latencies = latencies.map(|(name, time)| (name, time.as_secs_f64()));
        counters.map(|(name, count)| (name, count as f64)).into_iter().chain(latencies)
    }
}

/// Malformed replies, by fault.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct MalformedCounts {
    /// The echo was that of another command, or damaged.
    pub echo: u64,
    /// The status was missing or not one character.
    pub status: u64,
    /// A line had the wrong length, or there was too little or too much data.
    pub length: u64,
    /// A character carried no 6-bit number.
    pub character: u64,
    /// The reply did not end.
    pub overlong: u64,
}

impl MalformedCounts {
    /// Returns the number of all malformed replies.
    pub fn total(&self) -> u64 {
        self.echo + self.status + self.length + self.character + self.overlong
    }

    pub(crate) fn count(&mut self, error: &ReplyError) {
        let counter = match error {
            ReplyError::Foreign { .. } => &mut self.echo,
            ReplyError::Scip2 { .. } => &mut self.status,
            ReplyError::Malformed(malformed) => match malformed {
                Malformed::Echo { .. } | Malformed::Early { .. } => &mut self.echo,
                Malformed::NoStatus | Malformed::Status { .. } => &mut self.status,
                Malformed::Character { .. } => &mut self.character,
                Malformed::Overlong { .. } | Malformed::NotRaw => &mut self.overlong,
                _ => &mut self.length,
            },
        };
        *counter += 1;
    }
}

/// The requested and the reached rate of one schedule.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct ScheduleStats {
    /// The window that is polled.
    pub window: Window,
    /// The requested rate in scans a second, or `None` for [`Rate::MAX`].
    pub asked: Option<f64>,
    /// The scans a second that came, over the last three seconds or so that they were
    /// polled; 0 before that, and while the link is lost.
    pub reached: f64,
    /// The polls of those seconds that failed: their replies were lost, malformed or
    /// refused. While there are some, `reached` is not the limit of the line and the
    /// sensor.
    pub failed: u32,
}

impl ScheduleStats {
    pub(crate) fn new(window: Window, rate: Rate, reached: f64, failed: u32) -> Self {
        let asked = rate.period().map(|period| 1.0 / period.as_secs_f64());
        Self { window, asked, reached, failed }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::time::Duration;

    use super::*;

    #[test]
    fn every_counter_has_a_name_of_its_own_and_its_value() {
        let malformed = MalformedCounts { echo: 1, ..MalformedCounts::default() };
        let mut stats = Stats { scans: 7, malformed, ..Stats::default() };
        stats.reply_latency.add(Duration::from_millis(250));
        let metrics: BTreeMap<_, _> = stats.metrics().collect();
        assert_eq!(metrics.len(), stats.metrics().count());
        for (name, value) in [
            ("scans", 7.0),
            ("malformed_echo", 1.0),
            ("reply_latency_count", 1.0),
            ("reply_latency_p50_seconds", 0.25),
            ("refused", 0.0),
        ] {
            assert_eq!(metrics.get(name), Some(&value), "{name}");
        }
    }
}
