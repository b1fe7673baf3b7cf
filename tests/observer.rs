//! The observer receives every frame, unchanged.

use std::sync::{Arc, Mutex};

use tokio_scip::emulator::{Emulator, Fault, Faults, Fixed};
use tokio_scip::protocol::Command;
use tokio_scip::{Sensor, Window};

#[tokio::test(start_paused = true)]
async fn the_observer_receives_valid_malformed_and_foreign_replies_and_fences() {
    let emulator = Emulator::builder().world(Fixed::filled(1234)).build();
    let replies = Arc::new(Mutex::new(Vec::new()));
    let sink = Arc::clone(&replies);
    let builder = Sensor::builder().on_reply(move |frame| {
        let text = String::from_utf8(frame.bytes.to_vec()).unwrap();
        sink.lock().unwrap().push((frame.command, text, frame.stamp));
    });
    let sensor = builder.connect(emulator.clone()).await.unwrap();
    replies.lock().unwrap().clear();
    // One in front of the scan's reply, one in front of the laser's.
    let foreign = Fault::Insert(0, b"X\n0\n\n".to_vec());
    emulator.set_faults(Faults::none().at(0, Fault::Drop(14..15)).at(3, foreign));
    let window = Window::new(384..=385).unwrap();
    // A malformed reply, a fence, and then a whole scan.
    let scan = sensor.scan(window).await.unwrap();
    assert_eq!(scan.values(), [1234, 1234]);
    sensor.laser_off().await.unwrap();

    let replies = replies.lock().unwrap();
    let found: Vec<_> = replies
        .iter()
        .map(|(command, text, _)| match (command, text.split('\n').next().unwrap()) {
            // The step of a fence is the driver's choice.
            (None, echo) if echo.starts_with('G') => (None, "a fence"),
            (command, echo) => (*command, echo),
        })
        .collect();
    let asked = |from| Command::Distances(Window::new(from..=385).unwrap());
    assert_eq!(
        found,
        [
            (Some(asked(384)), "G38438501"),
            (None, "a fence"),
            (Some(asked(383)), "G38338501"),
            (None, "X"),
            (None, "a fence"),
            (Some(Command::LaserOff), "L0"),
            (None, "a fence"),
        ]
    );
    assert_eq!(replies[0].1, "G38438501\n0\nCBB");
    assert_eq!((replies[2].1.as_str(), replies[2].2), ("G38338501\n0\nCBCBCB", scan.stamp()));
}
