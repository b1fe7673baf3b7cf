//! Compares the rate that a stream reaches with the one that was asked for, and
//! names the cause if it is lower, and what helps. Each cause is reported once, and again
//! only after the rate was reached in between.

use std::fmt::Write;
use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::{BaudRate, Endpoint, Rate, Scan, Sensor, Stats, Window};

use super::wire_speed;
use crate::port::name::PortName;

/// Below this part of the rate asked for, it counts as not reached.
pub(crate) const ENOUGH: f64 = 0.95;

/// The rate is measured over times of at least this length.
const MEASURED_OVER: Duration = Duration::from_secs(3);

/// Watches the rate of one stream.
#[derive(Debug)]
pub(crate) struct RateWatch {
    window: Window,
    /// The rate asked for, in scans a second; `None` where none is promised.
    asked: Option<f64>,
    /// Set if the port's own baud rate can be changed from here.
    is_settable: bool,
    /// The start of the time that is measured.
    since: Option<Start>,
    /// Set once a reply has disproved the baud rate of the link.
    is_outrun: bool,
    reported: Reported,
}

/// The scan with which a measurement starts, and the driver's counters then.
#[derive(Debug, Clone, Copy)]
struct Start {
    at: Instant,
    sequence: u64,
    counters: Counters,
}

/// The causes that were reported since the rate was reached last.
#[derive(Debug, Clone, Copy, Default)]
struct Reported {
    losses: bool,
    slowness: bool,
}

/// The driver's counters of what became of polls.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Counters {
    polls: u64,
    timeouts: u64,
    malformed: u64,
    refused: u64,
}

impl Counters {
    fn of(stats: &Stats) -> Self {
        let (timeouts, refused) = (stats.timeouts, stats.refused);
        Self { polls: stats.polls, timeouts, malformed: stats.malformed.total(), refused }
    }

    fn since(self, before: Self) -> Self {
        Self {
            polls: self.polls.saturating_sub(before.polls),
            timeouts: self.timeouts.saturating_sub(before.timeouts),
            malformed: self.malformed.saturating_sub(before.malformed),
            refused: self.refused.saturating_sub(before.refused),
        }
    }

    fn failed(self) -> u64 {
        self.timeouts + self.malformed + self.refused
    }
}

impl RateWatch {
    pub(crate) fn new(port: &PortName, window: Window, rate: Rate) -> Self {
        let is_settable = !matches!(port, PortName::Endpoint(Endpoint::Tcp { .. }, _));
        // A recording is as fast as it was recorded.
        let period = rate.period().filter(|_| port.recorded().is_none());
        Self {
            window,
            asked: period.map(|period| 1.0 / period.as_secs_f64()),
            is_settable,
            since: None,
            is_outrun: false,
            reported: Reported::default(),
        }
    }

    /// Starts anew after a time without scans whose reason is known: the link
    /// was lost, or the laser was off.
    pub(crate) fn restart(&mut self) {
        self.since = None;
    }

    /// Takes a scan into account. Returns a notice if the rate is not reached
    /// for a reason that was not reported yet.
    pub(crate) fn scanned(&mut self, scan: &Scan, sensor: &Sensor) -> Option<String> {
        let asked = self.asked?;
        let baud_rate = sensor.state().borrow().baud_rate();
        self.is_outrun |= baud_rate.is_some_and(|rate| wire_speed::outruns(scan, rate));
        let at = scan.received_at();
        if self.since.is_some_and(|since| at < since.at + MEASURED_OVER) {
            return None;
        }
        let counters = Counters::of(&sensor.stats());
        let start = Start { at, sequence: scan.sequence(), counters };
        let since = self.since.replace(start)?;
        // Scans that were missed here were reached by the sensor.
        let scans = start.sequence.saturating_sub(since.sequence);
        let reached = scans as f64 / (at - since.at).as_secs_f64();
        let baud_rate = baud_rate.filter(|_| !self.is_outrun);
        self.judge(asked, reached, counters.since(since.counters), baud_rate)
    }

    fn judge(
        &mut self,
        asked: f64,
        reached: f64,
        counters: Counters,
        baud_rate: Option<BaudRate>,
    ) -> Option<String> {
        if reached >= ENOUGH * asked {
            self.reported = Reported::default();
            return None;
        }
        let is_lossy = counters.failed() > 0;
        let reported =
            if is_lossy { &mut self.reported.losses } else { &mut self.reported.slowness };
        if std::mem::replace(reported, true) {
            return None;
        }
        let cause = if is_lossy {
            losses(counters)
        } else {
            match baud_rate.filter(|rate| limits(self.window, asked, *rate)) {
                Some(baud_rate) => self.slow_line(asked, baud_rate),
                None => "the sensor answers no faster, one poll in each revolution of its motor"
                    .to_owned(),
            }
        };
        let asked = (asked * 100.0).round() / 100.0;
        Some(format!("{reached:.1} scans a second, where {asked} were asked for: {cause}"))
    }

    fn slow_line(&self, asked: f64, baud_rate: BaudRate) -> String {
        let window = self.window;
        let millis = window.wire_time(baud_rate).as_millis();
        let mut text = format!(
            "a scan of {window} takes {millis} ms at {baud_rate} baud. What helps: fewer steps"
        );
        let cluster = (window.cluster_count() + 1..=99).find(|count| {
            let clustered = window.with_cluster_count(*count);
            clustered.is_ok_and(|clustered| !limits(clustered, asked, baud_rate))
        });
        // Writing to a string does not fail.
        if let Some(cluster) = cluster {
            let _ = write!(text, ", --cluster {cluster}");
        }
        if let Some(faster) = sufficient_baud_rate(window, asked) {
            let _ = match self.is_settable {
                true => write!(text, ", --baud {faster}"),
                false => write!(text, ", {faster} baud at sensor and bridge"),
            };
        }
        text
    }
}

