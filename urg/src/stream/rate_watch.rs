//! Tells the user why a stream is slower than requested, and what to change. The driver
//! measures the rate and finds the cause. A cause is repeated only if the rate was reached in
//! between.

use std::fmt::Write;
use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::stats::{ScheduleStats, Shortfall};
use tokio_scip::{BaudRate, Endpoint, Rate, Scan, Sensor, Stats, Window};

use crate::format::listed;
use crate::port::name::PortName;
use crate::port::open::line_baud_rate;

/// About the time over which the driver measures the rate.
const MEASURED_OVER: Duration = Duration::from_secs(3);

/// Rate check of one stream.
#[derive(Debug)]
pub(crate) struct RateWatch {
    window: Window,
    /// `None` for a recording, which plays at its own rate.
    asked: Option<Rate>,
    /// Whether this program can set the port's baud rate: not behind a TCP bridge.
    is_settable: bool,
    checked_at: Option<Instant>,
    /// Causes reported since the rate was last reached.
    reported: Vec<Shortfall>,
}

impl RateWatch {
    pub(crate) fn new(port: &PortName, window: Window, rate: Rate) -> Self {
        Self {
            window,
            asked: Some(rate).filter(|_| port.recorded().is_none()),
            is_settable: !matches!(port, PortName::Endpoint(Endpoint::Tcp { .. })),
            checked_at: None,
            reported: Vec::new(),
        }
    }

    /// Checks the rate once per measurement. Returns a notice if it is too low for a new reason.
    pub(crate) fn scanned(&mut self, scan: &Scan, sensor: &Sensor) -> Option<String> {
        let rate = self.asked?;
        let now = scan.received_at();
        if self.checked_at.is_some_and(|at| now < at + MEASURED_OVER) {
            return None;
        }
        self.checked_at = Some(now);
        let stats = sensor.stats();
        let ScheduleStats { reached, shortfall, .. } = *schedule(&stats, self.window)?;
        self.notice(rate, reached?, shortfall, line_baud_rate(sensor), &stats)
    }

    fn notice(
        &mut self,
        rate: Rate,
        reached: f64,
        shortfall: Option<Shortfall>,
        baud_rate: Option<BaudRate>,
        stats: &Stats,
    ) -> Option<String> {
        if rate.is_reached_by(reached) {
            self.reported.clear();
        }
        let shortfall = shortfall.filter(|cause| !self.reported.contains(cause))?;
        self.reported.push(shortfall);
        let cause = match (shortfall, baud_rate) {
            (Shortfall::Loss, _) => losses(stats),
            (Shortfall::Line, Some(baud_rate)) => self.slow_line(rate, baud_rate),
            _ => "the sensor answers no faster, one poll in each revolution of its motor".into(),
        };
        Some(format!("{reached:.1} scans a second, where {rate} was asked for: {cause}"))
    }

    fn slow_line(&self, rate: Rate, baud_rate: BaudRate) -> String {
        let window = self.window;
        let millis = window.wire_time(baud_rate).as_millis();
        let mut text = format!(
            "a scan of {window} takes {millis} ms at {baud_rate} baud. What helps: fewer steps"
        );
        let cluster = (window.cluster_count() + 1..=99).find(|count| {
            let clustered = window.with_cluster_count(*count);
            clustered.is_ok_and(|clustered| carries(clustered, rate, baud_rate))
        });
        // Writing to a `String` is infallible.
        if let Some(cluster) = cluster {
            let _ = write!(text, ", --cluster {cluster}");
        }
        if let Some(faster) = sufficient_baud_rate(window, rate) {
            let _ = match self.is_settable {
                true => write!(text, ", --baud {faster}"),
                false => write!(text, ", {faster} baud at sensor and bridge"),
            };
        }
        text
    }
}

/// Finds the statistics of the polls of a window.
pub(crate) fn schedule(stats: &Stats, window: Window) -> Option<&ScheduleStats> {
    stats.schedules.iter().find(|schedule| schedule.window == window)
}

/// Checks whether a line at `baud_rate` carries `rate`, with time for the sensor to answer.
pub(crate) fn carries(window: Window, rate: Rate, baud_rate: BaudRate) -> bool {
    rate.period().is_some_and(|period| window.wire_time(baud_rate) < period.mul_f64(0.95))
}

