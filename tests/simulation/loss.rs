//! How many scans a bad line costs, and that none of them is wrong.

use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::emulator::{Emulator, Fault, Faults, Pace};
use tokio_scip::{Rate, Sensor, Window};

use super::truth::Truth;

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
}

/// Polls a sensor on USB of whose replies 1 % are late by up to 3 s, 0.5 %
/// lost, 0.5 % damaged and 0.1 % doubled.
pub(crate) fn poll(window: Window, rate: Rate, time: Duration) -> Loss {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    let runtime = runtime.enable_time().start_paused(true).build().unwrap();
    runtime.block_on(async {
        let faults = Faults::none()
            .late(0.01, Duration::from_secs(3))
            .rate(0.005, Fault::Lost)
            .rate(0.005, Fault::Damaged)
            .rate(0.001, Fault::Doubled)
            .seed(1);
        let truth = Truth::default();
        let emulator = Emulator::builder()
            .world(truth.world())
            .pace(if rate == Rate::MAX { Pace::PerRevolution } else { Pace::AtOnce })
            .build();
        let sensor = Sensor::builder().jitter_seed(1).ring_depth(16).connect(emulator.clone());
        let sensor = sensor.await.unwrap();
        emulator.set_faults(faults);
        let end = Instant::now() + time;
        let mut stream = sensor.scans(window, rate).await.unwrap();
        let mut loss = Loss::default();
        while Instant::now() < end {
            let Ok(scan) = stream.next().await.unwrap() else { continue };
            match truth.check(&scan, 1) {
                Ok(_) => {
                    loss.right += 1;
                    loss.flipped += u64::from(truth.check(&scan, 0).is_err());
                }
                Err(wrong) => {
                    println!("{wrong}");
                    loss.wrong += 1;
                }
            }
        }
        assert_eq!(stream.missed(), 0);
        loss.polls = sensor.stats().polls;
        loss
    })
}
