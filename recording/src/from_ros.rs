//! [`MessageScan`]: what a `/scan` message tells about the reply that it was made of. Recordings
//! without replies have nothing else.

use std::f64::consts::TAU;
use std::ops::RangeInclusive;
use std::time::{Duration, SystemTime};

use crate::ros::LaserScan;
use tokio_scip::{Geometry, Scan, Window};

/// Sensor whose scans are read.
const SENSOR: Geometry = Geometry::URG_04LX;
/// Largest difference of an angle from its step, in steps. Other laser scanners have other angles.
const TOLERANCE: f64 = 0.05;
/// Error code 19, "Non-Measurable Distance", in place of all codes that a message has as NaN, and of
/// -Inf: an object that is too near (REP 117). The code never counts as free.
const UNKNOWN: u32 = 19;
/// Error code 16, "in the range 4096mm~5.6m", in place of all codes that a message has as infinite.
const BEYOND_RANGE: u32 = 16;
/// Error code 0, "at 22m", for distances that code 16 excludes.
const FAR: u32 = 0;
/// Motors turn once in 25 to 200 ms. A time beyond these limits is in another unit, or is none.
const REVOLUTIONS: RangeInclusive<f32> = 0.001..=1.0;

/// Scan of a URG, as far as a message has it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MessageScan {
    pub(super) window: Window,
    pub(super) values: Vec<u32>,
    /// Wall clock at the end of the revolution: when the reply arrived, unless it was late.
    pub(super) stamp: SystemTime,
    /// Time of one revolution, if the message has it.
    pub(super) scan_time: Option<Duration>,
}

impl MessageScan {
    /// Converts a message. `known` are the windows of the recorded streams, because a message does
    /// not tell how many steps its last point has. Returns `None` if the message has other
    /// directions than the steps of a URG.
    pub(super) fn from_message(
        message: &LaserScan,
        known: impl IntoIterator<Item = Window>,
    ) -> Option<Self> {
        let mut windows = known.into_iter().chain(by_definition(message)).chain(by_steps(message));
        let window = windows.find(|window| has_directions(message, window))?;
        let values: Vec<u32> = message.ranges.iter().map(|range| value(*range)).collect();
        let scan_time = Some(message.scan_time).filter(|time| REVOLUTIONS.contains(time));
        let scan_time = scan_time.map(Duration::from_secs_f32);
        let mut scan = Scan::builder(window, values.as_slice()).stamp(message.stamp);
        if let Some(time) = scan_time {
            scan = scan.scan_time(time);
        }
        let first_ray = scan.build().ok()?.first_ray_stamp();
        let until_end = message.stamp.duration_since(first_ray).unwrap_or_default();
        let stamp = message.stamp.checked_add(until_end)?;
        Some(Self { window, values, stamp, scan_time })
    }
}

/// Directions of the first and the last point of a window, in steps: by the definition of a
/// `LaserScan`, and as `urg_node` writes them, which takes the first and the last step.
fn ends(window: &Window) -> [[f64; 2]; 2] {
    let cluster = f64::from(window.cluster_count());
    let first = f64::from(window.start());
    let middle = first + (cluster.min(window.steps() as f64) - 1.0) / 2.0;
    let last = middle + cluster * (window.points() - 1) as f64;
    [[middle, last], [first, f64::from(window.end())]]
}

fn has_directions(message: &LaserScan, window: &Window) -> bool {
    let is_near = |ours: f64, theirs: f64| (ours - theirs).abs() < TOLERANCE;
    let [first, last] = [message.angle_min, message.angle_max].map(step);
    window.points() == message.ranges.len()
        && is_near(window.cluster_count().into(), steps(message.angle_increment))
        && ends(window).iter().any(|[ours, end]| is_near(*ours, first) && is_near(*end, last))
}

/// Window whose first point has the direction of `angle_min`, if there is one. Its last point has
/// all steps of its cluster that exist.
fn by_definition(message: &LaserScan) -> Option<Window> {
    let cluster = cluster(message)?;
    let start =
        whole(step(message.angle_min) - f64::from(cluster - 1) / 2.0, 0..=Window::FULL.end())?;
    let steps = u16::try_from(message.ranges.len()).ok()?.checked_mul(cluster.into())?;
    let end = start.checked_add(steps.checked_sub(1)?)?.min(Window::FULL.end());
    Window::new(start..=end).ok()?.with_cluster_count(cluster).ok()
}

/// Window from the step at `angle_min` to the step at `angle_max`, if there is one.
fn by_steps(message: &LaserScan) -> Option<Window> {
    let end = |angle| whole(step(angle), 0..=Window::FULL.end());
    let window = Window::new(end(message.angle_min)?..=end(message.angle_max)?).ok()?;
    window.with_cluster_count(cluster(message)?).ok()
}

fn cluster(message: &LaserScan) -> Option<u8> {
    whole(steps(message.angle_increment), 1..=99)?.try_into().ok()
}

/// Converts an angle in radians to a number of steps.
fn steps(angle: f32) -> f64 {
    f64::from(angle) / TAU * f64::from(SENSOR.steps_per_revolution())
}

