//! The link is lost and comes back, with what the service had asked for.
#![cfg(feature = "emulator")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::time::Duration;

use common::{Truth, builder, ms, truthful};
use tokio::time::Instant;
use tokio_scip::emulator::{Emulator, Fault, Faults, Pace};
use tokio_scip::{BaudRate, Error, Rate, Sensor, State, Window};

async fn open(emulator: &Emulator) -> Sensor {
    builder().connect(emulator.clone()).await.unwrap()
}

#[tokio::test(start_paused = true)]
async fn a_stream_tells_of_the_loss_once_and_goes_on_after_a_replug() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    let mut state = sensor.state();
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    emulator.unplug();
    let error = loop {
        if let Err(error) = stream.next().await.unwrap() {
            break error;
        }
    };
    assert!(matches!(error, Error::Disconnected { .. }), "{error:?}");
    assert!(matches!(*state.borrow_and_update(), State::Disconnected { .. }));
    tokio::time::sleep(Duration::from_secs(60)).await;
    let late = sensor.scans(Window::FULL, Rate::hz(1.0)).await;
    let mut late = late.unwrap();
    assert!(matches!(late.next().await, Some(Err(_))), "a new stream is not told");

    emulator.plug_in();
    let start = Instant::now();
    let scan = stream.next().await.unwrap().unwrap();
    assert!(start.elapsed() < Duration::from_secs(2), "{:?}", start.elapsed());
    Truth::of(&emulator.log()).check(&scan).unwrap();
    assert!(scan.sequence() >= 1);
    late.next().await.unwrap().unwrap();
    assert_eq!((sensor.stats().disconnects, sensor.stats().reconnects), (1, 1));
}

#[tokio::test(start_paused = true)]
async fn d03_a10_an_hour_unplugged_costs_little_and_every_call_is_answered_in_time() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    emulator.unplug();
    for _ in 0..10 {
        let start = Instant::now();
        let error = sensor.scan(Window::FULL).await.unwrap_err();
        assert!(matches!(error, Error::Disconnected { .. }), "{error:?}");
        assert!(start.elapsed() <= ms(5001), "{:?}", start.elapsed());
    }
    tokio::time::sleep(Duration::from_secs(3600)).await;
    emulator.plug_in();
    sensor.scan(Window::FULL).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a10_a_request_made_while_disconnected_is_answered_when_the_sensor_is_back_in_time() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    emulator.unplug();
    let asked = tokio::spawn({
        let sensor = sensor.clone();
        async move { sensor.scan(Window::FULL).await }
    });
    tokio::time::sleep(ms(2000)).await;
    emulator.plug_in();
    asked.await.unwrap().unwrap();
}

#[tokio::test(start_paused = true)]
async fn d01_d02_line_speed_and_laser_are_restored_after_a_reset() {
    let emulator =
        truthful().line_speed(BaudRate::B19200).boot_time(Duration::from_secs(2)).build();
    let sensor = open(&emulator).await;
    sensor.set_baud_rate(BaudRate::B115200).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(5.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    emulator.power_cycle();
    let start = Instant::now();
    let mut errors = Vec::new();
    let scan = loop {
        match stream.next().await.unwrap() {
            Ok(scan) if scan.requested_at() > start.into_std() => break scan,
            Ok(_) => {}
            Err(error) => errors.push(error),
        }
    };
    assert_eq!(scan.len(), 682);
    assert!(!errors.is_empty());
    assert_eq!(emulator.line_speed(), Some(BaudRate::B115200));
    // Two seconds of boot, and at most five to be found.
    assert!(start.elapsed() < Duration::from_secs(7), "{:?}", start.elapsed());

    sensor.laser_off().await.unwrap();
    emulator.power_cycle();
    assert!(emulator.laser());
    // Nothing is polled: the loss shows when something is asked for.
    tokio::time::sleep(Duration::from_secs(10)).await;
    let _ = sensor.set_baud_rate(BaudRate::B57600).await;
    sensor.set_baud_rate(BaudRate::B57600).await.unwrap();
    assert!(!emulator.laser());
}

#[tokio::test(start_paused = true)]
async fn d02_a_laser_that_was_switched_off_stays_off_after_a_replug() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    sensor.laser_off().await.unwrap();
    emulator.unplug();
    emulator.power_cycle();
    assert!(emulator.laser());
    emulator.plug_in();
    let mut state = sensor.state();
    state.wait_for(|state| matches!(state, State::Disconnected { .. })).await.unwrap();
    state.wait_for(|state| matches!(state, State::Connected { .. })).await.unwrap();
    assert!(!emulator.laser());
    let scans = emulator.counts().scans;
    tokio::time::sleep(Duration::from_secs(10)).await;
    assert_eq!(emulator.counts().scans, scans);
    sensor.laser_on().await.unwrap();
    while stream.next().await.unwrap().is_err() {}
}

