//! Records scans into a file, and reads them back:
//!
//! ```sh
//! cargo run -p urg-recording --example record_and_read emulated /tmp/run.mcap
//! ```
//!
//! `crowded` takes a `&Scan` and does not know whether the scan comes from a sensor, a
//! recording, or a test that makes it with `Scan::builder`.

#[path = "../../examples/port/mod.rs"]
mod port;

use tokio_scip::{Rate, Scan, Sensor, Window};
use urg_recording::{Recorder, Recording, RecordingError};

const SCANS: usize = 20;

/// Returns the fraction of the rays that meet something within two metres.
pub(crate) fn crowded(scan: &Scan) -> f64 {
    scan.points().filter(|point| point.range < 2.0).count() as f64 / scan.len() as f64
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(2).ok_or("expected a port and the path of a new file")?;

    let sensor = port::open(Sensor::builder(), &port::argument()).await?;
    let mut recorder = Recorder::create(&path)?;
    recorder.observe(&sensor);
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
    recorder.describe(&sensor, &scans).await?;
    let (mut live, mut count) = (0.0, 0);
    while count < SCANS {
        let Some(scan) = scans.next().await else { break };
        recorder.record(&scan)?;
        if let Ok(scan) = scan {
            (live, count) = (live + crowded(&scan), count + 1);
        }
    }
    recorder.finish().await?;
    println!("live:     {count} scans, {:.4} crowded", live / count as f64);

    // Reading blocks the thread: a service calls it in `tokio::task::spawn_blocking`.
    let (recorded, count) = mean(&path)?;
    println!("recorded: {count} scans, {recorded:.4} crowded");
    Ok(())
}

/// Returns the mean over a recording, and the number of its scans. A part of the file that
/// cannot be read is left out.
fn mean(path: &str) -> Result<(f64, usize), RecordingError> {
    let (mut sum, mut count) = (0.0, 0);
    for scan in Recording::open(path)?.scans() {
        match scan {
            Ok(scan) => (sum, count) = (sum + crowded(&scan), count + 1),
            Err(error @ RecordingError::Damaged { .. }) => eprintln!("{error}"),
            Err(error) => return Err(error),
        }
    }
    Ok((sum / count.max(1) as f64, count))
}
