//! The self-test of a sensor: its steps, and the limits of a good, a weak and a
//! failed one.

use std::fmt::{self, Write};
use std::time::Duration;

use tokio::time::Instant;

use tokio_scip::{BaudRate, Error, Rate, Scan, Sensor, State, Stats, Window};

use crate::failure::chain;
use crate::stream::rate_watch::{ENOUGH, sufficient_baud_rate};
use crate::stream::wire_speed;

/// A greater part of the polls without a scan is a failure, a smaller one weak.
const MAX_LOSS: f64 = 0.05;
/// Below this part of the rate that the link can carry, the rate is a failure.
const FAILED_RATE: f64 = 0.5;
/// A sensor answers within one revolution of its motor, or two.
const MAX_REVOLUTIONS: f64 = 2.5;

/// The outcome of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Verdict {
    Ok,
    Weak,
    Failed,
}

/// A step and its verdict.
#[derive(Debug, Clone)]
pub(crate) struct Step {
    pub(crate) name: &'static str,
    pub(crate) verdict: Verdict,
    /// The findings, and the reason if they are not good.
    text: String,
}

impl Step {
    pub(crate) fn new(name: &'static str, verdict: Verdict, text: impl Into<String>) -> Self {
        Self { name, verdict, text: text.into() }
    }

    pub(crate) fn failed(name: &'static str, error: &Error) -> Self {
        Self::new(name, Verdict::Failed, chain(error))
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verdict = match self.verdict {
            Verdict::Ok => "ok",
            Verdict::Weak => "weak",
            Verdict::Failed => "FAILED",
        };
        write!(f, "{verdict:<7} {:<8} {}", self.name, self.text)
    }
}

/// Reports that the sensor was found, `after` so long.
pub(crate) fn link(sensor: &Sensor, after: Duration) -> Step {
    let place = match baud_rate(sensor) {
        Some(rate) => format!("at {rate} baud"),
        None => "on USB".to_owned(),
    };
    Step::new("link", Verdict::Ok, format!("found {place} after {:.1} s", after.as_secs_f64()))
}

/// Asks for the identity of the sensor.
pub(crate) async fn version(sensor: &Sensor) -> Step {
    const NAME: &str = "version";
    let version = match sensor.version().await {
        Ok(version) => version,
        Err(error) => return Step::failed(NAME, &error),
    };
    let who = format!("{} {}, {}", version.product, version.serial_number, version.firmware);
    let status = version.status.as_ref().map(ToString::to_string);
    match status {
        _ if version.product.is_empty() || version.serial_number.is_empty() => {
            Step::new(NAME, Verdict::Weak, format!("product or serial number missing: {who}"))
        }
        Some(status) if !status.contains("Normal") => {
            Step::new(NAME, Verdict::Weak, format!("{who}; its status is {status:?}"))
        }
        _ => Step::new(NAME, Verdict::Ok, who),
    }
}

/// Switches the laser off and on; the driver confirms both.
pub(crate) async fn laser(sensor: &Sensor) -> Step {
    const NAME: &str = "laser";
    for (switched, state) in [(sensor.laser_off().await, "off"), (sensor.laser_on().await, "on")] {
        if let Err(error) = switched {
            let text = format!("cannot be switched {state}: {}", chain(&error));
            return Step::new(NAME, Verdict::Failed, text);
        }
    }
    Step::new(NAME, Verdict::Ok, "goes off and on")
}

/// Streams the window for a while: at the rate of its motor, or at the recorded
/// one.
pub(crate) async fn scans(
    sensor: &Sensor,
    window: Window,
    recorded: Option<Rate>,
    duration: Duration,
) -> Vec<Step> {
    match Measured::over(sensor, window, recorded, duration).await {
        Ok(measured) => measured.steps(),
        Err(error) => vec![Step::failed("polls", &error)],
    }
}

/// A stream, as it was measured.
#[derive(Debug)]
struct Measured {
    window: Window,
    baud_rate: Option<BaudRate>,
    /// The rate asked for, in scans a second.
    asked: f64,
    scans: Vec<Seen>,
    /// A baud rate that replies have disproved; `baud_rate` is `None` then.
    outrun: Option<BaudRate>,
    /// The driver's counters before and after.
    before: Stats,
    after: Stats,
}

