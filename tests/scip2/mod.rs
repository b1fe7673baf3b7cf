//! Sensors of SCIP 2 through the same `Sensor`: found without being told, each scan right and once.

mod disturbances;
mod histories;
mod intensities;
mod labels;
mod network;
mod reboot;
mod refusals;
mod serial;
mod streams;
mod subscriptions;
mod swaps;
mod times;

use std::time::Duration;

use tokio::io::AsyncWriteExt;
use tokio::time::timeout;
use tokio_scip::protocol::Protocol;
use tokio_scip::{BaudRate, ErrorKind, Geometry, Rate, Scan, Sensor, State, Window};
use urg_emulator::{Emulator, EmulatorBuilder, Fault, Faults, Firmware, Model, Values, WorldTime};

use crate::common::builder;

/// Returns an emulated sensor that shows the number of the revolution at every step.
fn numbered(model: Model) -> EmulatorBuilder {
    crate::common::limit::limit();
    Emulator::builder().model(model).log_capacity(1 << 16).world(
        |time: WorldTime, values: &mut Values| values.fill(1000 + (time.revolution % 3000) as u32),
    )
}

/// Number of the revolution that a scan shows, if it is one.
fn revolution(scan: &Scan) -> u32 {
    let mut values = scan.raw_values();
    let first = values.next().unwrap();
    assert!(values.all(|value| value == first), "{scan:?}");
    first - 1000
}

async fn next(stream: &mut tokio_scip::ScanStream) -> Scan {
    stream.next().await.unwrap().unwrap()
}

