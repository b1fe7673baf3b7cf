//! Measures a stream of scans and judges it by the limits below.

use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::protocol::Protocol;
use tokio_scip::stats::ScheduleStats;
use tokio_scip::{Error, Geometry, Rate, Scan, Sensor, Stats, Window};

use super::finding::{Finding, Verdict};
use crate::format::{counted, listed, pace};
use crate::stream::jitter::Jitter;
use crate::stream::rate_watch::schedule;

/// Maximum fraction of polls without a scan. Any smaller loss is weak.
const MAX_LOSS: f64 = 0.05;
/// Fraction of the rate that the link can carry. A lower rate fails the check.
const FAILED_RATE: f64 = 0.5;
/// Maximum latency or interval, in revolutions of the motor. A good sensor answers within one or two.
const MAX_REVOLUTIONS: f64 = 2.5;
/// Maximum mean lateness in milliseconds: five USB frames. Later scans are weak.
const MAX_LATENESS_MS: f64 = 5.0;

#[derive(Debug)]
pub(super) struct Measured {
    geometry: Geometry,
    /// Time that a scan takes on the line. Zero without one.
    wire_time: Duration,
    /// Rate of the motor in scans a second.
    asked: f64,
    scans: Vec<Seen>,
    /// Why the rate is not reached, as the driver explains it.
    shortfall: Option<String>,
    /// Statistics of the driver before and after the measurement.
    before: Stats,
    after: Stats,
}

#[derive(Debug)]
struct Seen {
    requested_at: Instant,
    received_at: Instant,
    lateness: Option<Duration>,
    points: usize,
    distances: usize,
}

impl Measured {
    pub(super) async fn over(
        sensor: &Sensor,
        window: Window,
        duration: Duration,
    ) -> Result<Self, Error> {
        let (version, geometry) = (sensor.version().await?, sensor.geometry().await?);
        let window = window.resolve(&geometry).unwrap_or(window);
        let rpm = version.specification.and_then(|specification| specification.motor_speed);
        let revolution = geometry.revolution().as_secs_f64();
        let asked = rpm.map_or(1.0 / revolution, |rpm| f64::from(rpm) / 60.0);
        let before = sensor.stats();
        let link_rate = sensor.watch_state().get().baud_rate();
        let polled = match geometry.protocol() {
            // Follows the sensor's clock: each scan arrives once, unless the line is too slow.
            Protocol::Scip2 if link_rate.is_none() => Rate::UNLIMITED,
            _ => Rate::hz(asked),
        };
        let mut stream = sensor.scans(window, polled).await?;
        let mut scans = Vec::new();
        let watch = async {
            // The driver counts the errors.
            while let Some(item) = stream.next().await {
                scans.extend(item.iter().map(Seen::from_scan));
            }
        };
        let _ = tokio::time::timeout(duration, watch).await;
        let shortfall = schedule(&sensor.stats(), window).and_then(ScheduleStats::explanation);
        drop(stream);
        // This request waits for the poll in flight, so that `after` counts its outcome.
        let _ = sensor.laser_on().await;
        let after = sensor.stats();
        let baud_rate = link_rate.filter(|_| !after.baud_rate_disproved);
        let wire_time = baud_rate.map(|rate| window.wire_time(rate, geometry.protocol()));
        let wire_time = wire_time.unwrap_or_default();
        Ok(Self { geometry, wire_time, asked, scans, shortfall, before, after })
    }

    pub(super) fn steps(&self) -> Vec<Finding> {
        let polls = self.polls();
        if self.scans.is_empty() {
            return vec![polls];
        }
        vec![polls, self.rate(), self.latency(), self.motor(), self.sight()]
    }

    fn count(&self, counter: impl Fn(&Stats) -> u64) -> u64 {
        counter(&self.after).saturating_sub(counter(&self.before))
    }

    /// Number of scans that did not arrive. In a stream the sensor's clock tells of more than failed.
    fn lost(&self) -> u64 {
        self.failed().max(self.count(|stats| stats.lost))
    }

    /// Number of polls that ended without a scan.
    fn failed(&self) -> u64 {
        self.count(|stats| stats.polls).saturating_sub(self.count(|stats| stats.scans))
    }

    fn polls(&self) -> Finding {
        let (scans, lost) = (self.count(|stats| stats.scans), self.lost());
        let (polls, refused) = (scans + lost, self.count(|stats| stats.refused));
        let disconnects = self.count(|stats| stats.disconnects);
        // The driver counts these of all requests, and of replies that come late.
        let all_timeouts = self.count(|stats| stats.timeouts);
        let all_malformed = self.count(|stats| stats.malformed.total());
        let timeouts = all_timeouts.min(self.failed());
        let malformed = all_malformed.min(self.failed() - timeouts);
        let refusals = refused.min(self.failed() - timeouts - malformed);
        let unexplained = lost - timeouts - malformed - refusals;
        let reasons = listed(&[
            (timeouts, "unanswered in time"),
            (malformed, "malformed"),
            (refusals, "refused"),
            (unexplained.saturating_sub(disconnects), "lost on the way"),
            (all_timeouts + all_malformed - timeouts - malformed, "failed besides the polls"),
            (disconnects, if disconnects == 1 { "lost link" } else { "lost links" }),
        ]);
        let verdict =
            if self.scans.is_empty() || disconnects > 0 || lost as f64 > MAX_LOSS * polls as f64 {
                Verdict::Failed
            } else if lost > 0 || !reasons.is_empty() {
                Verdict::Weak
            } else {
                Verdict::Ok
            };
        let mut text = format!("{scans} of {polls} answered with a whole scan");
        if !reasons.is_empty() {
            // A sensor that mostly refuses is well connected.
            let advice = if refused > polls / 2 { "" } else { "; check cable, plugs and power" };
            text += &format!(": {reasons}{advice}");
        }
        Finding::new("polls", verdict, text)
    }

