//! [`Stats`]: counters of everything that the driver does.

use std::time::Duration;

use crate::protocol::{MalformedError, Protocol, ReplyError};
use crate::stats::LatencyStats;
use crate::{BaudRate, Rate, Window};

/// Counters since the driver started: a copy, from [`Sensor::stats`](crate::Sensor::stats). Counts
/// never decrease, not even when the link is lost. Serialises (feature `serde`) as its fields.
#[derive(Debug, Clone, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct Stats {
    /// Scans asked for, by streams and singly: by `G` or `GD`, or sent in a stream of SCIP 2.
    pub polls: u64,
    /// Scans received.
    pub scans: u64,
    /// Scans with the same values as the previous one.
    pub repeats: u64,
    /// Commands, other than fences, that the sensor did not answer in time.
    pub timeouts: u64,
    /// Commands that the sensor refused.
    pub refused: u64,
    /// Malformed replies, by fault.
    pub malformed: MalformedCounts,
    /// Fences sent in SCIP 1.1: single-step `G`s that prove that no older reply is on its way.
    pub fences: u64,
    /// Fences that the sensor did not answer in time.
    pub fence_timeouts: u64,
    /// Losses of the link.
    pub disconnects: u64,
    /// Number of times a sensor was found again, on the same port or a new one.
    pub reconnects: u64,
    /// Bytes received that were not part of a reply to the driver's commands.
    pub bytes_skipped: u64,
    /// Scans of a stream in SCIP 2 that did not arrive whole. The gaps in the sensor's clock tell.
    pub lost: u64,
    /// Scans that streams missed because their consumers were slow.
    pub missed: u64,
    /// Polls that were never sent, because the line or the host was busy until the next poll
    /// was due. Excludes polls that fell due without a link.
    pub polls_skipped: u64,
    /// True if a reply arrived faster than the baud rate of the port allows, since the link was
    /// found or the baud rate changed. The port then uses another baud rate, or ignores it, as a
    /// pseudo-terminal, a sensor on USB and a serial server do: ignore limits computed from it.
    pub baud_rate_disproved: bool,
    /// Times from a `G` to the last byte of its reply, and in a stream of SCIP 2 from scan to scan.
    pub reply_latency: LatencyStats,
    /// Motor of the sensor: on its own USB port, or in SCIP 2 in a stream. `None` while too few
    /// replies follow its revolutions, and while the link is lost.
    pub motor: Option<MotorStats>,
    /// Windows that are polled now, each with its rate.
    pub schedules: Vec<ScheduleStats>,
}

/// Malformed replies, by fault.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct MalformedCounts {
    /// Another command was echoed, or a damaged one, or the reply began before its command had left.
    pub echo: u64,
    /// The status is missing, or has the wrong form for the protocol. In SCIP 2 also a missing line.
    pub status: u64,
    /// A line, or the data as a whole, has the wrong length.
    pub length: u64,
    /// A character encodes no 6-bit number.
    pub character: u64,
    /// The reply does not end where it should.
    pub overlong: u64,
    /// A line of a reply of SCIP 2 has the wrong length, a wrong character or a wrong sum.
    pub line: u64,
}

impl MalformedCounts {
    /// Number of all malformed replies.
    pub fn total(&self) -> u64 {
        self.echo + self.status + self.length + self.character + self.overlong + self.line
    }

    pub(crate) fn count(&mut self, error: &ReplyError) {
        let counter = match error {
            ReplyError::Foreign { .. } | ReplyError::MultiEcho { .. } | ReplyError::Uam => {
                &mut self.echo
            }
            ReplyError::Scip1 { .. } | ReplyError::Scip2 { .. } => &mut self.status,
            ReplyError::Malformed(malformed) => match malformed {
                MalformedError::Echo { .. } | MalformedError::Early { .. } => &mut self.echo,
                MalformedError::Scip2 { line: Some(_), .. } => &mut self.line,
                MalformedError::NoStatus
                | MalformedError::Status { .. }
                | MalformedError::Scip2 { line: None, .. } => &mut self.status,
                MalformedError::Character { .. } => &mut self.character,
                MalformedError::Overlong { .. } | MalformedError::NotRaw => &mut self.overlong,
                _ => &mut self.length,
            },
        };
        *counter += 1;
    }
}