/// The measured part of a scan.
#[derive(Debug)]
struct Seen {
    requested_at: Instant,
    received_at: Instant,
    points: usize,
    distances: usize,
}

impl Measured {
    async fn over(
        sensor: &Sensor,
        window: Window,
        recorded: Option<Rate>,
        duration: Duration,
    ) -> Result<Self, Error> {
        let version = sensor.version().await?;
        let rpm = version.specification.and_then(|specification| specification.motor_speed);
        let period = recorded.and_then(Rate::period).map(|period| period.as_secs_f64());
        let asked = period.map_or_else(|| f64::from(rpm.unwrap_or(600)) / 60.0, f64::recip);
        let before = sensor.stats();
        let mut stream = sensor.scans(window, Rate::hz(asked)).await?;
        let link_rate = baud_rate(sensor);
        let (mut scans, mut outrun) = (Vec::new(), None);
        let watch = async {
            // Errors are counted by the driver.
            while let Some(item) = stream.next().await {
                let Ok(scan) = item else { continue };
                let link_rate = link_rate.filter(|rate| wire_speed::outruns(&scan, *rate));
                outrun = outrun.or(link_rate);
                scans.push(Seen::of(&scan));
            }
        };
        let _ = tokio::time::timeout(duration, watch).await;
        drop(stream);
        // Runs after the poll in flight, so that its outcome is counted.
        let _ = sensor.laser_on().await;
        let mut after = sensor.stats();
        if recorded.is_some() && matches!(&*sensor.state().borrow(), State::Closed { .. }) {
            // A replay ends with a poll that has no recorded reply.
            after.polls = after.polls.saturating_sub(1);
            after.disconnects = before.disconnects;
        }
        let baud_rate = link_rate.filter(|_| outrun.is_none());
        Ok(Self { window, baud_rate, asked, scans, outrun, before, after })
    }

    fn steps(&self) -> Vec<Step> {
        let polls = self.polls();
        if self.scans.is_empty() {
            return vec![polls];
        }
        vec![polls, self.rate(), self.latency(), self.sight()]
    }

    fn count(&self, counter: impl Fn(&Stats) -> u64) -> u64 {
        counter(&self.after).saturating_sub(counter(&self.before))
    }

    /// The number of polls without a scan.
    fn lost(&self) -> u64 {
        self.count(|stats| stats.polls).saturating_sub(self.count(|stats| stats.scans))
    }

