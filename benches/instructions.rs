//! Work whose instructions `.ci/callgrind` counts: a number of full scans, decoded
//! (`decode`), brought from port to consumer by the driver (`driver`, at 10 Hz on the
//! paused clock), or only shown to the clock of the motor (`motor`).

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

use std::time::Duration;

use bytes::BytesMut;
use instant_sensor::InstantSensor;
use tokio_scip::codec::{Frame, ScipCodec};
use tokio_scip::protocol::{Command, Reply};
use tokio_scip::{Rate, Sensor, Window};
use tokio_util::codec::{Decoder, Encoder};

#[path = "../tests/common/instant_sensor.rs"]
mod instant_sensor;
// These are private in the library, and need no more of it than `stats`.
#[allow(dead_code)]
#[path = "../src/driver/fit.rs"]
mod fit;
#[allow(dead_code)]
#[path = "../src/driver/motor_clock.rs"]
mod motor_clock;

#[allow(dead_code)]
mod stats {
    pub(crate) struct MotorStats {
        pub(crate) revolution: std::time::Duration,
        pub(crate) jumps: u64,
        pub(crate) clock_drift_ppm: Option<i32>,
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let [work, scans] = &arguments[..] else {
        println!("bash .ci/callgrind counts the instructions of this program");
        return;
    };
    let scans = scans.parse().unwrap();
    match work.as_str() {
        "decode" => decode(scans),
        "driver" => driver(scans),
        "motor" => motor(scans),
        _ => panic!("{work}: use decode, driver or motor"),
    }
}

fn decode(scans: usize) {
    let mut reply = Vec::new();
    instant_sensor::reply(b"G00076801", &mut reply);
    let (mut codec, mut buffer) = (ScipCodec::default(), BytesMut::new());
    let command = Command::Distances(Window::FULL);
    codec.encode(&command, &mut buffer).unwrap();
    buffer.clear();
    for _ in 0..scans {
        buffer.reserve(4096);
        buffer.extend_from_slice(&reply);
        let Ok(Some(Frame::Reply(frame))) = codec.decode(&mut buffer) else { panic!("no frame") };
        drop(std::hint::black_box(Reply::parse(&command, &frame).unwrap()));
    }
}

fn driver(scans: usize) {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .start_paused(true)
        .build()
        .unwrap();
    runtime.block_on(async {
        let sensor = Sensor::builder().attach(InstantSensor::new()).await.unwrap();
        let mut stream = sensor.scans(Window::FULL, Rate::hz(10.0)).await.unwrap();
        for _ in 0..scans {
            stream.next().await.unwrap().unwrap();
        }
    });
}

/// Arrivals on USB, one in 16 late by 5 ms.
fn motor(scans: usize) {
    let revolution = Duration::from_nanos(99_760_500);
    let start = tokio::time::Instant::now();
    let mut clock = motor_clock::MotorClock::new(Duration::from_millis(100));
    // Their number is the same for any number of scans, so that they do not count.
    let arrivals = (1..=2000).map(|scan| {
        let end = revolution * scan;
        let late = if scan % 16 == 0 { Duration::from_millis(5) } else { Duration::ZERO };
        // The next frame of USB.
        let arrival = Duration::from_millis(end.as_millis() as u64 + 1) + late;
        (start + (end - revolution * 9 / 10), start + arrival)
    });
    let arrivals: Vec<_> = arrivals.collect();
    for (requested, arrived) in &arrivals[..scans] {
        std::hint::black_box(clock.observe(*requested, *arrived));
        std::hint::black_box(clock.stats());
    }
    assert!(clock.stats().is_some());
}