/// Finds the lowest baud rate that carries `rate`.
pub(crate) fn sufficient_baud_rate(window: Window, rate: Rate) -> Option<BaudRate> {
    BaudRate::ALL.into_iter().find(|baud_rate| carries(window, rate, *baud_rate))
}

fn losses(stats: &Stats) -> String {
    let malformed = stats.malformed.total();
    let kinds = listed(&[
        (stats.timeouts, "unanswered in time"),
        (malformed, "malformed"),
        (stats.refused, "refused"),
    ]);
    let failed = stats.timeouts + malformed + stats.refused;
    format!(
        "of {} polls {failed} brought no scan ({kinds}). What helps: check cable, plugs and power",
        stats.polls
    )
}

#[cfg(test)]
mod tests {
    use tokio_scip::scan::Pose;
    use urg_emulator::{Emulator, Fault, Faults};

    use super::*;

    /// Polls for 20 seconds. Collects the notices.
    async fn notices(emulator: Emulator, rate: f64) -> Vec<String> {
        let (window, rate) = (Window::DETECTION, Rate::hz(rate));
        let sensor = Sensor::builder().connect(emulator).await.unwrap();
        let mut watch = RateWatch::new(&PortName::Emulated(Pose::default()), window, rate);
        let mut stream = sensor.scans(window, rate).await.unwrap();
        let end = Instant::now() + Duration::from_secs(20);
        let mut notices = Vec::new();
        while Instant::now() < end {
            if let Ok(scan) = stream.next().await.unwrap() {
                notices.extend(watch.scanned(&scan, &sensor));
            }
        }
        notices
    }

    #[tokio::test(start_paused = true)]
    async fn each_cause_is_reported_once_with_what_helps() {
        let usb = || Emulator::builder().usb();
        assert_eq!(notices(usb().build(), 10.0).await, [""; 0]);
        let slow_line = Emulator::builder().baud_rate(BaudRate::B19200);
        let lossy = usb().faults(Faults::none().rate(0.1, Fault::Lost).seed(1));
        for (emulator, rate, expected) in [
            (
                slow_line,
                10.0,
                "1.2 scans a second, where 10 Hz was asked for: a scan of steps 44..=725 takes \
                 733 ms at 19200 baud. What helps: fewer steps, --cluster 9, --baud 250000",
            ),
            (usb(), 12.0, "the sensor answers no faster"),
            (lossy, 10.0, "unanswered in time"),
        ] {
            let notices = notices(emulator.build(), rate).await;
            assert!(notices.len() == 1 && notices[0].contains(expected), "{notices:?}");
        }
    }

    #[test]
    fn only_possible_remedies_are_named() {
        let watch = |is_settable| RateWatch {
            is_settable,
            ..RateWatch::new(&"emulated".parse().unwrap(), Window::DETECTION, Rate::UNLIMITED)
        };
        let text = watch(false).slow_line(Rate::hz(10.0), BaudRate::B19200);
        assert!(text.ends_with("250000 baud at sensor and bridge"), "{text}");
        // SCIP 1.1 has no baud rate for 1000 scans per second.
        let text = watch(true).slow_line(Rate::hz(1000.0), BaudRate::B19200);
        assert!(text.ends_with("What helps: fewer steps"), "{text}");
    }

    #[test]
    fn a_cause_is_repeated_after_the_rate_was_reached() {
        let rate = Rate::hz(10.0);
        let mut watch = RateWatch::new(&"emulated".parse().unwrap(), Window::DETECTION, rate);
        let mut stats = Stats::default();
        (stats.polls, stats.timeouts, stats.malformed.echo) = (40, 3, 2);
        let mut notice = |reached, shortfall| watch.notice(rate, reached, shortfall, None, &stats);
        let loss = Some(Shortfall::Loss);
        assert_eq!(
            notice(7.0, loss).unwrap(),
            "7.0 scans a second, where 10 Hz was asked for: of 40 polls 5 brought no scan \
             (3 unanswered in time, 2 malformed). What helps: check cable, plugs and power"
        );
        assert_eq!(notice(7.0, loss), None);
        assert!(notice(7.0, Some(Shortfall::Sensor)).is_some());
        assert_eq!(notice(9.9, None), None);
        assert!(notice(7.0, loss).is_some());
    }
}
