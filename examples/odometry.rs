//! Estimates the sensor's own motion from its scans alone, by iterative closest points:
//!
//! ```sh
//! cargo run --example odometry emulated
//! ```
//!
//! The emulated sensor drives 2 m through a room, so its true pose is known: each line has the
//! error. Within 5 cm it works where walls in different directions are in range, and at the
//! speed of a walking person.

use tokio_scip::scan::Pose;
use tokio_scip::{Error, Point, Rate, Scan, Sensor, Window};

/// Points of a wall are at most this far apart, in metres.
const WALL: f64 = 0.2;
/// After this way the newest scan becomes the reference, in metres.
const KEYFRAME: f64 = 0.4;
/// Largest distances of a point from its wall, in metres, from the first match to the last.
const GATES: [f64; 8] = [0.3, 0.3, 0.2, 0.2, 0.1, 0.1, 0.05, 0.05];

/// Point of a wall, and the direction across the wall.
#[derive(Clone, Copy)]
struct WallPoint {
    x: f64,
    y: f64,
    across: (f64, f64),
}

/// Poses at the first ray of each scan, in the frame of the first one.
#[derive(Default)]
pub(crate) struct Odometry {
    pose: Pose,
    /// Motion from one scan to the next, in the frame of the earlier one.
    motion: Pose,
    keyframe: Pose,
    reference: Vec<WallPoint>,
}

impl Odometry {
    /// Returns the pose of a scan.
    pub(crate) fn add(&mut self, scan: &Scan) -> Pose {
        let guess = self.keyframe.inverse() * self.pose * self.motion;
        // Moves each ray to the place of the first one.
        let points: Vec<_> = scan.points().map(|point| steady(point, self.motion, scan)).collect();
        let matched = align(&self.reference, &points, guess);
        let pose = self.keyframe * matched;
        if !self.reference.is_empty() {
            self.motion = self.pose.inverse() * pose;
        }
        self.pose = pose;
        if self.reference.is_empty() || matched.x.hypot(matched.y) > KEYFRAME {
            let points: Vec<_> =
                scan.points().map(|point| steady(point, self.motion, scan)).collect();
            (self.keyframe, self.reference) = (pose, walls(&points));
        }
        pose
    }
}

/// Moves a point to where the first ray would have seen it.
fn steady(point: Point, motion: Pose, scan: &Scan) -> (f64, f64) {
    let share = f64::from(point.offset) / scan.scan_time().as_secs_f64();
    let Pose { x, y, heading, .. } = motion;
    let part = Pose { x: x * share, y: y * share, heading: heading * share, ..motion };
    part.transform(point.x, point.y)
}

/// Points between two others of the same wall.
fn walls(points: &[(f64, f64)]) -> Vec<WallPoint> {
    let triples = points.windows(5).filter_map(|points| match *points {
        [before, _, (x, y), _, after] => {
            let (dx, dy) = (after.0 - before.0, after.1 - before.1);
            let length = dx.hypot(dy);
            let across = (-dy / length, dx / length);
            let is_straight = ((x - before.0) * across.0 + (y - before.1) * across.1).abs() < 0.02;
            (length < WALL && is_straight).then_some(WallPoint { x, y, across })
        }
        _ => None,
    });
    triples.collect()
}

/// Returns the pose that moves `points` onto the walls, from `guess` on.
fn align(reference: &[WallPoint], points: &[(f64, f64)], guess: Pose) -> Pose {
    let mut pose = guess;
    for gate in GATES {
        // The least squares of the distances across the walls.
        let (mut matrix, mut vector) = ([[0.0; 3]; 3], [0.0; 3]);
        for &(x, y) in points.iter().step_by(4) {
            let (x, y) = pose.transform(x, y);
            let distance = |wall: &&WallPoint| (x - wall.x).powi(2) + (y - wall.y).powi(2);
            let nearest = reference.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
            let Some(wall) = nearest.filter(|wall| distance(wall) < gate * gate) else { continue };
            let (nx, ny) = wall.across;
            let error = nx * (wall.x - x) + ny * (wall.y - y);
            // A shift along x and y changes it, and a rotation around the sensor.
            let rotation = ny * (x - pose.x) - nx * (y - pose.y);
            let row = [nx, ny, rotation];
            for (line, a) in matrix.iter_mut().zip(row) {
                for (cell, b) in line.iter_mut().zip(row) {
                    *cell += a * b;
                }
            }
            for (sum, a) in vector.iter_mut().zip(row) {
                *sum += a * error;
            }
        }
        let Some([x, y, heading]) = solve(matrix, vector) else { break };
        pose = Pose { x: pose.x + x, y: pose.y + y, heading: pose.heading + heading, ..pose };
    }
    pose
}

/// Solves a symmetric system, by Cramer's rule. Returns `None` if it has no one solution, as in
/// an endless corridor.
fn solve([a, b, c]: [[f64; 3]; 3], right: [f64; 3]) -> Option<[f64; 3]> {
    let volume = |[ax, ay, az]: [f64; 3], [bx, by, bz]: [f64; 3], [cx, cy, cz]: [f64; 3]| {
        ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    };
    let whole = volume(a, b, c);
    let shares = [volume(right, b, c), volume(a, right, c), volume(a, b, right)];
    (whole > 1e-6).then(|| shares.map(|share| share / whole))
}

/// A room, and the way of the sensor through it: 2 m in 5 s, with a turn of 30 degrees.
pub(crate) mod emulated {
    use std::time::Duration;

    use tokio_scip::scan::Pose;
    use urg_emulator::{Emulator, Path, Scene};

    fn path() -> Path {
        let pose = |x, y, degrees: f64| {
            let heading = degrees.to_radians();
            Pose { x, y, heading, ..Pose::default() }
        };
        Path::new([
            (Duration::from_secs(1), pose(-1.0, -0.4, 0.0)),
            (Duration::from_secs(3), pose(0.0, -0.3, 10.0)),
            (Duration::from_secs(6), pose(1.0, 0.1, 30.0)),
        ])
    }

    pub(crate) fn sensor(seed: u64) -> Emulator {
        let room = Scene::new(seed).rectangle((-2.0, -2.0), (3.0, 2.0));
        let furnished = room.rectangle((0.5, 1.4), (1.5, 2.0)).disc((1.8, -1.0), 0.15);
        Emulator::builder().world(furnished.sensor_on(path())).usb().build()
    }

    /// Returns the true pose of the latest scan, in the frame of the sensor's start.
    pub(crate) fn truth(emulator: &Emulator) -> Option<Pose> {
        let first_ray = emulator.sent_scans().last()?.time.at_step(44);
        Some(path().pose(Duration::ZERO).inverse() * path().pose(first_ray))
    }
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Error> {
    let port = std::env::args().nth(1).unwrap_or("emulated".to_owned());
    let emulator = (port == "emulated").then(|| emulated::sensor(1));
    let sensor = match &emulator {
        Some(emulator) => Sensor::builder().connect(emulator.clone()).await?,
        None => Sensor::open(port).await?,
    };
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
    let mut odometry = Odometry::default();
    while let Some(scan) = scans.next().await {
        let Ok(scan) = scan else { continue }; // the motion goes on
        let Pose { x, y, heading, .. } = odometry.add(&scan);
        print!("x {x:.3} y {y:.3} heading {:.1}°", heading.to_degrees());
        match emulator.as_ref().and_then(emulated::truth) {
            Some(truth) => println!(", off by {:.3} m", (x - truth.x).hypot(y - truth.y)),
            None => println!(),
        }
    }
    Ok(())
}
