//! The tap hears every frame that comes, as it came.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

use std::sync::{Arc, Mutex};

use tokio_scip::emulator::{Emulator, Fault, Faults, Fixed};
use tokio_scip::protocol::Command;
use tokio_scip::{Sensor, Window};

#[tokio::test(start_paused = true)]
async fn the_tap_hears_good_and_damaged_replies_fences_and_what_nobody_asked_for() {
    // Replies 0 and 1 answer a fence and `V`.
    let faults =
        Faults::none().at(2, Fault::Drop(14..15)).at(6, Fault::Insert(0, b"X\n0\n\n".to_vec()));
    let emulator = Emulator::builder().world(Fixed::filled(1234)).faults(faults).build();
    let heard = Arc::new(Mutex::new(Vec::new()));
    let sink = Arc::clone(&heard);
    let builder = Sensor::builder().tap(move |frame| {
        let text = String::from_utf8(frame.bytes.to_vec()).unwrap();
        sink.lock().unwrap().push((frame.command, text, frame.stamp));
    });
    let sensor = builder.connect(emulator.clone()).await.unwrap();
    let window = Window::new(384..=385).unwrap();
    // Damaged, a fence, and then whole.
    let scan = sensor.scan(window).await.unwrap();
    emulator.inject(*b"idle\n\n");
    tokio::time::sleep(std::time::Duration::from_millis(50)).await;
    sensor.laser_off().await.unwrap();

    let heard = heard.lock().unwrap();
    let found: Vec<_> = heard
        .iter()
        .map(|(command, text, _)| (*command, text.split('\n').next().unwrap()))
        .collect();
    let asked = |from| Command::Distances(Window::new(from..=385).unwrap());
    assert_eq!(
        found,
        [
            (None, "G00000001"),
            (Some(Command::Version), "V"),
            (Some(asked(384)), "G38438501"),
            (None, "G00100101"),
            (Some(asked(383)), "G38338501"),
            (None, "idle"),
            (None, "G00200201"),
            (None, "X"),
            (Some(Command::LaserOff), "L0"),
            (None, "G00300301"),
        ]
    );
    assert_eq!(heard[2].1, "G38438501\n0\nCBB");
    assert_eq!((heard[4].1.as_str(), heard[4].2), ("G38338501\n0\nCBCBCB", scan.stamp()));
}
