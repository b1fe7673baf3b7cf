//! The observer receives every frame, unchanged.

use std::sync::{Arc, Mutex};

use tokio_scip::protocol::Command;
use tokio_scip::{Sensor, Window};
use urg_emulator::{Emulator, Fault, Faults, Fixed};

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
    // One goes before the scan's reply, one before the laser's.
    let foreign = Fault::Insert(0, b"X\n0\n\n".to_vec());
    emulator.set_faults(Faults::none().at(0, Fault::Drop(14..15)).at(3, foreign));
    let window = Window::new(384..=385).unwrap();
    // A malformed reply, a fence, and then a whole scan.
    let scan = sensor.scan(window).await.unwrap();
    assert!(scan.raw_values().eq([1234, 1234]));
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
    assert_eq!((replies[2].1.as_str(), replies[2].2), ("G38338501\n0\nCBCBCB", scan.times().stamp));
}

#[tokio::test(start_paused = true)]
async fn observers_receive_every_reply_in_order() {
    let replies = Arc::new(Mutex::new(Vec::new()));
    let mut builder = Sensor::builder();
    for observer in 0..3 {
        let sink = Arc::clone(&replies);
        builder = builder.on_reply(move |reply| {
            sink.lock().unwrap().push((observer, reply.command, reply.bytes.to_vec()));
        });
    }
    let sensor = builder.connect(Emulator::default()).await.unwrap();
    sensor.scan(Window::DETECTION).await.unwrap();
    let replies = replies.lock().unwrap();
    assert!(replies.len() > 6 && replies.len() % 3 == 0, "{}", replies.len());
    for same in replies.chunks(3) {
        assert_eq!(same.iter().map(|reply| reply.0).collect::<Vec<_>>(), [0, 1, 2]);
        assert!(same.iter().all(|reply| (reply.1, &reply.2) == (same[0].1, &same[0].2)));
    }
}

#[tokio::test(start_paused = true)]
async fn an_observation_begins_with_the_version() {
    let sensor = Sensor::builder().connect(Emulator::default()).await.unwrap();
    let window = Window::new(384..=385).unwrap();
    sensor.scan(window).await.unwrap();
    let commands = Arc::new(Mutex::new(Vec::new()));
    let sink = Arc::clone(&commands);
    let observation = sensor.observe_replies(move |reply| {
        let bytes = reply.bytes.to_vec();
        sink.lock().unwrap().push((reply.command.map(|command| command.bytes()[0]), bytes));
    });
    {
        let commands = commands.lock().unwrap();
        assert_eq!(commands.len(), 1, "the known version, at once");
        assert_eq!(commands[0].0, Some(b'V'));
        assert!(commands[0].1.starts_with(b"V\n0\nVEND:Hokuyo"), "{commands:?}");
    }
    sensor.scan(window).await.unwrap();
    assert_eq!(commands.lock().unwrap()[1].0, Some(b'G'));
    drop(observation);
    sensor.scan(window).await.unwrap();
    assert_eq!(commands.lock().unwrap().len(), 2);
    assert_eq!(Arc::strong_count(&commands), 1, "the driver still has the observer");
}

#[tokio::test(start_paused = true)]
async fn an_observation_keeps_no_driver_running() {
    let builder = Sensor::builder();
    let (first, driver) = builder.clone().build(Emulator::default());
    let mut driver = tokio::spawn(driver);
    first.watch_state().connected().await.unwrap();
    let second = builder.connect(Emulator::default()).await.unwrap();
    let counts = Arc::new(Mutex::new([0, 0]));
    let count = |sensor: usize| {
        let counts = Arc::clone(&counts);
        move |_: tokio_scip::RawReply<'_>| counts.lock().unwrap()[sensor] += 1
    };
    let observations = [first.observe_replies(count(0)), second.observe_replies(count(1))];
    second.scan(Window::DETECTION).await.unwrap();
    assert_eq!(*counts.lock().unwrap(), [1, 2]);
    drop(first);
    (&mut driver).await.unwrap().unwrap();
    drop(observations);
}

/// The list is not locked while an observer runs.
#[tokio::test(start_paused = true)]
async fn an_observer_may_end_its_own_observation() {
    let sensor = Sensor::builder().connect(Emulator::default()).await.unwrap();
    let observation = Arc::new(Mutex::new(None));
    let count = Arc::new(Mutex::new(0));
    let (own, counted) = (Arc::clone(&observation), Arc::clone(&count));
    *observation.lock().unwrap() = Some(sensor.observe_replies(move |reply| {
        if reply.command != Some(Command::Version) {
            *counted.lock().unwrap() += 1;
            own.lock().unwrap().take();
        }
    }));
    sensor.scan(Window::DETECTION).await.unwrap();
    sensor.scan(Window::DETECTION).await.unwrap();
    assert_eq!(*count.lock().unwrap(), 1);
}