#[tokio::test(start_paused = true)]
async fn every_model_is_found_and_measured() {
    for (model, points, reach) in [
        (Model::Urg04lxUg01, 682, 5600),
        (Model::Utm30lx, 1081, 60_000),
        (Model::Ust10lx, 1081, 30_000),
    ] {
        let emulator = numbered(model).build();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        let geometry = sensor.geometry().await.unwrap();
        assert_eq!(*geometry.distances().end(), reach, "{model:?}");
        let scan = sensor.scan(Window::DETECTION).await.unwrap();
        assert_eq!((scan.len(), scan.geometry()), (points, &geometry), "{model:?}");
        revolution(&scan);
        let version = sensor.version().await.unwrap();
        assert!(!version.serial_number.as_bytes().is_empty(), "{version:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn an_unlimited_stream_has_each_scan_once() {
    for model in [Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx] {
        let emulator = numbered(model).build();
        let sensor = builder().depth(64).connect(emulator).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        let mut latest = revolution(&next(&mut stream).await);
        for _ in 0..1000 {
            let scan = next(&mut stream).await;
            let now = revolution(&scan);
            assert_eq!(now, latest + 1, "{model:?} {scan:?}");
            latest = now;
        }
        assert_eq!(sensor.stats().polls, 1001, "{model:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_urg_speaks_scip_2_if_asked() {
    let emulator = numbered(Model::Urg04lx).firmware(Firmware::V31).build();
    let asked = builder().protocol(Protocol::Scip2);
    let sensor = asked.connect(emulator.clone()).await.unwrap();
    assert_eq!(*sensor.geometry().await.unwrap().distances().end(), 5600);
    revolution(&sensor.scan(Window::DETECTION).await.unwrap());
    sensor.close().await;
    // It stays in SCIP 2 until its power is cut.
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    assert_eq!(*sensor.geometry().await.unwrap().distances().end(), 5600);
    sensor.close().await;
    let error = builder().protocol(Protocol::Scip1).connect(emulator.clone()).await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::WrongProtocol { .. }), "{error}");
    emulator.power_cycle();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    assert_eq!(sensor.geometry().await.unwrap(), Geometry::URG_04LX);
}

#[tokio::test(start_paused = true)]
async fn a_urg_enters_scip_2_although_replies_are_lost() {
    for lost in 1..=2 {
        let faults = (1..=lost).fold(Faults::none(), |faults, n| faults.at(n, Fault::Lost));
        let emulator = numbered(Model::Urg04lx).firmware(Firmware::V31).faults(faults).build();
        builder().protocol(Protocol::Scip2).connect(emulator.clone()).await.unwrap();
        let entries = emulator.log().iter().filter(|line| line.line == b"SCIP2.0").count();
        assert_eq!(entries, lost as usize + 1);
    }
}

#[tokio::test(start_paused = true)]
async fn polls_are_counted_and_find_a_silent_sensor() {
    let emulator = numbered(Model::Ust10lx).build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    sensor.scan(Window::DETECTION).await.unwrap();
    let stats = sensor.stats();
    assert_eq!((stats.polls, stats.refused), (1, 0), "the laser was switched on first");
    emulator.set_faults(Faults::none().every(Fault::CommandLost));
    sensor.scan(Window::DETECTION).await.unwrap_err();
    let mut state = sensor.watch_state();
    let silent = state.wait_for(|state| matches!(state, State::Recovering));
    timeout(Duration::from_secs(5), silent).await.unwrap().unwrap();
}

/// Its laser is off after the search, and probes find it off.
#[tokio::test(start_paused = true)]
async fn a_sensor_that_is_well_refuses_nothing() {
    for model in [Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx] {
        let emulator = numbered(model).build();
        let probing = builder().idle_probe(Some(Duration::from_millis(100)));
        let sensor = probing.connect(emulator.clone()).await.unwrap();
        tokio::time::sleep(Duration::from_secs(1)).await;
        sensor.scan(Window::DETECTION).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        next(&mut stream).await;
        for on in [false, true] {
            if on { sensor.laser_on().await } else { sensor.laser_off().await }.unwrap();
            tokio::time::sleep(Duration::from_secs(1)).await;
            assert_eq!(sensor.scan(Window::DETECTION).await.is_ok(), on);
        }
        drop(stream);
        sensor.reboot().await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::hz(2.0)).await.unwrap();
        while stream.next().await.unwrap().is_err() {}
        assert_eq!(sensor.stats().refused, 0, "{model:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_urg_that_restarted_is_known_by_two_replies() {
    let emulator = numbered(Model::Urg04lx).firmware(Firmware::V31).build();
    let sensor = builder().protocol(Protocol::Scip2).connect(emulator.clone()).await.unwrap();
    emulator.power_cycle();
    while sensor.laser_off().await.is_err() {}
    let log = emulator.log();
    let asked = log.iter().rev().skip_while(|line| line.line != b"SCIP2.0").skip(1);
    // It is silent on `QT`, and refuses the probe in SCIP 1.1.
    let probes = asked.skip_while(|line| line.line.len() == 9);
    assert_eq!(probes.take_while(|line| line.line.starts_with(b"GD")).count(), 2);
}

#[tokio::test(start_paused = true)]
async fn nothing_of_scip_2_is_sent_to_a_sensor_of_scip_1() {
    let emulator = numbered(Model::Urg04lx).firmware(Firmware::V31).build();
    let sensor: Sensor = builder().connect(emulator.clone()).await.unwrap();
    sensor.scan(Window::DETECTION).await.unwrap();
    assert!(emulator.log().iter().all(|line| b"GVLS".contains(&line.line[0])));
}

#[tokio::test(start_paused = true)]
async fn a_window_that_a_sensor_lacks_costs_only_its_stream() {
    let [wide, large] = [768, 1080].map(|last| Window::new(0..=last).unwrap());
    for (model, lacking) in [(Model::Urg04lxUg01, wide), (Model::Urg04lx, large)] {
        let emulator = numbered(model).build();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        for rate in [Rate::hz(10.0), Rate::UNLIMITED] {
            let mut missing = sensor.scans(lacking, rate).await.unwrap();
            let front = Window::degrees(-10.0..=10.0).unwrap();
            let mut front = sensor.scans(front, rate).await.unwrap();
            let error = missing.next().await.unwrap().unwrap_err().to_string();
            assert!(error.contains("this sensor measures steps 44..=725"), "{error}");
            let scan = next(&mut front).await;
            assert_eq!((scan.window().start(), scan.window().end()), (356, 412));
        }
        let error = sensor.scan(lacking).await.unwrap_err().to_string();
        assert!(error.contains("this sensor measures steps 44..=725"), "{error}");
        let is_asked = |line: &[u8]| {
            [&b"GD0000"[..], b"MD0000", b"G00076"].iter().any(|it| line.starts_with(it))
        };
        assert!(emulator.log().iter().all(|line| !is_asked(&line.line)), "{model:?}");
    }
    let sensor = builder().connect(numbered(Model::Ust10lx).build()).await.unwrap();
    assert_eq!(sensor.scan(large).await.unwrap().len(), 1081);
}

#[tokio::test(start_paused = true)]
async fn a_sensor_that_refuses_to_tell_what_it_is_is_waited_for() {
    let refusing = Faults::none().on("PP", Fault::Status(b'M'));
    let emulator = numbered(Model::Ust10lx).faults(refusing).build();
    let sensor = builder().wait_for_sensor(true).connect(emulator.clone()).await.unwrap();
    tokio::time::sleep(Duration::from_secs(10)).await;
    let State::Connecting { error: Some(error) } = sensor.watch_state().get() else { panic!() };
    assert!(matches!(error.kind(), ErrorKind::Refused { .. }), "{error}");
    emulator.set_faults(Faults::none());
    sensor.watch_state().connected().await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn equal_steps_of_different_wishes_are_two_streams() {
    let sensor = builder().connect(numbered(Model::Ust10lx).build()).await.unwrap();
    let steps = Window::new(44..=725).unwrap();
    assert_eq!(steps, Window::DETECTION);
    let mut all = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let mut some = sensor.scans(steps, Rate::hz(10.0)).await.unwrap();
    assert_eq!((next(&mut all).await.len(), next(&mut some).await.len()), (1081, 682));
    // Before there is a sensor, they are the same steps.
    let emulator = numbered(Model::Ust10lx).build();
    let (sensor, driver) = builder().wait_for_sensor(true).build(emulator.clone());
    emulator.unplug();
    tokio::spawn(driver);
    let mut all = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let mut some = sensor.scans(steps, Rate::hz(10.0)).await.unwrap();
    emulator.plug_in();
    assert_eq!((next(&mut all).await.len(), next(&mut some).await.len()), (1081, 682));
}

#[tokio::test(start_paused = true)]
async fn the_laser_stays_as_set_after_a_power_cut() {
    for model in [Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx] {
        let emulator = numbered(model).build();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
        next(&mut stream).await;
        assert!(emulator.is_laser_on(), "{model:?}");
        sensor.laser_off().await.unwrap();
        assert!(!emulator.is_laser_on(), "{model:?}");
        let error = sensor.scan(Window::DETECTION).await.unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::LaserOff), "{model:?} {error}");
        sensor.laser_on().await.unwrap();
        emulator.power_cycle();
        assert!(!emulator.is_laser_on(), "{model:?}");
        while !emulator.is_laser_on() {
            let _ = stream.next().await.unwrap();
        }
        next(&mut stream).await;
    }
}

#[tokio::test(start_paused = true)]
async fn a_stream_of_another_program_is_stopped() {
    for model in [Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx] {
        let emulator = numbered(model).build();
        let mut link = emulator.link();
        link.write_all(b"MD0044072501000\n").await.unwrap();
        tokio::time::sleep(Duration::from_secs(3)).await;
        drop(link);
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
        for _ in 0..10 {
            next(&mut stream).await;
        }
        let stats = sensor.stats();
        assert_eq!((stats.timeouts, stats.malformed.total()), (0, 0), "{model:?}");
    }
}

/// A program that was ended while it read the sensor's clock, or that sent it to sleep.
#[tokio::test(start_paused = true)]
async fn a_sensor_that_was_left_in_another_state_is_measured() {
    for (model, left) in [
        (Model::Urg04lx, "SCIP2.0\nTM0\n"),
        (Model::Urg04lxUg01, "TM0\n"),
        (Model::Utm30lx, "TM0\n"),
        (Model::Ust10lx, "TM0\n"),
        (Model::Ust10lx, "%SL\n"),
    ] {
        let emulator = numbered(model).firmware(Firmware::V31).build();
        let mut link = emulator.link();
        for line in left.split_inclusive('\n') {
            link.write_all(line.as_bytes()).await.unwrap();
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
        drop(link);
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        revolution(&sensor.scan(Window::DETECTION).await.unwrap());
        assert_eq!(sensor.stats().timeouts, 0, "{model:?} {left:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_urg_in_scip_2_changes_its_baud_rate() {
    let emulator = numbered(Model::Urg04lx).firmware(Firmware::V31);
    let emulator = emulator.baud_rate(BaudRate::B19200).build();
    let fast = builder().protocol(Protocol::Scip2).baud_rate(BaudRate::B115200);
    let sensor = fast.connect(emulator.clone()).await.unwrap();
    assert_eq!(emulator.baud_rate(), Some(BaudRate::B115200));
    revolution(&sensor.scan(Window::DETECTION).await.unwrap());
    sensor.set_baud_rate(BaudRate::B57600).await.unwrap();
    assert_eq!(emulator.baud_rate(), Some(BaudRate::B57600));
    emulator.power_cycle();
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(1.0)).await.unwrap();
    while stream.next().await.unwrap().is_err() {}
    assert_eq!(emulator.baud_rate(), Some(BaudRate::B57600));
    assert_eq!(*sensor.geometry().await.unwrap().distances().end(), 5600);
}
