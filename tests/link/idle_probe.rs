//! The probe of an idle link that can lose its sensor without a sign.

use std::time::Duration;

use crate::common::ConnectFn;
use crate::common::hooked::{Hooked, Hooks};
use tokio::time::{Instant, sleep};
use tokio_scip::port::Connect;
use tokio_scip::{BaudRate, Error, ErrorKind, Rate, Sensor, SensorBuilder, State, Window};
use urg_emulator::{Emulator, Fault, Faults, Link};

const S: Duration = Duration::from_secs(1);

/// A link that can die silently, like a TCP connection.
struct Remote;

impl Hooks for Remote {
    fn can_die_silently(&self, _port_can: bool) -> bool {
        true
    }
}

struct ConnectRemote(Emulator);

impl Connect for ConnectRemote {
    type Port = Hooked<Link, Remote>;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        self.0.connect().await.map(|port| Hooked { port, hooks: Remote })
    }
}

/// Opens a sensor on a link that can die silently.
async fn remote(builder: SensorBuilder) -> (Sensor, Emulator) {
    let emulator = Emulator::default();
    let sensor = builder.connect(ConnectRemote(emulator.clone())).await.unwrap();
    (sensor, emulator)
}

/// Counts the commands that the sensor receives in one idle minute.
async fn commands_in_a_minute(emulator: &Emulator) -> u64 {
    let before = emulator.counts().commands;
    sleep(60 * S).await;
    emulator.counts().commands - before
}

#[tokio::test(start_paused = true)]
async fn only_links_that_die_silently_are_probed() {
    let (_sensor, emulator) = remote(Sensor::builder()).await;
    assert!((11..=12).contains(&commands_in_a_minute(&emulator).await), "every five seconds");
    let (_sensor, emulator) = remote(Sensor::builder().idle_probe(None)).await;
    assert_eq!(commands_in_a_minute(&emulator).await, 0, "switched off");

    let emulator = Emulator::default();
    let _local = Sensor::builder().connect(emulator.clone()).await.unwrap();
    assert_eq!(commands_in_a_minute(&emulator).await, 0, "USB reports its end by itself");
    let emulator = Emulator::default();
    let builder = Sensor::builder().idle_probe(Some(10 * S));
    let _local = builder.connect(emulator.clone()).await.unwrap();
    assert!((5..=6).contains(&commands_in_a_minute(&emulator).await), "on request");
}

#[tokio::test(start_paused = true)]
async fn o22_the_probe_detects_a_link_that_died_silently_while_idle() {
    let (sensor, emulator) = remote(Sensor::builder()).await;
    let mut state = sensor.watch_state();
    emulator.set_faults(Faults::none().every(Fault::Lost));
    let start = Instant::now();
    state.wait_for(|state| !matches!(state, State::Connected { .. })).await.unwrap();
    assert!((5 * S..10 * S).contains(&start.elapsed()), "{:?}", start.elapsed());

    emulator.set_faults(Faults::none());
    state.wait_for(|state| matches!(state, State::Connected { .. })).await.unwrap();

    let (sensor, emulator) = remote(Sensor::builder().idle_probe(None)).await;
    emulator.set_faults(Faults::none().every(Fault::Lost));
    sleep(3600 * S).await;
    assert!(matches!(sensor.watch_state().get(), State::Connected { .. }), "nobody asked");
}

#[tokio::test(start_paused = true)]
async fn a_stream_that_polls_more_often_is_not_probed() {
    let (sensor, emulator) = remote(Sensor::builder().idle_probe(Some(2 * S))).await;
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(1.0)).await.unwrap();
    let before = emulator.counts();
    for _ in 0..60 {
        scans.next().await.unwrap().unwrap();
    }
    let after = emulator.counts();
    assert_eq!(after.commands - before.commands, after.scans - before.scans);
    assert_eq!(after.scans - before.scans, 60, "no fence among them");
}

#[tokio::test(start_paused = true)]
async fn the_probe_finds_a_sensor_after_its_restart() {
    let (sensor, emulator) = remote(Sensor::builder()).await;
    sensor.laser_off().await.unwrap();
    emulator.power_cycle();
    assert!(emulator.is_laser_on(), "as after every power-up");
    sleep(6 * S).await;
    assert!(!emulator.is_laser_on());
}

#[tokio::test(start_paused = true)]
async fn requests_that_need_no_exchange_do_not_put_the_probe_off() {
    let (sensor, emulator) = remote(Sensor::builder()).await;
    sensor.laser_off().await.unwrap();
    emulator.power_cycle();
    for _ in 0..3 {
        sleep(4 * S).await;
        drop(sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap());
        let refused = sensor.scan(Window::DETECTION).await.unwrap_err();
        assert!(matches!(refused.kind(), ErrorKind::LaserOff), "{refused:?}");
    }
    assert!(!emulator.is_laser_on(), "no probe has found that the sensor restarted");
}

/// A serial line on a server, which keeps its baud rate.
struct SilentBridge(BaudRate);

impl Hooks for SilentBridge {
    fn baud_rate(&self, _of_port: Option<BaudRate>) -> Option<BaudRate> {
        Some(self.0)
    }

    fn can_die_silently(&self, _port_can: bool) -> bool {
        true
    }
}

#[tokio::test(start_paused = true)]
async fn a_silent_link_is_lost_in_ten_seconds() {
    for baud_rate in BaudRate::ALL {
        let emulator = Emulator::builder().baud_rate(baud_rate).build();
        let bridged = emulator.clone();
        let sensor = Sensor::builder()
            .connect(ConnectFn(move || {
                Ok(Hooked { port: bridged.bridge(baud_rate), hooks: SilentBridge(baud_rate) })
            }))
            .await
            .unwrap();
        let mut state = sensor.watch_state();
        emulator.set_faults(Faults::none().every(Fault::Lost));
        let start = Instant::now();
        state.wait_for(|state| matches!(state, State::Disconnected { .. })).await.unwrap();
        assert!(start.elapsed() <= 10 * S, "{baud_rate}: {:?}", start.elapsed());
    }
}
