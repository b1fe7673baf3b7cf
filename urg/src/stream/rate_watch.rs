//! Tells the user why a stream is slower than requested, and what to change. The driver
//! measures the rate. A cause is repeated only if the rate was reached in between.

use std::fmt::Write;
use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::stats::ScheduleStats;
use tokio_scip::{BaudRate, Endpoint, Rate, Scan, Sensor, Stats, Window};

use crate::format::listed;
use crate::port::name::PortName;

/// Fraction of the requested rate that counts as reached.
pub(crate) const ENOUGH: f64 = 0.95;

/// About the time over which the driver measures the rate.
const MEASURED_OVER: Duration = Duration::from_secs(3);

/// Rate check of one stream.
#[derive(Debug)]
pub(crate) struct RateWatch {
    window: Window,
    /// Requested rate in scans per second; `None` for recordings and `--rate max`.
    asked: Option<f64>,
    /// Whether this program can set the port's baud rate: not behind a TCP bridge.
    is_settable: bool,
    /// Start of the current measurement, and the fastest reply since then.
    since: Option<(Instant, Duration)>,
    reported: Reported,
}

/// Causes reported since the rate was last reached.
#[derive(Debug, Clone, Copy, Default)]
struct Reported {
    losses: bool,
    slowness: bool,
}

/// Measured rate and its possible causes.
#[derive(Debug, Clone, Copy)]
struct RateFigures {
    asked: f64,
    reached: f64,
    /// Polls without a scan.
    failed: u32,
    /// Whether even the fastest reply, or a revolution of the motor, takes longer than the
    /// period. Late polls do not count: a busy machine sends them late.
    is_slow: bool,
    /// `None` on USB, and if replies came faster than the baud rate allows.
    baud_rate: Option<BaudRate>,
}

impl RateWatch {
    pub(crate) fn new(port: &PortName, window: Window, rate: Rate) -> Self {
        let is_settable = !matches!(port, PortName::Endpoint(Endpoint::Tcp { .. }));
        // A recording plays at its own rate.
        let period = rate.period().filter(|_| port.recorded().is_none());
        Self {
            window,
            asked: period.map(|period| 1.0 / period.as_secs_f64()),
            is_settable,
            since: None,
            reported: Reported::default(),
        }
    }

    /// Restarts the measurement after a known interruption, such as a lost link.
    pub(crate) fn restart(&mut self) {
        self.since = None;
    }

    /// Counts a scan. Returns a notice if the rate is too low for a new reason.
    pub(crate) fn scanned(&mut self, scan: &Scan, sensor: &Sensor) -> Option<String> {
        let asked = self.asked?;
        let at = scan.received_at();
        let (since, quickest) = self.since.get_or_insert((at, Duration::MAX));
        *quickest = (*quickest).min(at.saturating_duration_since(scan.requested_at()));
        if at < *since + MEASURED_OVER {
            return None;
        }
        let slowest_part = quickest.as_secs_f64().max(scan.scan_time().as_secs_f64());
        self.since = None;
        let stats = sensor.stats();
        let schedule = schedule(&stats, self.window)?;
        let baud_rate = sensor.watch_state().get().baud_rate();
        let measured = RateFigures {
            asked,
            reached: schedule.reached?,
            failed: schedule.failed,
            is_slow: slowest_part * asked * ENOUGH > 1.0,
            baud_rate: baud_rate.filter(|_| !stats.baud_rate_outrun),
        };
        self.judge(measured, &stats)
    }