    fn polls(&self) -> Step {
        let polls = self.count(|stats| stats.polls);
        let lost = self.lost();
        let reasons = [
            (self.count(|stats| stats.timeouts), "unanswered in time"),
            (self.count(|stats| stats.malformed.total()), "malformed"),
            (self.count(|stats| stats.refused), "refused"),
            (self.count(|stats| stats.disconnects), "times the link was lost"),
        ];
        let reasons: Vec<_> = reasons
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, reason)| format!("{count} {reason}"))
            .collect();
        let verdict = if polls == 0
            || self.scans.is_empty()
            || self.count(|stats| stats.disconnects) > 0
            || lost as f64 > MAX_LOSS * polls as f64
        {
            Verdict::Failed
        } else if lost > 0 || !reasons.is_empty() {
            Verdict::Weak
        } else {
            Verdict::Ok
        };
        let mut text = format!("{} of {polls} answered with a whole scan", polls - lost);
        if !reasons.is_empty() {
            text.push_str(": ");
            text.push_str(&reasons.join(", "));
            text.push_str("; check cable, plugs and power");
        }
        Step::new("polls", verdict, text)
    }

    fn rate(&self) -> Step {
        const NAME: &str = "rate";
        let (Some(first), Some(last)) = (self.scans.first(), self.scans.last()) else {
            return Step::new(NAME, Verdict::Failed, "no scan came");
        };
        let time = last.received_at.saturating_duration_since(first.received_at).as_secs_f64();
        if time <= 0.0 {
            return Step::new(NAME, Verdict::Weak, "only one scan came: test for longer");
        }
        let reached = (self.scans.len() - 1) as f64 / time;
        let asked = self.asked;
        let mut text = format!("{reached:.1} scans a second of {asked:.1}, {}", self.jitter());
        if let Some(baud_rate) = self.outrun {
            // Writing to a string does not fail.
            let _ = write!(text, "; {}", wire_speed::explanation(baud_rate));
        }
        if reached >= ENOUGH * asked {
            return Step::new(NAME, Verdict::Ok, text);
        }
        let carried = self
            .baud_rate
            .map_or(f64::INFINITY, |rate| 1.0 / self.window.wire_time(rate).as_secs_f64());
        let verdict = match reached < FAILED_RATE * asked.min(carried) {
            true => Verdict::Failed,
            false => Verdict::Weak,
        };
        let cause = match self.baud_rate {
            Some(baud_rate) if carried < asked / ENOUGH => {
                let helps = match sufficient_baud_rate(self.window, asked) {
                    Some(faster) => format!("--baud {faster} would do"),
                    None => "fewer steps would help".to_owned(),
                };
                format!("a line at {baud_rate} baud carries {carried:.1}; {helps}")
            }
            _ if self.lost() > 0 => format!("{} polls brought no scan", self.lost()),
            _ => "some revolutions of the motor brought no scan".to_owned(),
        };
        Step::new(NAME, verdict, format!("{text}: {cause}"))
    }

    /// Returns the spread of the intervals between scans.
    fn jitter(&self) -> String {
        let times = self.scans.iter().map(|seen| seen.received_at);
        let intervals = times.clone().zip(times.skip(1)).map(|(one, next)| next - one);
        let millis = intervals.map(|interval| interval.as_secs_f64() * 1000.0);
        let count = self.scans.len().saturating_sub(1).max(1) as f64;
        let mean = millis.clone().sum::<f64>() / count;
        let variance = millis.clone().map(|one| (one - mean).powi(2)).sum::<f64>() / count;
        let least = millis.clone().fold(f64::INFINITY, f64::min);
        let most = millis.fold(0.0, f64::max);
        let deviation = variance.sqrt();
        format!("one every {least:.0} to {most:.0} ms, standard deviation {deviation:.1} ms")
    }

    fn latency(&self) -> Step {
        let latency = |seen: &Seen| seen.received_at.saturating_duration_since(seen.requested_at);
        let longest = self.scans.iter().map(latency).max().unwrap_or_default();
        let mean =
            self.scans.iter().map(latency).sum::<Duration>() / self.scans.len().max(1) as u32;
        let (mean, most) = (mean.as_millis(), longest.as_millis());
        let text = format!("a whole scan takes {mean} ms, {most} ms at most");
        let wire = self.baud_rate.map(|speed| self.window.wire_time(speed));
        let good = Duration::from_secs_f64(MAX_REVOLUTIONS / self.asked) + wire.unwrap_or_default();
        if longest <= good {
            return Step::new("latency", Verdict::Ok, text);
        }
        let text = format!("{text}: expected at most {} ms", good.as_millis());
        Step::new("latency", Verdict::Weak, text)
    }

    fn sight(&self) -> Step {
        const NAME: &str = "sight";
        let points = self.scans.iter().map(|seen| seen.points).max().unwrap_or_default();
        let distances = self.scans.iter().map(|seen| seen.distances).sum::<usize>();
        let distances = distances / self.scans.len().max(1);
        let text = format!("{distances} of {points} points have a distance");
        let repeats = self.count(|stats| stats.repeats) as usize;
        if distances == 0 {
            Step::new(
                NAME,
                Verdict::Weak,
                format!("{text}: is the sensor covered, or everything farther away than 4 m?"),
            )
        } else if self.scans.len() > 5 && repeats + 1 >= self.scans.len() {
            let text = format!("{text}, and all scans are equal: does the sensor measure at all?");
            Step::new(NAME, Verdict::Weak, text)
        } else {
            Step::new(NAME, Verdict::Ok, text)
        }
    }
}

impl Seen {
    fn of(scan: &Scan) -> Self {
        Self {
            requested_at: scan.requested_at(),
            received_at: scan.received_at(),
            points: scan.len(),
            distances: scan.points().count(),
        }
    }
}

fn baud_rate(sensor: &Sensor) -> Option<BaudRate> {
    sensor.state().borrow().baud_rate()
}

#[cfg(test)]
mod tests {
    use tokio_scip::emulator::{Builder, Emulator, Fault, Faults, Values, WorldTime};

    use super::*;