/// Returns whether a line at `baud_rate` is too slow for so many scans a second.
pub(crate) fn limits(window: Window, rate: f64, baud_rate: BaudRate) -> bool {
    rate * window.wire_time(baud_rate).as_secs_f64() >= ENOUGH
}

/// Returns the lowest baud rate that carries so many scans a second.
pub(crate) fn sufficient_baud_rate(window: Window, rate: f64) -> Option<BaudRate> {
    BaudRate::ALL.into_iter().find(|baud_rate| !limits(window, rate, *baud_rate))
}

fn losses(counters: Counters) -> String {
    let kinds = [
        (counters.timeouts, "unanswered in time"),
        (counters.malformed, "malformed"),
        (counters.refused, "refused"),
    ];
    let kinds: Vec<_> = kinds
        .iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, kind)| format!("{count} {kind}"))
        .collect();
    format!(
        "of {} polls {} brought no scan ({}). What helps: check cable, plugs and power",
        counters.polls,
        counters.failed(),
        kinds.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use tokio_scip::emulator::{Emulator, Fault, Faults};

    use super::*;

    fn watch(rate: Rate) -> RateWatch {
        RateWatch::new(&PortName::Emulated, Window::DETECTION, rate)
    }

    fn notice(watch: &mut RateWatch, reached: f64, baud_rate: Option<BaudRate>) -> Option<String> {
        let asked = watch.asked.unwrap();
        watch.judge(asked, reached, Counters::default(), baud_rate)
    }

    #[test]
    fn a_slow_line_is_reported_with_the_options_that_would_do() {
        let text = notice(&mut watch(Rate::hz(10.0)), 1.2, Some(BaudRate::B19200)).unwrap();
        assert_eq!(
            text,
            "1.2 scans a second, where 10 were asked for: a scan of steps 44..=725 takes \
             733 ms at 19200 baud. What helps: fewer steps, --cluster 9, --baud 250000"
        );
        let mut bridge = RateWatch { is_settable: false, ..watch(Rate::hz(10.0)) };
        let text = notice(&mut bridge, 1.2, Some(BaudRate::B19200)).unwrap();
        assert!(text.ends_with("250000 baud at sensor and bridge"), "{text}");
        // No baud rate of SCIP 1.1 carries so much.
        let text = notice(&mut watch(Rate::hz(1000.0)), 1.2, Some(BaudRate::B19200)).unwrap();
        assert!(text.ends_with("What helps: fewer steps"), "{text}");
    }

    #[test]
    fn a_sensor_that_is_slower_than_its_line_is_reported_as_such() {
        for baud_rate in [None, Some(BaudRate::B750000)] {
            let text = notice(&mut watch(Rate::hz(20.0)), 10.0, baud_rate).unwrap();
            assert!(text.ends_with("each revolution of its motor"), "{baud_rate:?}: {text}");
        }
    }

    #[test]
    fn a_cause_is_reported_once_and_again_after_the_rate_was_reached() {
        let mut watch = watch(Rate::hz(10.0));
        assert!(notice(&mut watch, 8.0, None).is_some());
        assert_eq!(notice(&mut watch, 8.0, None), None);
        assert_eq!(notice(&mut watch, 9.9, None), None);
        assert!(notice(&mut watch, 8.0, None).is_some());
    }

    #[test]
    fn lost_polls_are_reported_as_losses_and_as_nothing_else() {
        let mut watch = watch(Rate::hz(10.0));
        let counters = Counters { polls: 40, timeouts: 3, malformed: 2, refused: 0 };
        let text = watch.judge(10.0, 7.0, counters, Some(BaudRate::B19200)).unwrap();
        assert_eq!(
            text,
            "7.0 scans a second, where 10 were asked for: of 40 polls 5 brought no scan \
             (3 unanswered in time, 2 malformed). What helps: check cable, plugs and power"
        );
        // Without losses the rate is judged by itself.
        let text = notice(&mut watch, 1.2, Some(BaudRate::B19200)).unwrap();
        assert!(text.contains("at 19200 baud"), "{text}");
    }

    /// The notices of some time with a sensor.
    async fn notices(emulator: Emulator, scans: usize) -> Vec<String> {
        let sensor = Sensor::builder().connect(emulator).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
        let (mut watch, mut notices) = (watch(Rate::hz(10.0)), Vec::new());
        for _ in 0..scans {
            if let Ok(scan) = stream.next().await.unwrap() {
                notices.extend(watch.scanned(&scan, &sensor));
            }
        }
        notices
    }

    #[tokio::test(start_paused = true)]
    async fn a_good_stream_has_no_notice_and_a_lossy_one_has_one_of_its_losses() {
        let good = Emulator::builder().usb();
        assert_eq!(notices(good.build(), 200).await, [""; 0]);
        let lossy = Emulator::builder().usb().faults(Faults::none().rate(0.1, Fault::Lost).seed(1));
        let notices = notices(lossy.build(), 200).await;
        assert!(notices.len() == 1 && notices[0].contains("unanswered in time"), "{notices:?}");
    }
}