#[tokio::test(start_paused = true)]
async fn d09_another_sensor_in_its_place_is_refused_once_and_the_right_one_taken() {
    let emulator = truthful().serial_number("H0000001").build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    emulator.unplug();
    emulator.set_serial_number("H0000002");
    emulator.plug_in();
    let mut errors = Vec::new();
    let end = Instant::now() + Duration::from_secs(60);
    while let Ok(item) = tokio::time::timeout_at(end, stream.next()).await {
        errors.extend(item.unwrap().err());
    }
    assert!(
        matches!(
            &errors[..],
            [Error::Disconnected { .. }, Error::AnotherSensor { .. }]
                | [Error::AnotherSensor { .. }]
        ),
        "{errors:?}"
    );
    let state = sensor.state().borrow().clone();
    assert!(matches!(state, State::Disconnected { error: Error::AnotherSensor { .. }, .. }));
    emulator.set_serial_number("H0000001");
    stream.next().await.unwrap().unwrap();
}

#[tokio::test(start_paused = true)]
async fn d09_a_flipped_bit_in_the_serial_number_does_not_turn_the_sensor_away() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    emulator.unplug();
    // After a fence the first V, with its serial number on the fifth line.
    emulator.set_faults(Faults::none().at(1, Fault::Flip(160, 1)));
    emulator.plug_in();
    sensor.scan(Window::FULL).await.unwrap();
    assert_eq!(emulator.fault_counts().flipped, 1);
}

#[tokio::test(start_paused = true)]
async fn without_reconnecting_a_lost_link_is_the_end() {
    let emulator = truthful().build();
    let sensor = builder().reconnect(false).connect(emulator.clone()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    emulator.unplug();
    let mut last = None;
    while let Some(item) = stream.next().await {
        assert!(last.is_none());
        last = item.err();
    }
    assert!(matches!(last, Some(Error::Disconnected { .. })));
    assert!(matches!(sensor.scan(Window::FULL).await, Err(Error::Disconnected { .. })));
    let state = sensor.state().borrow().clone();
    assert!(matches!(state, State::Closed { error: Some(Error::Disconnected { .. }) }));
}

#[tokio::test(start_paused = true)]
async fn an_attached_stream_that_ends_is_the_end() {
    let emulator = truthful().build();
    let sensor = builder().attach(emulator.link()).await.unwrap();
    sensor.scan(Window::FULL).await.unwrap();
    emulator.unplug();
    let error = sensor.scan(Window::FULL).await.unwrap_err();
    assert!(matches!(error, Error::Disconnected { .. }), "{error:?}");
}

#[tokio::test(start_paused = true)]
async fn a_sensor_that_is_silent_for_a_while_is_found_again_on_the_same_port() {
    for speed in [None, Some(BaudRate::B115200)] {
        let mut sensor_builder = truthful();
        if let Some(speed) = speed {
            sensor_builder = sensor_builder.line_speed(speed);
        }
        let emulator = sensor_builder.build();
        let sensor = open(&emulator).await;
        let mut stream = sensor.scans(Window::DETECTION, Rate::hz(5.0)).await.unwrap();
        stream.next().await.unwrap().unwrap();
        emulator.set_faults(Faults::none().every(Fault::CommandLost));
        tokio::time::sleep(Duration::from_secs(30)).await;
        emulator.set_faults(Faults::none());
        let start = Instant::now();
        while stream.next().await.unwrap().is_err() {}
        let limit = if speed.is_some() { 5 } else { 2 };
        assert!(start.elapsed() < Duration::from_secs(limit), "{speed:?}: {:?}", start.elapsed());
    }
}