    fn judge(&mut self, measured: RateFigures, stats: &Stats) -> Option<String> {
        let RateFigures { asked, reached, failed, is_slow, baud_rate } = measured;
        if reached >= ENOUGH * asked {
            self.reported = Reported::default();
            return None;
        }
        let (reported, cause) = if failed > 0 {
            (&mut self.reported.losses, losses(stats))
        } else if is_slow {
            let cause = match baud_rate.filter(|rate| limits(self.window, asked, *rate)) {
                Some(baud_rate) => self.slow_line(asked, baud_rate),
                None => "the sensor answers no faster, one poll in each revolution of its motor"
                    .to_owned(),
            };
            (&mut self.reported.slowness, cause)
        } else {
            return None;
        };
        if std::mem::replace(reported, true) {
            return None;
        }
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
        // Writing to a `String` is infallible.
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

/// Finds the statistics of the polls of a window.
pub(crate) fn schedule(stats: &Stats, window: Window) -> Option<&ScheduleStats> {
    stats.schedules.iter().find(|schedule| schedule.window == window)
}

/// Checks whether a line at `baud_rate` is too slow for `rate` scans per second.
pub(crate) fn limits(window: Window, rate: f64, baud_rate: BaudRate) -> bool {
    rate * window.wire_time(baud_rate).as_secs_f64() >= ENOUGH
}

/// Finds the lowest baud rate that carries `rate` scans per second.
pub(crate) fn sufficient_baud_rate(window: Window, rate: f64) -> Option<BaudRate> {
    BaudRate::ALL.into_iter().find(|baud_rate| !limits(window, rate, *baud_rate))
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

    fn watch(rate: Rate) -> RateWatch {
        RateWatch::new(&PortName::Emulated(Pose::default()), Window::DETECTION, rate)
    }

    /// Judges a sensor slower than requested.
    fn notice(watch: &mut RateWatch, reached: f64, baud_rate: Option<BaudRate>) -> Option<String> {
        let asked = watch.asked.unwrap();
        let measured = RateFigures { asked, reached, failed: 0, is_slow: true, baud_rate };
        watch.judge(measured, &Stats::default())
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
        // SCIP 1.1 has no baud rate for 1000 scans per second.
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
        let mut stats = Stats::default();
        (stats.polls, stats.timeouts, stats.malformed.echo) = (40, 3, 2);
        let baud_rate = Some(BaudRate::B19200);
        let lossy = RateFigures { asked: 10.0, reached: 7.0, failed: 5, is_slow: true, baud_rate };
        assert_eq!(
            watch.judge(lossy, &stats).unwrap(),
            "7.0 scans a second, where 10 were asked for: of 40 polls 5 brought no scan \
             (3 unanswered in time, 2 malformed). What helps: check cable, plugs and power"
        );
        // Without losses, only the baud rate explains it.
        let text = notice(&mut watch, 1.2, Some(BaudRate::B19200)).unwrap();
        assert!(text.contains("at 19200 baud"), "{text}");
    }

    /// Runs a stream of 200 scans that stalls for `late` every 20 scans, and collects its
    /// notices.
    async fn notices(emulator: Emulator, rate: f64, late: Duration) -> Vec<String> {
        let sensor = Sensor::builder().connect(emulator).await.unwrap();
        notices_of(&sensor, watch(Rate::hz(rate)), Rate::hz(rate), late).await
    }

    async fn notices_of(
        sensor: &Sensor,
        mut watch: RateWatch,
        rate: Rate,
        late: Duration,
    ) -> Vec<String> {
        let mut stream = sensor.scans(watch.window, rate).await.unwrap();
        let mut notices = Vec::new();
        for number in 0..200 {
            if let Ok(scan) = stream.next().await.unwrap() {
                notices.extend(watch.scanned(&scan, sensor));
            }
            if number % 20 == 10 && !late.is_zero() {
                // Like SIGSTOP: the driver does not run either.
                tokio::time::advance(late).await;
            }
        }
        notices
    }

    #[tokio::test(start_paused = true)]
    async fn a_good_stream_has_no_notice_and_a_lossy_one_has_one_of_its_losses() {
        let good = Emulator::builder().usb();
        assert_eq!(notices(good.build(), 10.0, Duration::ZERO).await, [""; 0]);
        let lossy = Emulator::builder().usb().faults(Faults::none().rate(0.1, Fault::Lost).seed(1));
        let notices = notices(lossy.build(), 10.0, Duration::ZERO).await;
        assert!(notices.len() == 1 && notices[0].contains("unanswered in time"), "{notices:?}");
    }

    /// On a serial line a poll that must not be mistaken for the one before it waits until the
    /// line is quiet, and at the highest rate for a fence, which takes a revolution.
    #[tokio::test(start_paused = true)]
    async fn polls_that_cannot_differ_reach_the_rate_asked_for_and_no_sensor_is_blamed() {
        let window = Window::DETECTION.with_cluster_count(99).unwrap();
        for (rate, least) in [(Rate::hz(10.0), 9.7), (Rate::UNLIMITED, 4.9)] {
            let emulator = Emulator::builder().baud_rate(BaudRate::B115200).build();
            let sensor = Sensor::builder().connect(emulator).await.unwrap();
            let port = PortName::Emulated(Pose::default());
            let watch = RateWatch::new(&port, window, rate);
            let began = Instant::now();
            assert_eq!(notices_of(&sensor, watch, rate, Duration::ZERO).await, [""; 0], "{rate}");
            let reached = 200.0 / began.elapsed().as_secs_f64();
            assert!(reached >= least, "{rate}: {reached}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_sensor_is_only_blamed_with_evidence_of_its_own() {
        // The motor limits the sensor to 10 scans per second, whatever you request.
        for rate in [10.6, 12.0, 20.0, 50.0] {
            let notices = notices(Emulator::builder().usb().build(), rate, Duration::ZERO).await;
            assert_eq!(notices.len(), 1, "{rate}: {notices:?}");
            assert!(notices[0].contains("the sensor answers no faster"), "{notices:?}");
        }
        // A program that keeps being stopped is slow, but the sensor is not the cause.
        let stopped =
            notices(Emulator::builder().usb().build(), 10.0, Duration::from_secs(1)).await;
        assert_eq!(stopped, [""; 0]);
    }
}