    fn rate(&self) -> Finding {
        let Some(jitter) = Jitter::from_times(self.scans.iter().map(|seen| seen.received_at))
        else {
            return Finding::weak("rate", "only one scan came: test for longer");
        };
        let (reached, asked) = (1.0 / jitter.mean, self.asked);
        let [min, max, deviation] =
            [jitter.min, jitter.max, jitter.deviation].map(|seconds| seconds * 1000.0);
        let text = format!(
            "{reached:.1} scans a second of {asked:.1}, one every {min:.0} to {max:.0} ms, \
             standard deviation {deviation:.1} ms"
        );
        if Rate::hz(asked).is_reached_by(reached) {
            return Finding::ok("rate", text);
        }
        let carried = 1.0 / self.wire_time.as_secs_f64();
        let has_failed = reached < FAILED_RATE * asked.min(carried);
        let verdict = if has_failed { Verdict::Failed } else { Verdict::Weak };
        let cause = match &self.shortfall {
            Some(explanation) => explanation.clone(),
            None if self.count(|stats| stats.disconnects) > 0 => "the link was lost".to_owned(),
            None if self.lost() > 0 => counted(self.lost(), "poll") + " brought no scan",
            None => match self.turns().filter(|turns| Rate::hz(*turns).is_reached_by(reached)) {
                Some(turns) => format!(
                    "each revolution brought one, and the motor turns at {:.0} rpm in place of {:.0}",
                    turns * 60.0,
                    asked * 60.0
                ),
                None => "some revolutions of the motor brought no scan".to_owned(),
            },
        };
        Finding::new("rate", verdict, format!("{text}: {cause}"))
    }

    fn latency(&self) -> Finding {
        let latency = |seen: &Seen| seen.received_at.saturating_duration_since(seen.requested_at);
        let longest = self.scans.iter().map(latency).max().unwrap_or_default();
        let mean =
            self.scans.iter().map(latency).sum::<Duration>() / self.scans.len().max(1) as u32;
        let [mean, most] = [mean, longest].map(|time| time.as_millis());
        let (name, what) = match self.geometry.protocol() {
            Protocol::Scip1 => ("latency", "a whole scan takes"),
            // A stream is not polled: these times begin with the scan before.
            Protocol::Scip2 => ("interval", "a scan follows another after"),
        };
        let text = format!("{what} {mean} ms, {most} ms at most");
        let turns = self.turns().unwrap_or(self.asked);
        let good = Duration::from_secs_f64(MAX_REVOLUTIONS / turns) + self.wire_time;
        if longest <= good {
            return Finding::ok(name, text);
        }
        Finding::weak(name, format!("{text}: expected at most {} ms", good.as_millis()))
    }

    /// Measured revolutions of the motor in a second.
    fn turns(&self) -> Option<f64> {
        self.after.motor.map(|motor| 1.0 / motor.revolution.as_secs_f64())
    }

    fn motor(&self) -> Finding {
        let lateness: Vec<_> = self.scans.iter().filter_map(|seen| seen.lateness).collect();
        let Some(motor) = self.after.motor.filter(|_| !lateness.is_empty()) else {
            let why = match self.geometry.protocol() {
                Protocol::Scip1 => "only a sensor's own USB port shows it, if scans arrive on time",
                Protocol::Scip2 if self.wire_time.as_secs_f64() * self.asked > 1.0 => {
                    "the line is too slow for a scan of each revolution"
                }
                Protocol::Scip2 => "test for longer",
            };
            return Finding::ok("motor", format!("not known: {why}"));
        };
        let speed = 60.0 / motor.revolution.as_secs_f64();
        let milliseconds = |time: Duration| time.as_secs_f64() * 1000.0;
        let mean = milliseconds(lateness.iter().sum::<Duration>()) / lateness.len() as f64;
        let most = milliseconds(lateness.iter().max().copied().unwrap_or_default());
        let mut text =
            format!("{speed:.2} rpm; scans arrive {mean:.1} ms late, {most:.1} ms at most");
        if let Some(ppm) = motor.clock_drift_ppm {
            text += &format!("; the sensor's clock is {}", pace(ppm.into()));
        }
        if motor.jumps > 0 {
            let jumps = counted(motor.jumps, "time");
            Finding::weak("motor", format!("{text}; it jumped {jumps}: check the power"))
        } else if mean > MAX_LATENESS_MS {
            Finding::weak("motor", format!("{text}: this computer is busy, or its USB is"))
        } else {
            Finding::ok("motor", text)
        }
    }

    fn sight(&self) -> Finding {
        let points = self.scans.iter().map(|seen| seen.points).max().unwrap_or_default();
        let distances = self.scans.iter().map(|seen| seen.distances).sum::<usize>();
        let distances = distances / self.scans.len().max(1);
        let text = format!("{distances} of {points} points have a distance");
        let repeats = self.count(|stats| stats.repeats) as usize;
        let doubt = match distances {
            0 => {
                let farthest = f64::from(*self.geometry.distances().end()) / 1000.0;
                format!(": is the sensor covered, or everything farther away than {farthest:.0} m?")
            }
            _ if self.scans.len() > 5 && repeats + 1 >= self.scans.len() => {
                ", and all scans are equal: does the sensor measure at all?".to_owned()
            }
            _ => return Finding::ok("sight", text),
        };
        Finding::weak("sight", text + &doubt)
    }
}

impl Seen {
    fn from_scan(scan: &Scan) -> Self {
        Self {
            requested_at: scan.times().requested_at,
            received_at: scan.received_at(),
            lateness: scan.times().lateness,
            points: scan.len(),
            distances: scan.points().count(),
        }
    }
}
