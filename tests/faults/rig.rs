//! An emulated sensor, a stream of its scans, and a fault in the middle of the stream.

use tokio_scip::{ErrorKind, Rate, Scan, ScanStream, Sensor, Stats, Window};
use urg_emulator::{Emulator, EmulatorBuilder, Fault, Faults, Pace};

use crate::common::{Truth, builder, truthful};

/// Returns a sensor on USB that answers at once, and writes each request's number into its data.
pub(crate) fn instant_sensor() -> EmulatorBuilder {
    truthful().pace(Pace::AtOnce)
}

pub(crate) async fn open(emulator: &Emulator) -> Sensor {
    builder().depth(16).connect(emulator.clone()).await.unwrap()
}

/// Opens the sensor, and polls it.
pub(crate) async fn streaming(
    emulator: &Emulator,
    window: Window,
    rate: Rate,
) -> (Sensor, ScanStream) {
    let sensor = open(emulator).await;
    let stream = sensor.scans(window, rate).await.unwrap();
    (sensor, stream)
}

/// Reads the next `count` scans and skips errors.
pub(crate) async fn scans(stream: &mut ScanStream, count: usize) -> Vec<Scan> {
    let mut scans = Vec::new();
    while scans.len() < count {
        scans.extend(stream.next().await.unwrap());
    }
    scans
}

/// Returns why scans are wrong, a line each; none if all answer their own requests.
pub(crate) fn wrong_scans(emulator: &Emulator, scans: &[Scan]) -> Vec<String> {
    let mut truth = Truth::from_log(&emulator.log());
    scans.iter().filter_map(|scan| truth.check(scan).err()).collect()
}

/// Result of a stream whose second poll had a fault.
#[derive(Debug)]
pub(crate) struct Outcome {
    /// Errors that the stream yielded.
    pub(crate) errors: Vec<ErrorKind>,
    /// True if a scan answers the poll that had the fault.
    pub(crate) accepted: bool,
    pub(crate) stats: Stats,
}

/// Polls at 10 Hz with `faults` in the reply to the second poll. Asserts that the polls
/// after it bring scans, and that every scan answers its own request.
pub(crate) async fn second_poll(window: Window, faults: &[Fault]) -> Outcome {
    let emulator = instant_sensor().build();
    let (sensor, mut stream) = streaming(&emulator, window, Rate::hz(10.0)).await;
    let mut delivered = scans(&mut stream, 1).await;
    let damaged = emulator.counts().scans;
    let script = faults.iter().fold(Faults::none(), |script, fault| script.at(0, fault.clone()));
    emulator.set_faults(script);
    let mut errors = Vec::new();
    while delivered.len() < 3 {
        match stream.next().await.unwrap() {
            Ok(scan) => delivered.push(scan),
            Err(error) => errors.push(error.kind().clone()),
        }
    }
    assert_eq!(wrong_scans(&emulator, &delivered), [""; 0], "{faults:?}");
    let accepted = delivered.iter().any(|scan| crate::common::request_of(scan) == Some(damaged));
    let stats = sensor.stats();
    assert_eq!((stats.disconnects, stats.reconnects), (0, 0), "{faults:?}: the link was closed");
    Outcome { errors, accepted, stats }
}
