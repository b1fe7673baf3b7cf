//! Work whose instructions `.ci/callgrind` counts: a number of full scans, decoded
//! (`decode`) or brought from port to consumer by the driver (`driver`, at 10 Hz on the
//! paused clock).

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

use std::sync::Arc;

use bytes::BytesMut;
use instant_sensor::InstantSensor;
use tokio_scip::codec::{Frame, ScipCodec};
use tokio_scip::protocol::{Command, Reply};
use tokio_scip::{Rate, Sensor, Window};
use tokio_util::codec::Encoder;

#[path = "../tests/common/instant_sensor.rs"]
mod instant_sensor;

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
        _ => panic!("{work}: use decode or driver"),
    }
}

fn decode(scans: usize) {
    let mut reply = Vec::new();
    instant_sensor::reply(b"G00076801", &mut reply);
    let (mut codec, mut buffer, mut values) =
        (ScipCodec::default(), BytesMut::new(), Arc::default());
    let command = Command::Distances(Window::FULL);
    codec.encode(&command, &mut buffer).unwrap();
    buffer.clear();
    for _ in 0..scans {
        buffer.reserve(4096);
        buffer.extend_from_slice(&reply);
        let Some(Frame::Reply(length)) = codec.find(&mut buffer) else { panic!("no frame") };
        assert!(Reply::parse_into_shared(&command, &buffer[..length], &mut values).is_ok());
        std::hint::black_box(&mut values);
        buffer.clear();
    }
}

fn driver(scans: usize) {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .start_paused(true)
        .build()
        .unwrap();
    runtime.block_on(async {
        let sensor = Sensor::attach(InstantSensor::new()).await.unwrap();
        let mut stream = sensor.scans(Window::FULL, Rate::hz(10.0)).await.unwrap();
        for _ in 0..scans {
            stream.next().await.unwrap().unwrap();
        }
    });
}
