//! A UST at 40 Hz and eight URGs at 10 Hz are recorded at once, and nothing is missed.
//!
//! `SCIP_RECORDED_SECONDS=7200 cargo test -p urg-recording --test recording nine_sensors` records two
//! hours of the paused clock, in 24 minutes on busy cores.

use std::io::pipe;
use std::time::Duration;

use futures::FutureExt as _;
use futures::future::join_all;
use tokio::time::Instant;
use tokio_scip::{Rate, Window};
use urg_emulator::{Emulator, Model, Values, WorldTime};
use urg_recording::{Entry, Recorder, Recording};

use super::sink::observed;

/// Sensor whose scans show the number of their revolution.
fn sensor(model: Model) -> Emulator {
    let world = |time: WorldTime, values: &mut Values| {
        values.iter_mut().for_each(|value| *value = 100 + (time.revolution % 3000) as u32);
    };
    Emulator::builder().model(model).world(world).log_capacity(0).build()
}

/// Records a sensor, and reads the recording while it is written.
async fn record(model: Model, hz: u32, time: Duration) {
    let (reader, writer) = pipe().unwrap();
    let reading = std::thread::spawn(move || {
        let (mut scans, mut replies) = (Vec::new(), 0);
        for record in Recording::read(reader).unwrap() {
            match record.unwrap().entry {
                Entry::Scan(scan) => scans.push(scan.ranges[500]),
                Entry::Reply(reply) => replies += usize::from(reply.bytes.len() > 1000),
                _ => {}
            }
        }
        (scans, replies)
    });
    let mut recorder = Recorder::builder().write_to(writer).unwrap();
    let rate = Rate::hz(hz.into());
    let (sensor, mut scans) = observed(&recorder, sensor(model), Window::DETECTION, rate).await;
    recorder.describe(&sensor, &scans).await.unwrap();
    let (mut taken, end) = (Vec::new(), Instant::now() + time);
    while let Some(item) = scans.next().await {
        recorder.record(&item).unwrap();
        taken.push(item.unwrap().ranges().nth(500).unwrap());
        // Without this, the paused clock runs ahead of the reader.
        while recorder.ready().now_or_never().is_none() {
            std::thread::yield_now();
        }
        if Instant::now() >= end {
            break;
        }
    }
    assert_eq!((scans.missed(), sensor.stats().polls_skipped), (0, 0));
    drop(scans);
    sensor.close().await;
    let progress = recorder.finish().await.unwrap();
    assert_eq!((progress.scans, progress.lost, progress.lost_replies), (taken.len() as u64, 0, 0));
    let expected = time.as_secs() * u64::from(hz);
    assert!((expected..expected + 3).contains(&progress.scans), "{model:?}: {}", progress.scans);
    let (scans, replies) = reading.join().unwrap();
    assert_eq!(scans, taken);
    // The sensor may have measured once more.
    assert!((taken.len()..taken.len() + 2).contains(&replies), "{model:?}: {replies}");
    if model == Model::Ust10lx {
        let step = |pair: &[f32]| (pair[1] * 1000.0).round() - (pair[0] * 1000.0).round();
        // Until the first revolution has ended, the sensor sends that one, too.
        assert!(scans[1..].windows(2).all(|pair| matches!(step(pair), 1.0 | -2999.0)));
    }
}

#[tokio::test(start_paused = true)]
async fn nothing_is_missed_of_nine_sensors() {
    let seconds = std::env::var("SCIP_RECORDED_SECONDS").map_or(20, |text| text.parse().unwrap());
    let time = Duration::from_secs(seconds);
    let ust = record(Model::Ust10lx, 40, time);
    let urgs = (0..8).map(|_| record(Model::Urg04lx, 10, time));
    tokio::join!(ust, join_all(urgs));
}
