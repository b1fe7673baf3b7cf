//! Several sensors merged into one cloud of points, in the frame of the vehicle:
//!
//! ```sh
//! cargo run --example merged emulated@0.2,0,0 emulated@-0.2,0,180
//! cargo run --example merged serial:H0713090@0.2,0,0 serial:H0713091@-0.2,0,180,upside-down
//! ```
//!
//! Each sensor has its place: metres ahead, metres to the left, degrees counter-clockwise, and
//! `upside-down` if it is mounted so.
//! Name sensors by their serial numbers, since USB ports are numbered in the order of
//! plugging. Each line names the sensors without a fresh scan, and the reason.

mod port;

use std::time::Duration;

use tokio::time::{MissedTickBehavior, interval};
use tokio_scip::scan::Pose;
use tokio_scip::{ErrorChain, Point, Rate, ScanStream, Sensor, Window};

const PERIOD: Duration = Duration::from_millis(100);
/// An older scan shows where things were, and not where they are.
const LIMIT: Duration = Duration::from_millis(300);

/// Parses `X,Y,DEGREES`, with or without `,upside-down`.
pub(crate) fn parse(text: &str) -> Option<Pose> {
    let upright = text.strip_suffix(",upside-down");
    let numbers = upright.unwrap_or(text).split(',').map(|number| number.parse().ok());
    let numbers: Vec<f64> = numbers.collect::<Option<_>>()?;
    let &[x, y, degrees] = numbers.as_slice() else { return None };
    Some(Pose { x, y, heading: degrees.to_radians(), upside_down: upright.is_some() })
}

/// A sensor on the vehicle.
pub(crate) struct Mounted {
    pub(crate) port: String,
    pub(crate) pose: Pose,
    pub(crate) scans: ScanStream,
}

/// Merges the newest scans. Returns the ports without a fresh scan, with the reasons.
pub(crate) fn merge(sensors: &[Mounted], cloud: &mut Vec<Point>) -> Vec<String> {
    cloud.clear();
    let mut reasons = Vec::new();
    for Mounted { port, pose, scans } in sensors {
        if let Err(error) = scans.freshness().check(LIMIT) {
            reasons.push(format!("{port}: {}", ErrorChain(&error)));
        } else if let Some(scan) = scans.latest() {
            cloud.extend(pose.transform_scan(&scan));
        }
    }
    reasons
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut sensors = Vec::new();
    for argument in std::env::args().skip(1) {
        let (port, pose) = argument.rsplit_once('@').ok_or("expected PORT@X,Y,DEGREES")?;
        let pose = parse(pose).ok_or("expected X,Y,DEGREES after the @")?;
        let sensor = port::open(Sensor::builder().name(port).wait_for_sensor(true), port).await?;
        let scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
        sensors.push(Mounted { port: port.to_owned(), pose, scans });
    }
    if sensors.is_empty() {
        return Err("expected PORT@X,Y,DEGREES, such as emulated@0,0,0, once or more".into());
    }
    let mut cloud = Vec::new();
    let mut ticks = interval(PERIOD);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    loop {
        ticks.tick().await;
        let reasons = merge(&sensors, &mut cloud);
        let fresh = sensors.len() - reasons.len();
        print!("{fresh} of {} sensors, {} points", sensors.len(), cloud.len());
        reasons.iter().for_each(|reason| print!("; {reason}"));
        println!();
    }
}
