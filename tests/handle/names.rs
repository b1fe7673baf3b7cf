//! Errors name the sensor that they concern, whichever way they reach the service.

use std::process::Command as Process;

use tokio_scip::port::StreamPort;
use tokio_scip::{Error, ErrorKind, Rate, Sensor, State, Window};
use urg_emulator::{Emulator, Fault, Faults};

use crate::common::{ConnectFn, builder, ms, reason};

const WINDOW: Window = Window::DETECTION;

async fn left(emulator: &Emulator) -> Sensor {
    builder().name("left").connect(emulator.clone()).await.unwrap()
}

/// Checks that the error has the name, also in its text, and returns it.
#[track_caller]
fn named(error: Error) -> Error {
    assert_eq!(error.sensor(), Some("left"), "{error}");
    assert!(error.to_string().contains("left"), "{error}");
    error
}

/// Returns the error of a poll whose reply, fence and second reply have the faults.
async fn poll_with(faults: Faults) -> Error {
    let emulator = Emulator::default();
    let sensor = left(&emulator).await;
    emulator.set_faults(faults);
    named(sensor.scan(WINDOW).await.unwrap_err())
}

#[tokio::test(start_paused = true)]
async fn every_error_of_a_request_names_the_sensor() {
    let both = |fault: Fault| Faults::none().at(0, fault.clone()).at(2, fault);
    let error = poll_with(both(Fault::Lost)).await;
    assert!(matches!(error.kind(), ErrorKind::Timeout { .. }), "{error}");
    assert!(error.to_string().starts_with("left did not answer G"), "{error}");
    let error = poll_with(both(Fault::Drop(100..101))).await;
    assert!(matches!(error.kind(), ErrorKind::Malformed { .. }), "{error}");
    assert!(error.to_string().starts_with("the reply of left to G"), "{error}");
    let error = poll_with(Faults::none().every(Fault::Status(b'6'))).await;
    assert!(error.to_string().starts_with("the laser of left stays off"), "{error}");

    let emulator = Emulator::default();
    let sensor = left(&emulator).await;
    sensor.laser_off().await.unwrap();
    let error = named(sensor.scan(WINDOW).await.unwrap_err());
    assert!(matches!(error.kind(), ErrorKind::LaserOff), "{error}");
    emulator.set_faults(Faults::none().every(Fault::Status(b'1')));
    let error = named(sensor.laser_on().await.unwrap_err());
    assert!(error.to_string().starts_with("the laser of left stays off"), "{error}");
    sensor.close().await;
    let error = named(sensor.version().await.unwrap_err());
    assert!(matches!(error.kind(), ErrorKind::Closed), "{error}");
    assert_eq!(error.to_string(), "the driver of left has ended");
}

#[tokio::test(start_paused = true)]
async fn every_stream_error_names_the_sensor() {
    let emulator = Emulator::default();
    let (sensor, driver) = builder().name("left").reconnect(false).build(emulator.clone());
    let driver = tokio::spawn(driver);
    sensor.watch_state().connected().await.unwrap();
    let mut scans = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    scans.next().await.unwrap().unwrap();
    emulator.set_faults(Faults::none().at(0, Fault::Drop(100..101)));
    let error = named(scans.next().await.unwrap().unwrap_err());
    assert!(matches!(error.kind(), ErrorKind::Malformed { .. }), "{error}");
    named(reason(&scans.freshness()));
    named(reason(&sensor.freshness()));

    sensor.laser_off().await.unwrap();
    for freshness in [sensor.freshness(), scans.freshness()] {
        let error = named(reason(&freshness));
        assert!(matches!(error.kind(), ErrorKind::LaserOff), "{error}");
        named(freshness.check(ms(0)).unwrap_err().source.unwrap());
    }
    sensor.laser_on().await.unwrap();
    emulator.unplug();
    let lost = loop {
        if let Err(error) = scans.next().await.unwrap() {
            break error;
        }
    };
    assert!(matches!(named(lost).kind(), ErrorKind::Disconnected { .. }));
    named(driver.await.unwrap().unwrap_err());
    named(sensor.watch_state().connected().await.unwrap_err());
    let State::Closed { error: Some(error) } = sensor.watch_state().get() else { panic!() };
    named(error);
}

#[tokio::test(start_paused = true)]
async fn a_dropped_drivers_watch_names_the_sensor() {
    let (sensor, driver) = builder().name("left").build(Emulator::default());
    drop(driver);
    named(sensor.watch_state().connected().await.unwrap_err());
    named(reason(&sensor.freshness()));
}

#[tokio::test(start_paused = true)]
async fn a_panic_of_the_driver_names_the_sensor() {
    std::panic::set_hook(Box::new(|_| {}));
    let connect = || -> Result<StreamPort<tokio::io::DuplexStream>, Error> { panic!("injected") };
    let (sensor, driver) = builder().name("left").build(ConnectFn(connect));
    assert!(tokio::spawn(driver).await.unwrap_err().is_panic());
    let error = named(sensor.watch_state().connected().await.unwrap_err());
    let _ = std::panic::take_hook();
    assert_eq!(error.to_string(), "the driver of left has panicked: injected");
}

#[test]
fn an_error_of_opening_names_the_port_and_no_program() {
    let errors = [
        ErrorKind::NoSuchPort { port: "left".to_owned() },
        ErrorKind::NotASerialPort { port: "left".to_owned() },
        ErrorKind::Busy { port: "left".to_owned() },
        ErrorKind::NoSuchSensor { serial_number: "left".to_owned(), found: Vec::new() },
    ];
    for error in errors.map(|kind| kind.to_string()) {
        assert!(error.contains("left") && !error.contains("`urg"), "{error}");
    }
}

/// In real time, as a user runs it.
#[test]
fn main_prints_the_error_and_its_remedy() {
    crate::common::limit::limit();
    let tests = std::env::current_exe().unwrap();
    let examples = tests.parent().unwrap().parent().unwrap().join("examples");
    let output = Process::new(examples.join("first_scans")).arg("/dev/no-such-port").output();
    // `cargo test --test it` does not build them.
    let output = output.expect("run `cargo build --examples` first");
    assert!(!output.status.success());
    let text = String::from_utf8(output.stderr).unwrap();
    let remedy = "plug the sensor in, and check the name of the port";
    assert_eq!(text.trim_end(), format!("Error: no port /dev/no-such-port: {remedy}"));
}
