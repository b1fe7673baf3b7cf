//! Counts people at doors, each with a sensor:
//!
//! ```sh
//! cargo run --example count_people serial:H0713090 serial:H0713091
//! cargo run --example count_people emulated
//! ```
//!
//! The doorway must be empty during the first second of each link: the program learns it then,
//! again after a reconnect, because the sensor may have been moved meanwhile. People who walk
//! less than half a metre apart, or one in front of the other, count as one.

mod port;

use std::time::Duration;

use tokio::sync::mpsc;
use tokio::time::timeout;
use tokio_scip::{Error, ErrorChain, Point, Rate, Scan, Sensor, Window};

/// After this time without a scan, the number is unknown.
const LIMIT: Duration = Duration::from_millis(500);
/// Scans of the empty doorway.
const LEARNED: usize = 10;
/// A person is this much nearer than the empty doorway, in metres.
const IN_FRONT: f32 = 0.2;
/// Points of one person are at most this far apart, in metres: a sensor at shin height sees two
/// legs, which a stride parts.
const STRIDE: f32 = 0.5;
/// Fewer points are noise. A leg at 4 m has five.
const POINTS: usize = 3;
/// Number of scans in a row that must agree.
const AGREE: usize = 3;

/// Empty doorway.
#[derive(Default)]
pub(crate) struct Doorway {
    reconnects: u64,
    learned: usize,
    /// Shortest range in each direction.
    background: Vec<f32>,
}

impl Doorway {
    /// Returns the number of people, or `None` while it learns the doorway.
    pub(crate) fn count(&mut self, scan: &Scan) -> Option<usize> {
        if self.background.is_empty() || self.reconnects != scan.reconnects() {
            let background = vec![f32::INFINITY; scan.len()];
            *self = Self { reconnects: scan.reconnects(), learned: 0, background };
        }
        if self.learned < LEARNED {
            self.learned += 1;
            for (known, range) in self.background.iter_mut().zip(scan.ranges()) {
                *known = known.min(range); // of a number and NaN, the number
            }
            return None;
        }
        let rays = scan.rays().zip(&self.background);
        let near = rays.filter(|(ray, known)| ray.measurement.range() < *known - IN_FRONT);
        let mut people: Vec<Vec<Point>> = Vec::new();
        for point in near.filter_map(|(ray, _)| ray.point()) {
            let is_near = |other: &Point| (point.x - other.x).hypot(point.y - other.y) < STRIDE;
            match people.iter_mut().find(|person| person.iter().any(is_near)) {
                Some(person) => person.push(point),
                None => people.push(vec![point]),
            }
        }
        Some(people.iter().filter(|person| person.len() >= POINTS).count())
    }
}

/// A door, and the number of people at it or the reason why it is unknown.
pub(crate) type Report = (String, Result<usize, String>);

/// Sends the number of people at a door whenever it changes.
pub(crate) async fn watch(
    door: String,
    sensor: Sensor,
    reports: mpsc::Sender<Report>,
) -> Result<(), Error> {
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
    let (mut doorway, mut candidate, mut agreed, mut reported) =
        (Doorway::default(), None, 0, None);
    loop {
        let (seen, is_over) = match timeout(LIMIT, scans.next()).await {
            Ok(Some(Ok(scan))) => (doorway.count(&scan), false),
            Ok(Some(Err(_))) => continue, // the freshness keeps it
            Ok(None) => (None, true),
            Err(_) => (None, false),
        };
        agreed = if seen == candidate { agreed + 1 } else { 1 };
        candidate = seen;
        if is_over || agreed >= AGREE && reported != Some(seen) {
            let unknown = || match scans.freshness().check(LIMIT) {
                Ok(()) => "learning the empty doorway".to_owned(),
                Err(stale) => ErrorChain(&stale).to_string(),
            };
            if reports.send((door.clone(), seen.ok_or_else(unknown))).await.is_err() || is_over {
                return Ok(()); // no one counts any more, or the driver has ended
            }
            reported = Some(seen);
        }
    }
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (sender, mut reports) = mpsc::channel(16);
    for door in std::env::args().skip(1) {
        let sensor = port::open(Sensor::builder().name(&door).wait_for_sensor(true), &door).await?;
        tokio::spawn(watch(door, sensor, sender.clone()));
    }
    drop(sender);
    while let Some((door, count)) = reports.recv().await {
        match count {
            Ok(1) => println!("{door}: 1 person"),
            Ok(count) => println!("{door}: {count} people"),
            Err(reason) => println!("{door}: unknown: {reason}"),
        }
    }
    Ok(())
}
