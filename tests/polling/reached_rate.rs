//! The rate that a schedule reaches, as the statistics report it.

use std::time::Duration;

use crate::common::{builder, truthful};
use tokio::time::sleep;
use tokio_scip::{Rate, ScanStream, Sensor, SensorBuilder, State, Window};
use urg_emulator::{Emulator, Fault, Faults, Pace};

/// Opens a sensor, and a stream that reaches its rate.
async fn streaming(builder: SensorBuilder) -> (Emulator, Sensor, ScanStream) {
    let emulator = truthful().build();
    let sensor = builder.connect(emulator.clone()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    assert_eq!(reached(&sensor), None, "before three seconds");
    for _ in 0..40 {
        stream.next().await.unwrap().unwrap();
    }
    assert!(reached(&sensor) > Some(9.0), "{:?}", sensor.stats());
    (emulator, sensor, stream)
}

fn reached(sensor: &Sensor) -> Option<f64> {
    sensor.stats().schedules[0].reached
}

async fn wait_for(sensor: &Sensor, is_state: impl FnMut(&State) -> bool) {
    sensor.watch_state().wait_for(is_state).await.map(drop).unwrap();
}

#[tokio::test(start_paused = true)]
async fn it_is_unknown_while_the_link_is_lost() {
    let (emulator, sensor, _stream) = streaming(builder()).await;
    emulator.unplug();
    wait_for(&sensor, |state| matches!(state, State::Disconnected { .. })).await;
    assert_eq!(reached(&sensor), None);
    emulator.plug_in();
    sleep(Duration::from_secs(10)).await;
    assert!(reached(&sensor) > Some(9.0));
}

#[tokio::test(start_paused = true)]
async fn a_silent_sensor_has_no_known_rate() {
    let (emulator, sensor, _stream) = streaming(builder()).await;
    emulator.set_faults(Faults::none().every(Fault::Lost));
    wait_for(&sensor, |state| matches!(state, State::Recovering)).await;
    assert_eq!(reached(&sensor), None);
}

#[tokio::test(start_paused = true)]
async fn it_is_unknown_after_the_driver_ended() {
    let (emulator, sensor, _stream) = streaming(builder().reconnect(false)).await;
    emulator.unplug();
    wait_for(&sensor, |state| matches!(state, State::Closed { .. })).await;
    assert_eq!(reached(&sensor), None);
}

#[tokio::test(start_paused = true)]
async fn it_is_unknown_after_the_driver_was_closed() {
    let (_emulator, sensor, _stream) = streaming(builder()).await;
    sensor.close().await;
    assert_eq!(reached(&sensor), None);
}

#[tokio::test(start_paused = true)]
async fn it_is_unknown_after_the_driver_was_dropped() {
    let (sensor, driver) = builder().build(truthful().build());
    let driver = tokio::spawn(driver);
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    for _ in 0..40 {
        stream.next().await.unwrap().unwrap();
    }
    driver.abort();
    assert!(driver.await.unwrap_err().is_cancelled());
    assert_eq!(reached(&sensor), None);
}

#[tokio::test(start_paused = true)]
async fn it_is_unknown_while_the_laser_is_off() {
    let (_emulator, sensor, _stream) = streaming(builder()).await;
    sensor.laser_off().await.unwrap();
    assert_eq!(reached(&sensor), None);
    sleep(Duration::from_secs(60)).await;
    sensor.laser_on().await.unwrap();
    sleep(Duration::from_secs(1)).await;
    assert_eq!(reached(&sensor), None, "before three seconds");
    sleep(Duration::from_secs(10)).await;
    assert!(reached(&sensor) > Some(9.0));
}

#[tokio::test(start_paused = true)]
async fn damaged_replies_are_polled_once_a_revolution() {
    let emulator = truthful().usb().pace(Pace::AtOnce).build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    emulator.set_faults(Faults::none().every(Fault::Drop(100..101)));
    let _stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    sleep(Duration::from_secs(20)).await;
    let polls = sensor.stats().polls;
    // 200 revolutions.
    assert!((180..=210).contains(&polls), "{polls}");
}
