//! Devices that do not repeat the text of a request: they are asked without one.

use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::{Rate, Window};
use urg_emulator::{Fault, Faults, Model, Quirk};

use super::times::lateness;
use super::{next, numbered, revolution};
use crate::common::builder;

const MODELS: [Model; 3] = [Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx];

#[tokio::test(start_paused = true)]
async fn a_sensor_without_labels_is_measured() {
    for model in MODELS {
        let emulator = numbered(model).quirk(Quirk::NoLabels).build();
        let begun = Instant::now();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        // One command is waited for in vain.
        assert!(begun.elapsed() < Duration::from_millis(1700), "{model:?}: {:?}", begun.elapsed());
        let mut latest = revolution(&sensor.scan(Window::DETECTION).await.unwrap());
        let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        for n in 0..50 {
            let now = revolution(&next(&mut stream).await);
            assert!(now == latest + 1 || n == 0, "{model:?}: {now} after {latest}");
            latest = now;
        }
        sensor.laser_off().await.unwrap();
        assert!(!emulator.is_laser_on());
        let stats = sensor.stats();
        let failed = (stats.malformed.total(), stats.timeouts, stats.refused, stats.lost);
        assert_eq!(failed, (1, 0, 0, 0), "{model:?}");
    }
}

/// Nothing but its order tells that it is older than the request.
#[tokio::test(start_paused = true)]
async fn a_late_reply_without_a_label_is_no_newer_scan() {
    for model in MODELS {
        let emulator = numbered(model).quirk(Quirk::NoLabels).build();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        for late in (0..1200).step_by(50) {
            let fault = Fault::Late(Duration::from_millis(late));
            emulator.set_faults(Faults::none().once("GD", fault));
            let scan = sensor.scan(Window::DETECTION).await.unwrap();
            // The sensor sends what it has in memory.
            let off = lateness(&emulator, &scan);
            let usual = late < 500;
            assert!(
                off < if usual { late as f64 + 110.0 } else { 110.0 },
                "{model:?} {late}: {off}"
            );
        }
    }
}
