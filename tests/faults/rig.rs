//! A sensor, a stream of its scans, and one fault in the middle of it.

use tokio_scip::emulator::{Builder, Emulator, Fault, Faults, Pace};
use tokio_scip::{Error, Rate, Scan, ScanStream, Sensor, Stats, Window};

use crate::common::{Truth, builder, truthful};

/// A sensor that answers at once, on USB, and puts the truth into its data.
pub(crate) fn prompt() -> Builder {
    truthful().pace(Pace::AtOnce)
}

pub(crate) async fn open(emulator: &Emulator) -> Sensor {
    builder().ring_depth(16).connect(emulator.clone()).await.unwrap()
}

/// The next `count` scans, whatever errors come between.
pub(crate) async fn scans(stream: &mut ScanStream, count: usize) -> Vec<Scan> {
    let mut scans = Vec::new();
    while scans.len() < count {
        scans.extend(stream.next().await.unwrap());
    }
    scans
}

/// What of these scans is not the truth, a line each.
pub(crate) fn lies(emulator: &Emulator, scans: &[Scan]) -> Vec<String> {
    let mut truth = Truth::of(&emulator.log());
    scans.iter().filter_map(|scan| truth.check(scan).err()).collect()
}

/// What became of a stream whose second poll met a fault.
#[derive(Debug)]
pub(crate) struct Outcome {
    /// Errors that the stream told of.
    pub(crate) errors: Vec<Error>,
    /// Whether there is a scan that answers the poll with the fault.
    pub(crate) accepted: bool,
    pub(crate) stats: Stats,
}

/// Polls ten times a second; the reply to the second poll has `faults`. However
/// that ends, the polls after it bring scans, and every scan is true.
pub(crate) async fn second_poll(window: Window, faults: &[Fault]) -> Outcome {
    let emulator = prompt().build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(window, Rate::hz(10.0)).await.unwrap();
    let mut delivered = scans(&mut stream, 1).await;
    let damaged = emulator.counts().scans;
    let script = faults.iter().fold(Faults::none(), |script, fault| script.at(0, fault.clone()));
    emulator.set_faults(script);
    let mut errors = Vec::new();
    while delivered.len() < 3 {
        match stream.next().await.unwrap() {
            Ok(scan) => delivered.push(scan),
            Err(error) => errors.push(error),
        }
    }
    assert_eq!(lies(&emulator, &delivered), [""; 0], "{faults:?}");
    let accepted = delivered.iter().any(|scan| crate::common::request_of(scan) == Some(damaged));
    let stats = sensor.stats();
    assert_eq!((stats.disconnects, stats.reconnects), (0, 0), "{faults:?}: the link was given up");
    Outcome { errors, accepted, stats }
}
