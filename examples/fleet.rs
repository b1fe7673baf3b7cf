//! Many sensors in one process, one task each, and a line each second about all of them:
//!
//! ```sh
//! cargo run --example fleet emulated 100
//! cargo run --example fleet /dev/ttyACM0 tcp://10.0.0.7:2000 serial:H0713090
//! ```
//!
//! Sensors may be absent at the start, come and go. A line names each sensor without a fresh
//! scan, and the reason.

mod port;

use std::future::ready;
use std::time::Duration;

use futures::StreamExt;
use tokio::time::{Instant, sleep};
use tokio_scip::{Error, ErrorChain, Rate, ScanStream, Sensor, Window};

const LIMIT: Duration = Duration::from_millis(500);

/// Sensors with their names.
pub(crate) type Fleet = Vec<(String, Sensor)>;

/// Opens the sensors, and starts a task for each.
pub(crate) async fn open(ports: Vec<String>) -> Result<Fleet, Error> {
    let mut fleet = Fleet::new();
    for (number, port) in ports.iter().enumerate() {
        let name = format!("{number} {port}");
        let sensor = port::open(Sensor::builder().name(&name).wait_for_sensor(true), port).await?;
        let scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
        tokio::spawn(consume(name.clone(), scans));
        fleet.push((name, sensor));
    }
    Ok(fleet)
}

/// Returns the lines about the next second.
pub(crate) async fn report(fleet: &Fleet) -> Vec<String> {
    let scans = || fleet.iter().map(|(_, sensor)| sensor.stats().scans).sum::<u64>();
    let (since, before) = (Instant::now(), scans());
    sleep(Duration::from_secs(1)).await;
    let rate = (scans() - before) as f64 / since.elapsed().as_secs_f64();
    let mut lines = vec![format!("{} sensors, {rate:.0} scans/s", fleet.len())];
    for (name, sensor) in fleet {
        if let Err(stale) = sensor.freshness().check(LIMIT) {
            lines.push(format!("{name}: {}", ErrorChain(&stale)));
        }
    }
    lines
}

/// Handles each scan, as your service would. Errors are in the freshness.
async fn consume(name: String, scans: ScanStream) {
    let mut scans = scans.filter_map(|item| ready(item.ok()));
    while let Some(scan) = scans.next().await {
        if scan.points().all(|point| point.range > 1.0) && scan.sequence() % 100 == 0 {
            println!("{name}: nothing within a metre");
        }
    }
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut ports: Vec<String> = std::env::args().skip(1).collect();
    if let [name, count] = ports.as_slice()
        && let Ok(count) = count.parse()
    {
        ports = vec![name.clone(); count];
    }
    if ports.is_empty() {
        return Err("expected ports, or: emulated 100".into());
    }
    let fleet = open(ports).await?;
    loop {
        report(&fleet).await.iter().for_each(|line| println!("{line}"));
    }
}
