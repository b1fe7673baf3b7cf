//! How many scans a bad line costs, and whether any of them is wrong: a sensor
//! on USB is polled for some time, and every scan is held against the truth.

use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::emulator::{Builder, Emulator, Fault, Faults, Pace};
use tokio_scip::{Rate, Sensor, Window};

use super::truth::{Timed, Truth};

/// What came of polling for some time.
#[derive(Debug, Default)]
pub(crate) struct Loss {
    /// `G`s sent for scans.
    pub(crate) polls: u64,
    /// Scans that are the answer to their own `G`.
    pub(crate) right: u64,
    /// Of these, scans with one value in which a bit was flipped to another
    /// value, which nobody can see.
    pub(crate) flipped: u64,
    /// Scans that are the answer to another one.
    pub(crate) wrong: u64,
}

impl Loss {
    pub(crate) fn share(&self) -> f64 {
        (self.right - self.flipped) as f64 / self.polls as f64
    }

    /// Holds a scan against the truth.
    pub(crate) fn add(&mut self, truth: &Truth, scan: &Timed<'_>) {
        match truth.check(scan, 1) {
            Ok((_, flips)) => {
                self.right += 1;
                self.flipped += flips as u64;
            }
            Err(_) => self.wrong += 1,
        }
    }
}

/// 1 % of the replies are late by up to 3 s, 0.5 % lost, 0.5 % damaged and
/// 0.1 % doubled: all of that `times` as often.
pub(crate) fn bad_line(times: f64) -> Faults {
    Faults::none()
        .late(0.01 * times, Duration::from_secs(3))
        .rate(0.005 * times, Fault::Lost)
        .rate(0.005 * times, Fault::Damaged)
        .rate(0.001 * times, Fault::Doubled)
        .seed(1)
}

/// 1 % of the replies come twice, and many a second copy behind the next
/// command: a copy that comes while the line is quiet is no danger.
pub(crate) fn line_with_late_copies() -> Faults {
    Faults::none()
        .rate(0.01, Fault::Doubled)
        .paused(0.02, Duration::from_millis(700))
        .late(0.01, Duration::from_millis(900))
        .seed(2)
}

/// The sensor that is polled: at [`Rate::MAX`] its motor sets the pace.
pub(crate) fn sensor(truth: &Truth, rate: Rate) -> Builder {
    let pace = if rate == Rate::MAX { Pace::PerRevolution } else { Pace::AtOnce };
    Emulator::builder().world(truth.world()).pace(pace)
}

/// Polls through the driver.
pub(crate) async fn poll(window: Window, rate: Rate, faults: Faults, time: Duration) -> Loss {
    let truth = Truth::default();
    let emulator = sensor(&truth, rate).build();
    let sensor = Sensor::builder().jitter_seed(1).ring_depth(16).connect(emulator.clone());
    let sensor = sensor.await.unwrap();
    emulator.set_faults(faults);
    let end = Instant::now() + time;
    let mut stream = sensor.scans(window, rate).await.unwrap();
    let mut loss = Loss::default();
    while Instant::now() < end {
        let Ok(scan) = stream.next().await.unwrap() else { continue };
        loss.add(&truth, &Timed::from(&scan));
    }
    assert_eq!(stream.missed(), 0);
    loss.polls = sensor.stats().polls;
    loss
}
