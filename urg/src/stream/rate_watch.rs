//! Tells the user why a stream is slower than requested, and what to change. The driver measures
//! the rate and explains the cause. A cause is repeated only if the rate was reached in between.

use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::stats::{ScheduleStats, Shortfall};
use tokio_scip::{Rate, Scan, Sensor, Stats, Window};

use crate::port::name::PortName;

/// About the time over which the driver measures the rate.
const MEASURED_OVER: Duration = Duration::from_secs(3);

/// Rate check of one stream.
#[derive(Debug)]
pub(crate) struct RateWatch {
    window: Window,
    /// `None` for a recording, which plays at its own rate.
    asked: Option<Rate>,
    checked_at: Option<Instant>,
    /// Causes reported since the rate was last reached.
    reported: Vec<Shortfall>,
}

impl RateWatch {
    pub(crate) fn new(port: &PortName, window: Window, rate: Rate) -> Self {
        Self {
            window,
            asked: Some(rate).filter(|_| port.recorded().is_none()),
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
        let schedule = schedule(&stats, self.window)?;
        let reached = schedule.reached?;
        if rate.is_reached_by(reached) {
            self.reported.clear();
        }
        let shortfall = schedule.shortfall.filter(|cause| !self.reported.contains(cause))?;
        self.reported.push(shortfall);
        let cause = schedule.explanation()?;
        Some(format!("{reached:.1} scans a second, where {rate} was asked for: {cause}"))
    }
}

/// Finds the statistics of the polls of a window.
pub(crate) fn schedule(stats: &Stats, window: Window) -> Option<&ScheduleStats> {
    stats.schedules.iter().find(|schedule| schedule.window.is_same_wish(&window))
}

#[cfg(test)]
mod tests {
    use tokio_scip::BaudRate;
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
                "1.2 scans a second, where 10 Hz was asked for: a scan takes 733 ms at 19200 baud",
            ),
            (usb(), 12.0, "the sensor answers no faster"),
            (lossy, 10.0, "of the last polls brought no scan"),
        ] {
            let notices = notices(emulator.build(), rate).await;
            assert!(notices.len() == 1 && notices[0].contains(expected), "{notices:?}");
        }
    }
}
