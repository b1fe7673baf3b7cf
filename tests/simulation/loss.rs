//! The number of scans that a bad line costs, and of wrong ones: a sensor on USB is
//! polled for some time, and every scan is compared with the truth.

use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::{Rate, Sensor, Window};
use urg_emulator::{Emulator, EmulatorBuilder, Fault, Faults, Pace};

use super::truth::{SimulationTruth, Timed};

/// Counts after polling for some time.
#[derive(Debug, Default)]
pub(crate) struct Loss {
    /// `G`s sent for scans.
    pub(crate) polls: u64,
    /// Scans that answer their own `G`.
    pub(crate) right: u64,
    /// Of these, scans with one value in which a flipped bit made another value, which
    /// no driver can detect.
    pub(crate) flipped: u64,
    /// Scans that answer another `G`.
    pub(crate) wrong: u64,
}

impl Loss {
    pub(crate) fn share(&self) -> f64 {
        (self.right - self.flipped) as f64 / self.polls as f64
    }

    /// Compares a scan with the truth and counts it.
    pub(crate) fn add(&mut self, truth: &SimulationTruth, scan: &Timed) {
        match truth.check(scan, 1) {
            Ok((_, flips)) => {
                self.right += 1;
                self.flipped += flips as u64;
            }
            Err(_) => self.wrong += 1,
        }
    }
}

/// 1 % of the replies are late by up to 3 s, 0.5 % lost, 0.5 % damaged and 0.1 % doubled,
/// each share multiplied by `times`.
pub(crate) fn bad_line(times: f64) -> Faults {
    Faults::none()
        .up_to(0.01 * times, Fault::Late(Duration::from_secs(3)))
        .rate(0.005 * times, Fault::Lost)
        .rate(0.005 * times, Fault::Damaged)
        .rate(0.001 * times, Fault::Doubled)
        .seed(1)
}

/// 1 % of the replies are doubled, with many copies after the next command. A copy that
/// arrives while no reply is awaited does no harm.
pub(crate) fn line_with_late_copies() -> Faults {
    Faults::none()
        .rate(0.01, Fault::Doubled)
        .up_to(0.02, Fault::Pause(63, Duration::from_millis(700)))
        .up_to(0.01, Fault::Late(Duration::from_millis(900)))
        .seed(2)
}

/// Returns the sensor to poll. At [`Rate::UNLIMITED`] its motor sets the rate.
pub(crate) fn sensor(truth: &SimulationTruth, rate: Rate) -> EmulatorBuilder {
    let pace = if rate == Rate::UNLIMITED { Pace::PerRevolution } else { Pace::AtOnce };
    Emulator::builder().world(truth.world()).pace(pace)
}

/// Polls through the driver.
pub(crate) async fn poll(window: Window, rate: Rate, faults: Faults, time: Duration) -> Loss {
    let truth = SimulationTruth::default();
    let emulator = sensor(&truth, rate).build();
    fastrand::seed(1);
    let sensor = Sensor::builder().depth(16).connect(emulator.clone());
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
