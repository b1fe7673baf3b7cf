//! A sensor is restarted by its own command.

use std::future::pending;
use std::pin::pin;
use std::sync::{Arc, Mutex};
use std::task::{Context, Wake, Waker};
use std::time::Duration;

use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader, duplex, split};
use tokio::time::{Instant, sleep};
use tokio_scip::state::StateWatch;
use tokio_scip::{Error, ErrorKind, Rate, Sensor, State, Window};
use urg_emulator::{Emulator, Fault, Faults, Model};

use super::refusals::{PARAMETERS, VERSION};
use super::{next, numbered, revolution};
use crate::common::builder;

const MODELS: [Model; 3] = [Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx];

/// Number of commands to restart that the sensor has had.
fn commands(emulator: &Emulator) -> usize {
    emulator.log().iter().filter(|line| line.line.starts_with(b"RB")).count()
}

async fn clock(sensor: &Sensor) -> u32 {
    sensor.sensor_state().await.unwrap().unwrap().clock.unwrap()
}

#[tokio::test(start_paused = true)]
async fn a_sensor_that_was_restarted_measures_again() {
    for model in MODELS {
        let emulator = numbered(model).build();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        for _ in 0..200 {
            next(&mut stream).await;
        }
        let before = clock(&sensor).await;
        sensor.reboot().await.unwrap();
        assert_eq!(commands(&emulator), 2, "{model:?}");
        let scan = loop {
            if let Ok(scan) = stream.next().await.unwrap() {
                break scan;
            }
        };
        revolution(&scan);
        assert!(clock(&sensor).await < before, "{model:?}");
        assert_eq!(sensor.stats().reconnects, 1, "{model:?}");
    }
}

