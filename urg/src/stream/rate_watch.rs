//! Tells the user why a stream is slower than requested, and what to change. The driver measures
//! the rate and explains the cause. A cause is repeated only if the rate was reached in between.

use tokio_scip::stats::{ScheduleStats, Shortfall};
use tokio_scip::{Rate, Sensor, Stats, Window};

use crate::port::name::PortName;

/// Rate check of one stream.
#[derive(Debug)]
pub(crate) struct RateWatch {
    window: Window,
    /// `None` for a recording, which plays at its own rate.
    asked: Option<Rate>,
    /// Causes reported since the rate was last reached.
    reported: Vec<Shortfall>,
}

impl RateWatch {
    pub(crate) fn new(port: &PortName, window: Window, rate: Rate) -> Self {
        Self {
            window,
            asked: Some(rate).filter(|_| port.recorded().is_none()),
            reported: Vec::new(),
        }
    }

    /// Checks the rate after a scan. Returns a notice if it is too low for a new reason.
    pub(crate) fn scanned(&mut self, sensor: &Sensor) -> Option<String> {
        let rate = self.asked?;
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
    use std::time::Duration;

    use tokio::time::Instant;
    use tokio_scip::BaudRate;
    use tokio_scip::scan::Pose;
    use urg_emulator::{Emulator, Fault, Faults};

    use super::*;

    /// Polls for 20 seconds, once with each of the faults. Collects the notices.
    async fn notices(emulator: Emulator, rate: f64, faults: &[Faults]) -> Vec<String> {
        let (window, rate) = (Window::DETECTION, Rate::hz(rate));
        let sensor = Sensor::builder().connect(emulator.clone()).await.unwrap();
        let mut watch = RateWatch::new(&PortName::Emulated(Pose::default()), window, rate);
        let mut stream = sensor.scans(window, rate).await.unwrap();
        let mut notices = Vec::new();
        for faults in faults {
            emulator.set_faults(faults.clone());
            let end = Instant::now() + Duration::from_secs(20);
            while Instant::now() < end {
                if stream.next().await.unwrap().is_ok() {
                    notices.extend(watch.scanned(&sensor));
                }
            }
        }
        notices
    }

    #[tokio::test(start_paused = true)]
    async fn each_cause_is_reported_once_with_what_helps() {
        let (usb, good) = (|| Emulator::builder().usb(), Faults::none);
        assert_eq!(notices(usb().build(), 10.0, &[good()]).await, [""; 0]);
        let slow_line = Emulator::builder().baud_rate(BaudRate::B19200);
        let slow =
            "1.2 scans a second, where 10 Hz was asked for: a scan takes 733 ms at 19200 baud";
        let lossy = || good().rate(0.1, Fault::Lost).seed(1);
        let lost = "of the last polls brought no scan";
        for (emulator, rate, faults, times, expected) in [
            (slow_line, 10.0, vec![good()], 1, slow),
            (usb(), 12.0, vec![good()], 1, "the sensor answers no faster"),
            (usb(), 10.0, vec![lossy()], 1, lost),
            // The rate was reached in between.
            (usb(), 10.0, vec![lossy(), good(), lossy()], 2, lost),
        ] {
            let notices = notices(emulator.build(), rate, &faults).await;
            assert_eq!(notices.len(), times, "{notices:?}");
            assert!(notices.iter().all(|notice| notice.contains(expected)), "{notices:?}");
        }
    }
}
