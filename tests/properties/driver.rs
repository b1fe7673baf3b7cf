//! The driver with any behaviour of a port and any use of its handles.

use std::time::Duration;

use tokio::time::{sleep, timeout};
use tokio_scip::protocol::Protocol;
use tokio_scip::{ErrorKind, Rate, Scan, ScanStream, Sensor, State, Window};

use super::peer::Peer;
use super::script::Script;

/// Longer than any call takes: a fence may be sent six times, a command twice, the laser
/// be switched and confirmed twice, and the sensor be lost and found again.
const CALL_LIMIT: Duration = Duration::from_secs(40);
/// A second between two attempts to open the port, a stall or a late reply of up to five,
/// and a pass of fences.
const RECOVERY: Duration = Duration::from_secs(15);

/// Whatever the port does, no scan answers another request, every call ends in time, the
/// laser stays off when it was switched off, and scans come again when the port works.
pub(crate) fn the_driver_stands_any_port_and_any_user(script: &[u8]) {
    let mut header = Script::new(script);
    let half = header.below(script.len().max(1));
    let (user, port) = (header.take(half), header.take(usize::MAX));
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    let runtime = runtime.enable_time().start_paused(true).build().unwrap();
    runtime.block_on(use_sensor(Script::new(user), Peer::new(port)));
}

async fn use_sensor(script: Script<'_>, peer: Peer) {
    fastrand::seed(0);
    let builder = Sensor::builder().wait_for_sensor(true).reply_latency(Duration::from_millis(200));
    let protocol = peer.lock().protocol;
    let builder = if protocol == Protocol::Scip2 { builder.protocol(protocol) } else { builder };
    let (sensor, driver) = builder.build(peer.clone());
    let driver = tokio::spawn(driver);
    User { sensor: sensor.clone(), peer: peer.clone(), stream: None, off: None, last: None }
        .follow(script)
        .await;

    peer.heal();
    let recovered = async {
        while !(sensor.laser_on().await.is_ok() && sensor.scan(windows(0)).await.is_ok()) {
            sleep(Duration::from_millis(50)).await;
        }
    };
    timeout(RECOVERY, recovered).await.expect("no scan came when the port worked again");
    timeout(CALL_LIMIT, sensor.close()).await.unwrap();
    timeout(CALL_LIMIT, driver).await.expect("the driver does not end").unwrap().unwrap();
}

fn windows(choice: u8) -> Window {
    Window::new([300..=310, 8..=10, 100..=200][usize::from(choice) % 3].clone()).unwrap()
}

struct User {
    sensor: Sensor,
    peer: Peer,
    stream: Option<ScanStream>,
    /// Number of polls when the laser was certainly off.
    off: Option<u64>,
    /// Last scan of the stream.
    last: Option<Scan>,
}

impl User {
    async fn follow(&mut self, mut script: Script<'_>) {
        while !script.is_over() {
            let (decision, parameter) = (script.byte(), script.byte());
            let limit = match decision & 0x80 {
                0 => CALL_LIMIT,
                _ => Duration::from_millis(5 * u64::from(script.byte())),
            };
            let call = timeout(limit, self.call(decision & 0x7f, parameter)).await;
            assert!(limit < CALL_LIMIT || call.is_ok(), "call {decision} never ended");
            let state = self.peer.lock();
            assert!(self.off.is_none_or(|polls| polls == state.polls), "a poll with the laser off");
            drop(state);
            let ended = matches!(self.sensor.watch_state().get(), State::Closed { .. });
            assert!(!ended, "the driver ended: {:?}", self.sensor.watch_state().get());
        }
    }

    async fn call(&mut self, decision: u8, parameter: u8) {
        let sensor = self.sensor.clone();
        match decision % 8 {
            0 => sleep(Duration::from_millis(10 * u64::from(parameter))).await,
            1 => {
                let window = windows(parameter);
                match sensor.scan(window).await {
                    Ok(scan) => {
                        assert_eq!(scan.len(), window.points());
                        self.peer.lock().check(&scan);
                    }
                    Err(error) => assert!(!matches!(error.kind(), ErrorKind::Closed)),
                }
            }
            2 | 3 => self.read(parameter).await,
            4 => {
                if sensor.laser_off().await.is_ok() {
                    let state = self.peer.lock();
                    assert!(!state.laser);
                    self.off = Some(state.polls);
                }
            }
            5 => {
                self.off = None;
                if sensor.laser_on().await.is_ok() {
                    assert!(self.peer.lock().laser);
                }
            }
            6 => {
                if let Ok(version) = sensor.version().await {
                    assert_eq!(version.serial_number, "H1");
                }
            }
            _ => self.stream = None,
        }
    }

    /// Reads the stream's next item if it comes soon.
    async fn read(&mut self, parameter: u8) {
        let Some(stream) = &mut self.stream else {
            let rate =
                [Rate::hz(10.0), Rate::UNLIMITED, Rate::hz(1.0)][usize::from(parameter / 3) % 3];
            self.stream = self.sensor.scans(windows(parameter), rate).await.ok();
            self.last = None;
            return;
        };
        let Ok(item) = timeout(Duration::from_millis(200), stream.next()).await else { return };
        let Ok(scan) = item.expect("the stream ended") else { return };
        let request = self.peer.lock().check(&scan);
        assert_eq!(scan.len(), stream.window().points());
        if let Some(last) = self.last.replace(scan.clone()) {
            let is_later = match self.peer.lock().protocol {
                Protocol::Scip2 => last.received_at() <= scan.received_at(),
                _ => last.received_at() <= scan.times().requested_at,
            };
            assert!(last.sequence() < scan.sequence() && is_later);
            assert!(self.peer.lock().check(&last) < request);
        }
    }
}
