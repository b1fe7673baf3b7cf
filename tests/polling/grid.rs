//! A long time on the grid at 10 Hz, on the paused clock: no poll is missing and none
//! drifts. `cargo test --release --test it grid::` plays a whole day.

use crate::common::{builder, ms};
use tokio::time::Instant;
use tokio_scip::{Rate, ScanStream, Sensor, Window};
use urg_emulator::{Emulator, Fixed, Pace};

/// A day takes minutes without optimization.
const MINUTES: u32 = if cfg!(debug_assertions) { 10 } else { 24 * 60 };
const POLLS: u32 = MINUTES * 600;

async fn stream(pace: Pace) -> (Sensor, ScanStream) {
    let emulator = Emulator::builder().world(Fixed::filled(1234)).pace(pace).build();
    let sensor = builder().connect(emulator).await.unwrap();
    let stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    (sensor, stream)
}

#[tokio::test(start_paused = true)]
async fn every_poll_is_within_a_millisecond_of_its_place() {
    let (sensor, mut stream) = stream(Pace::AtOnce).await;
    let start = stream.next().await.unwrap().unwrap().times().requested_at;
    let mut latest = ms(0);
    for n in 1..=POLLS {
        let scan = stream.next().await.unwrap().unwrap();
        let late = scan.times().requested_at - start - ms(100) * n;
        latest = latest.max(late);
        assert!(late <= ms(1), "poll {n} is {late:?} late");
        assert_eq!(scan.sequence(), u64::from(n));
    }
    println!("{POLLS} polls, none more than {latest:?} late");
    assert_eq!(sensor.stats().polls_skipped, 0);
}

#[tokio::test(start_paused = true)]
async fn nearly_every_slow_revolution_is_polled() {
    let (_sensor, mut stream) = stream(Pace::PerRevolution).await;
    stream.next().await.unwrap().unwrap();
    let start = Instant::now();
    let mut caught = 0;
    while start.elapsed() < ms(100) * POLLS {
        stream.next().await.unwrap().unwrap();
        caught += 1;
    }
    println!("{caught} of {POLLS} turns");
    assert!(caught >= POLLS / 100 * 99, "{caught} of {POLLS} turns");
}