/// As soon as one that was power-cycled: `guide/recovery.md` says 2 s on USB.
#[tokio::test(start_paused = true)]
async fn a_sensor_that_boots_for_long_is_found_again() {
    for model in MODELS {
        for boot in [1_000, 1_300, 2_100, 6_110, 6_800].map(Duration::from_millis) {
            let emulator = numbered(model).boot_time(boot).build();
            let opening = builder().wait_for_sensor(true).connect(emulator);
            let sensor = opening.await.unwrap();
            let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
            while stream.next().await.unwrap().is_err() {}
            let asked = Instant::now();
            sensor.reboot().await.unwrap();
            // It answers for another second.
            let booted = asked + Duration::from_secs(1) + boot;
            while stream.next().await.unwrap().is_err() || Instant::now() < booted {}
            let late = booted.elapsed();
            assert!(late < Duration::from_secs(2), "{model:?} after {boot:?}: {late:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_laser_that_was_switched_off_stays_off() {
    for model in MODELS {
        let emulator = numbered(model).build();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        sensor.laser_off().await.unwrap();
        sensor.reboot().await.unwrap();
        let error = sensor.scan(Window::DETECTION).await.unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::LaserOff), "{model:?}: {error}");
        assert_eq!((sensor.stats().reconnects, emulator.is_laser_on()), (1, false), "{model:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn what_is_lost_is_sent_again() {
    for fault in [Fault::Lost, Fault::CommandLost] {
        for which in 0..2 {
            let emulator = numbered(Model::Ust10lx).build();
            let sensor = builder().connect(emulator.clone()).await.unwrap();
            sleep(Duration::from_secs(60)).await;
            let before = clock(&sensor).await;
            emulator.set_faults(Faults::none().at(which, fault.clone()));
            sensor.reboot().await.unwrap();
            assert!(clock(&sensor).await < before, "{which}: {fault:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_sensor_restarts_although_all_replies_are_lost() {
    let emulator = numbered(Model::Ust10lx).boot_time(Duration::from_secs(5)).build();
    let sensor = builder().wait_for_sensor(true).connect(emulator.clone()).await.unwrap();
    sensor.watch_state().connected().await.unwrap();
    emulator.set_faults(Faults::none().on("RB", Fault::Lost));
    sensor.reboot().await.unwrap();
    assert_eq!(emulator.counts().resets, 1);
}

#[tokio::test(start_paused = true)]
async fn a_sensor_that_refuses_goes_on() {
    let emulator = numbered(Model::Urg04lxUg01).build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    emulator.set_faults(Faults::none().on("RB", Fault::Status(b'E')));
    let error = sensor.reboot().await.unwrap_err();
    assert!(error.to_string().contains("refused RB with status '0E'"), "{error}");
    sensor.scan(Window::DETECTION).await.unwrap();
    assert_eq!((commands(&emulator), sensor.stats().reconnects), (1, 0));
}

#[tokio::test(start_paused = true)]
async fn scip_1_has_no_such_command() {
    let sensor = builder().connect(numbered(Model::Urg04lx).build()).await.unwrap();
    let error = sensor.reboot().await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::UnsupportedReboot), "{error}");
    assert!(error.to_string().contains("power-cycle it"), "{error}");
    sensor.scan(Window::DETECTION).await.unwrap();
}

/// Sensor that restarts at the second command, and is silent then, or hangs up. It answers the first one,
/// or neither.
async fn restart_without_an_answer(hangs_up: bool, is_mute: bool) -> Result<(), Error> {
    let (near, far) = duplex(4096);
    tokio::spawn(async move {
        let (read, mut write) = split(far);
        let (mut commands, mut restarts) = (BufReader::new(read).lines(), 0);
        while let Ok(Some(command)) = commands.next_line().await {
            let reply = match command.get(..2) {
                Some("RB") if restarts == 1 && hangs_up => return,
                Some("RB") if restarts == 1 => break,
                Some("RB") => {
                    restarts += 1;
                    if is_mute {
                        continue;
                    }
                    "01Q"
                }
                Some("VV") => VERSION,
                Some("PP") => PARAMETERS,
                Some("GD") => "10Q",
                _ => "00P",
            };
            write.write_all(format!("{command}\n{reply}\n\n").as_bytes()).await.unwrap();
        }
        pending::<()>().await;
    });
    let sensor = builder().attach(near).await.unwrap();
    sensor.reboot().await
}

#[tokio::test(start_paused = true)]
async fn a_sensor_may_restart_without_an_answer() {
    for (hangs_up, is_mute) in [(false, false), (true, false), (false, true), (true, true)] {
        restart_without_an_answer(hangs_up, is_mute).await.unwrap();
    }
}

#[tokio::test(start_paused = true)]
async fn a_dead_sensor_does_not_restart() {
    let emulator = numbered(Model::Ust10lx).build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    emulator.set_faults(Faults::none().every(Fault::CommandLost));
    let error = sensor.reboot().await.unwrap_err();
    assert!(error.to_string().contains("did not answer RB within 400 ms"), "{error}");
}

/// Reads the state at the moment when the waker is called.
struct AtWake {
    state: StateWatch,
    seen: Mutex<Option<State>>,
}

impl Wake for AtWake {
    fn wake(self: Arc<Self>) {
        *self.seen.lock().unwrap() = Some(self.state.get());
    }
}

#[tokio::test(start_paused = true)]
async fn the_link_is_lost_before_the_caller_knows() {
    let sensor = builder().connect(numbered(Model::Ust10lx).build()).await.unwrap();
    let at_wake = Arc::new(AtWake { state: sensor.watch_state(), seen: Mutex::default() });
    let waker = Waker::from(Arc::clone(&at_wake));
    let mut reboot = pin!(sensor.reboot());
    while reboot.as_mut().poll(&mut Context::from_waker(&waker)).is_pending() {
        sleep(Duration::from_millis(1)).await;
    }
    let seen = at_wake.seen.lock().unwrap().take();
    assert!(matches!(seen, Some(State::Recovering)), "{seen:?}");
    sensor.watch_state().connected().await.unwrap();
    assert!(clock(&sensor).await < 2000);
}

#[tokio::test(start_paused = true)]
async fn requests_wait_until_the_sensor_is_back() {
    for boot in [0, 1, 4] {
        let boot = Duration::from_secs(boot);
        let emulator = numbered(Model::Utm30lx).boot_time(boot).build();
        let patient = builder().request_timeout(Duration::from_secs(10));
        let sensor = patient.connect(emulator.clone()).await.unwrap();
        sleep(Duration::from_secs(60)).await;
        let (mut stream, start) =
            (sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap(), Instant::now());
        next(&mut stream).await;
        sensor.reboot().await.unwrap();
        let scan = sensor.scan(Window::DETECTION).await.unwrap();
        assert_eq!((emulator.counts().resets, scan.reconnects()), (1, 1), "{boot:?}");
        assert!(clock(&sensor).await < 60_000, "{boot:?}");
        assert!(start.elapsed() < boot + Duration::from_millis(4500), "{:?}", start.elapsed());
    }
}
