//! Several sensors merged into one cloud of points, in the frame of the vehicle:
//!
//! ```sh
//! cargo run --example merged emulated@0.2,0,0 emulated@-0.2,0,180
//! cargo run --example merged serial:H0713090@0.2,0,0 serial:H0713091@-0.2,0,180
//! ```
//!
//! Each sensor has its place: metres ahead, metres to the left, degrees counter-clockwise.
//! Name sensors by their serial numbers, since USB ports are numbered in the order of
//! plugging.

mod port;

use std::time::Duration;

use tokio::time::{MissedTickBehavior, interval};
use tokio_scip::scan::Pose;
use tokio_scip::{Point, Rate, ScanStream, Sensor, Window};

const PERIOD: Duration = Duration::from_millis(100);
/// An older scan shows where things were, and not where they are.
const LIMIT: Duration = Duration::from_millis(300);

/// Parses `X,Y,DEGREES`.
pub(crate) fn parse(text: &str) -> Option<Pose> {
    let numbers: Vec<f64> =
        text.split(',').map(|number| number.parse().ok()).collect::<Option<_>>()?;
    let &[x, y, degrees] = numbers.as_slice() else { return None };
    Some(Pose { x, y, heading: degrees.to_radians() })
}

/// Merges the newest scan of each sensor that has a fresh one. Returns how many have.
pub(crate) fn merge(sensors: &[(Pose, ScanStream)], cloud: &mut Vec<Point>) -> usize {
    cloud.clear();
    let newest = sensors.iter().filter_map(|(pose, scans)| Some((pose, scans.latest()?)));
    let mut count = 0;
    for (pose, scan) in newest.filter(|(_, scan)| scan.age() < LIMIT) {
        cloud.extend(pose.transform_scan(&scan));
        count += 1;
    }
    count
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut sensors = Vec::new();
    for argument in std::env::args().skip(1) {
        let (port, pose) = argument.rsplit_once('@').ok_or("expected PORT@X,Y,DEGREES")?;
        let pose = parse(pose).ok_or("expected X,Y,DEGREES behind the @")?;
        let builder = Sensor::builder().name(port).wait_for_sensor(true);
        let sensor = port::open(builder, port).await?;
        sensors.push((pose, sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?));
    }
    if sensors.is_empty() {
        return Err("expected PORT@X,Y,DEGREES, such as emulated@0,0,0, once or more".into());
    }
    let mut cloud = Vec::new();
    let mut ticks = interval(PERIOD);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    loop {
        ticks.tick().await;
        let fresh = merge(&sensors, &mut cloud);
        println!("{fresh} of {} sensors, {} points", sensors.len(), cloud.len());
    }
}