/// Motor of the sensor, measured from the arrivals of replies on its own USB port, or in SCIP 2 by
/// the sensor's clock: see [`guide::time`](crate::guide::time).
///
/// As data (feature `serde`) it has `revolution` in seconds, `jumps` and `clock_drift_ppm`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct MotorStats {
    /// Duration of a revolution.
    #[cfg_attr(feature = "serde", serde(serialize_with = "seconds"))]
    pub revolution: Duration,
    /// How often the motor's phase, or in SCIP 2 the sensor's clock, jumped since the link was found.
    pub jumps: u64,
    /// How much faster the sensor's clock runs than this computer's, in parts per million. `None` in
    /// SCIP 1.1, which does not send it.
    pub clock_drift_ppm: Option<i32>,
}

#[cfg(feature = "serde")]
fn seconds<S: serde::Serializer>(time: &Duration, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_f64(time.as_secs_f64())
}

/// Requested and achieved rate of one schedule.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct ScheduleStats {
    /// Window that is polled.
    pub window: Window,
    /// Requested rate.
    pub rate: Rate,
    /// Scans received per second, over about the last three seconds of polling. `None`
    /// before that, and while nothing is polled: the link is lost or searched for, the laser
    /// is switched off, or the driver has ended.
    pub reached: Option<f64>,
    /// Number of polls in those seconds whose replies were lost, malformed or refused. Unless
    /// it is 0, the line and the sensor may be able to carry more than `reached`.
    pub failed: u32,
    /// Why the rate was not reached in those seconds. `None` also if only this computer was too busy.
    pub shortfall: Option<Shortfall>,
    /// Baud rate of the line in those seconds, unless it has none or a reply has disproved it.
    pub baud_rate: Option<BaudRate>,
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(crate) protocol: Protocol,
    /// Duration of a revolution, in seconds.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(crate) revolution: f32,
}

impl ScheduleStats {
    /// Statistics before the first span.
    pub(crate) fn new(window: Window, rate: Rate) -> Self {
        let (reached, shortfall, baud_rate) = (None, None, None);
        let (protocol, revolution) = (Protocol::Scip1, 0.0);
        Self { window, rate, reached, failed: 0, shortfall, baud_rate, protocol, revolution }
    }

    /// Says in a sentence why the rate was not reached and what helps, or `None` without a
    /// [`shortfall`](Self::shortfall).
    pub fn explanation(&self) -> Option<String> {
        Some(match self.shortfall? {
            Shortfall::Line => self.explain_line(self.baud_rate?),
            Shortfall::Sensor => {
                "the sensor answers no faster, mostly once in a revolution of its \
                                  motor. What helps: fewer scans"
                    .to_owned()
            }
            Shortfall::Loss => format!(
                "{} of the last polls brought no scan. What helps: check cable, plugs and power",
                self.failed
            ),
        })
    }

    /// Returns true if a line at this baud rate carries scans of `window` at the wanted rate.
    pub(crate) fn carries(&self, window: &Window, baud_rate: BaudRate) -> bool {
        // A sensor answers once a revolution, if the request comes before its end.
        let took = window.wire_time(baud_rate, self.protocol).as_secs_f64();
        let revolution = f64::from(self.revolution);
        self.rate.is_reached_by(1.0 / (revolution * (took / revolution / 0.95).ceil()))
    }

    fn explain_line(&self, baud_rate: BaudRate) -> String {
        let window = self.window;
        let cluster = (window.cluster_count() + 1..=99).find(|count| {
            let clustered = window.with_cluster_count(*count);
            clustered.is_ok_and(|clustered| self.carries(&clustered, baud_rate))
        });
        let mut faster = BaudRate::ALL.into_iter().filter(|faster| *faster > baud_rate);
        let faster = faster.find(|faster| self.carries(&window, *faster));
        let wire_time = window.wire_time(baud_rate, self.protocol);
        let mut text = format!("a scan takes {} ms at {baud_rate} baud", wire_time.as_millis());
        // Longest time per scan of a stream that is alone on the line. A poll may wait for two slow
        // revolutions, and the last scan may come just too late to be counted.
        let alone = 1.2 * wire_time.as_secs_f64() + 0.3;
        if self.reached.is_some_and(|reached| reached * alone < 1.0) {
            text.push_str(", and other polls share the line");
        }
        text.push_str(". What helps: fewer scans or steps");
        text.extend(cluster.map(|count| format!(", clusters of {count}")));
        text.extend(faster.map(|faster| format!(", {faster} baud")));
        text
    }
}

/// Why fewer than 95 % of the requested scans arrive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize), serde(rename_all = "lowercase"))]
#[non_exhaustive]
pub enum Shortfall {
    /// The line is too slow: fewer steps or a higher baud rate help.
    Line,
    /// The sensor answers no faster, mostly once in a revolution of its motor.
    Sensor,
    /// Polls failed.
    Loss,
}