    /// The steps that are not good, on the paused clock.
    async fn test(builder: Builder, faults: Faults) -> (Vec<(&'static str, Verdict)>, String) {
        let emulator = builder.build();
        let sensor = Sensor::builder().connect(emulator.clone()).await.unwrap();
        emulator.set_faults(faults);
        let mut steps = vec![link(&sensor, Duration::ZERO), version(&sensor).await];
        steps.push(laser(&sensor).await);
        steps.extend(scans(&sensor, Window::DETECTION, None, Duration::from_secs(10)).await);
        let text = steps.iter().map(|step| format!("{step}\n")).collect();
        let bad = steps.into_iter().filter(|step| step.verdict != Verdict::Ok);
        (bad.map(|step| (step.name, step.verdict)).collect(), text)
    }

    #[tokio::test(start_paused = true)]
    async fn a_good_sensor_passes_every_step() {
        let (bad, text) = test(Emulator::builder().usb(), Faults::none()).await;
        assert_eq!(bad, [], "{text}");
        assert_eq!(text.lines().count(), 7, "{text}");
        let rate =
            "10.0 scans a second of 10.0, one every 100 to 100 ms, standard deviation 0.0 ms";
        assert!(text.contains(rate), "{text}");
        let fast = Emulator::builder().baud_rate(BaudRate::B750000);
        let (bad, text) = test(fast, Faults::none()).await;
        assert_eq!(bad, [], "{text}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_slow_line_is_weak_and_told_what_helps() {
        let slow = Emulator::builder().baud_rate(BaudRate::B19200);
        let (bad, text) = test(slow, Faults::none()).await;
        assert_eq!(bad, [("rate", Verdict::Weak)], "{text}");
        assert!(text.contains("--baud 250000"), "{text}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_low_rate_after_losses_is_reported_as_losses() {
        let lossy = Faults::none().rate(0.2, Fault::Lost).seed(1);
        let (bad, text) = test(Emulator::builder().baud_rate(BaudRate::B750000), lossy).await;
        assert!(bad.iter().any(|(step, _)| *step == "rate"), "{text}");
        let rate = text.lines().find(|line| line.contains(" rate ")).unwrap();
        assert!(rate.contains("polls brought no scan"), "{text}");
        assert!(!rate.contains("carries"), "{text}");
    }

    #[tokio::test(start_paused = true)]
    async fn some_loss_is_weak_and_much_is_a_failure() {
        let one = Faults::none().at(20, Fault::Lost);
        let (bad, text) = test(Emulator::builder().usb(), one).await;
        assert!(bad.contains(&("polls", Verdict::Weak)), "{text}");
        assert!(!bad.iter().any(|(_, verdict)| *verdict == Verdict::Failed), "{text}");
        assert!(text.contains("1 unanswered in time"), "{text}");
        let much = Faults::none().rate(0.2, Fault::Damaged).seed(1);
        let (bad, text) = test(Emulator::builder().usb(), much).await;
        assert!(bad.contains(&("polls", Verdict::Failed)), "{text}");
        assert!(text.contains("malformed"), "{text}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_sensor_that_falls_silent_fails() {
        let silent = Faults::none().every(Fault::Lost);
        let (bad, text) = test(Emulator::builder().usb(), silent).await;
        assert!(bad.contains(&("laser", Verdict::Failed)), "{text}");
        assert!(bad.contains(&("polls", Verdict::Failed)), "{text}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_sensor_that_sees_nothing_or_always_the_same_is_weak() {
        let dark = |_: WorldTime, codes: &mut Values| codes.fill(3);
        let (bad, text) = test(Emulator::builder().usb().world(dark), Faults::none()).await;
        assert_eq!(bad, [("sight", Verdict::Weak)], "{text}");
        let wall = |_: WorldTime, codes: &mut Values| codes.fill(1000);
        let (bad, text) = test(Emulator::builder().usb().world(wall), Faults::none()).await;
        assert_eq!(bad, [("sight", Verdict::Weak)], "{text}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_sensor_that_does_not_say_who_it_is_is_weak() {
        let nobody = Emulator::builder().usb().version_lines(["PROT:SCIP 1.0"]);
        let (bad, text) = test(nobody, Faults::none()).await;
        assert_eq!(bad, [("version", Verdict::Weak)], "{text}");
        let broken = ["PROD:URG", "SERI:H1", "STAT:FW Laser trouble"];
        let (bad, text) =
            test(Emulator::builder().usb().version_lines(broken), Faults::none()).await;
        assert_eq!(bad, [("version", Verdict::Weak)], "{text}");
    }
}