/// Step in the direction of an angle in radians.
fn step(angle: f32) -> f64 {
    steps(angle) - steps(SENSOR.degrees(0).to_radians())
}

fn whole(number: f64, range: RangeInclusive<u16>) -> Option<u16> {
    // The cast turns NaN into 0, and other numbers into the nearest one.
    let whole = number.round() as u16;
    (range.contains(&whole) && (f64::from(whole) - number).abs() <= 0.5).then_some(whole)
}

/// Value that a sensor sends for a range.
fn value(range: f32) -> u32 {
    let millimetres = (f64::from(range) * 1000.0).round();
    match millimetres {
        f64::INFINITY => BEYOND_RANGE,
        // `urg_node` writes error codes as distances of 1 to 19 mm.
        1.0..=4095.0 => millimetres as u32,
        4096.0..=5600.0 => BEYOND_RANGE,
        5601.0.. => FAR,
        _ => UNKNOWN,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros;
    use tokio_scip::Geometry;

    #[test]
    fn error_codes_become_two_and_distances_are_exact() {
        for (sent, expected) in [(0, 16), (6, 16), (16, 16), (4095, 16), (1, 19), (19, 19)] {
            assert_eq!(value(Geometry::URG_04LX.measurement(sent).range()), expected, "{sent}");
        }
        for sent in 20..4095 {
            assert_eq!(value(Geometry::URG_04LX.measurement(sent).range()), sent);
        }
    }

    #[test]
    fn foreign_ranges_keep_their_meaning() {
        for (range, expected) in [
            // Too near, or no number that a range can have.
            (f32::NEG_INFINITY, 19),
            (f32::NAN, 19),
            (-1.0, 19),
            (0.0, 19),
            (0.0004, 19),
            // Error codes of `urg_node`.
            (0.001, 1),
            (0.006, 6),
            (0.019, 19),
            (0.02, 20),
            (4.095, 4095),
            // A URG-04LX in SCIP 2, and other URGs.
            (4.096, 16),
            (5.6, 16),
            (5.601, 0),
            (1e30, 0),
            (f32::INFINITY, 16),
        ] {
            assert_eq!(value(range), expected, "{range}");
        }
    }

    fn message(window: Window) -> LaserScan {
        let scan = Scan::builder(window, vec![500; window.points()]).build().unwrap();
        let mut bytes = Vec::new();
        ros::write_scan(&mut bytes, &scan, scan.first_ray_stamp(), "laser");
        ros::read_scan(&bytes).unwrap()
    }

    #[test]
    fn a_message_of_another_laser_scanner_is_none_of_ours() {
        let ours = message(Window::DETECTION);
        for other in [
            LaserScan { angle_increment: 0.0044, ..ours.clone() },
            LaserScan { angle_increment: -ours.angle_increment, ..ours.clone() },
            LaserScan { angle_min: ours.angle_min + 0.003, ..ours.clone() },
            LaserScan { angle_min: -3.1, ..ours.clone() },
            LaserScan { angle_min: f32::NAN, ..ours.clone() },
            LaserScan { ranges: Vec::new(), ..ours.clone() },
            LaserScan { ranges: vec![1.0; 70_000], ..ours.clone() },
        ] {
            assert_eq!(MessageScan::from_message(&other, None), None);
        }
    }

    #[test]
    fn clusters_of_urg_node_are_read() {
        for cluster in 1..=99 {
            let window = Window::DETECTION.with_cluster_count(cluster).unwrap();
            let angle = |step: u16| SENSOR.degrees(step).to_radians();
            let (angle_min, angle_max) = (angle(44), angle(725));
            let theirs = LaserScan { angle_min, angle_max, ..message(window) };
            let read = MessageScan::from_message(&theirs, None).unwrap();
            assert_eq!(read.window.points(), window.points());
            // With one step in the last cluster, the angles may also be the middles of clusters.
            let is_both = cluster % 2 == 1 && window.steps() % usize::from(cluster) == 1;
            assert!(read.window == window || is_both, "{cluster}: {}", read.window);
            assert_eq!(MessageScan::from_message(&theirs, [window]).unwrap().window, window);
        }
    }

    #[test]
    fn an_implausible_revolution_is_unknown() {
        let ours = message(Window::DETECTION);
        let read = |scan_time| {
            let message = LaserScan { scan_time, ..ours.clone() };
            let read = MessageScan::from_message(&message, None).unwrap();
            (read.scan_time, read.stamp)
        };
        let nominal = read(0.1).1;
        for scan_time in [0.0, -0.1, 100.0, 1e8, f32::NAN, f32::INFINITY, f32::MAX] {
            assert_eq!(read(scan_time).0, None, "{scan_time}");
            let stamp = read(scan_time).1;
            let error = stamp.duration_since(nominal).unwrap_or_else(|error| error.duration());
            assert!(error < Duration::from_micros(1), "{scan_time}: {error:?}");
        }
        assert_eq!(read(0.025).0, Some(Duration::from_secs_f32(0.025)));
    }
}
