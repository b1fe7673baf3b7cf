//! [`MessageScan`]: what a `/scan` message tells about the reply that it was made of. Recordings
//! without replies have nothing else.

use std::time::{Duration, SystemTime};

use crate::ros::LaserScan;
use tokio_scip::{Geometry, Measurement, Scan, Window};

/// Angle from one step to the next in radians.
const STEP: f64 = std::f64::consts::TAU / 1024.0;
/// Number of the step that points to the front.
const FRONT: f64 = 384.0;
/// Largest difference of an angle from its step, in steps. Other laser scanners have other angles.
const TOLERANCE: f64 = 0.05;
/// Error code 19, "Non-Measurable Distance", in place of all codes that a message has as NaN.
const UNKNOWN: u32 = 19;
/// Error code 16, "in the range 4096mm~5.6m", in place of all codes that a message has as infinite.
const BEYOND_RANGE: u32 = 16;

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
    /// Converts a message. `known` is the window of the recorded stream, because a message does
    /// not tell how many steps its last point has. Returns `None` if the message has other
    /// directions than the steps of a URG.
    pub(super) fn from_message(message: &LaserScan, known: Option<Window>) -> Option<Self> {
        let values: Vec<u32> = message.ranges.iter().map(|range| value(*range)).collect();
        let scan_time = Duration::try_from_secs_f32(message.scan_time).ok();
        let scan_time = scan_time.filter(|time| !time.is_zero());
        known.into_iter().chain(derived(message)).find_map(|window| {
            let mut scan = Scan::builder(window, values.as_slice()).stamp(message.stamp);
            if let Some(time) = scan_time {
                scan = scan.scan_time(time);
            }
            let scan = scan.build().ok()?;
            let is_near = |ours: f32, theirs: f32| {
                ((f64::from(ours) - f64::from(theirs)) / STEP).abs() < TOLERANCE
            };
            let is_same = is_near(scan.angle_min(), message.angle_min)
                && is_near(scan.angle_max(), message.angle_max)
                && is_near(scan.angle_increment(), message.angle_increment);
            let until_end = message.stamp.duration_since(scan.first_ray_stamp()).ok()?;
            let stamp = message.stamp.checked_add(until_end)?;
            let values = is_same.then(|| scan.values().to_vec())?;
            Some(Self { window, values, stamp, scan_time })
        })
    }
}

/// Window with the directions of a message, if there is one. Its last point has all steps of its
/// cluster that exist.
fn derived(message: &LaserScan) -> Option<Window> {
    let whole = |number: f64, range: std::ops::RangeInclusive<f64>| {
        range.contains(&number.round()).then(|| number.round() as u16)
    };
    let cluster = whole(f64::from(message.angle_increment) / STEP, 1.0..=99.0)?;
    let middle = f64::from(cluster - 1) / 2.0;
    let start = whole(f64::from(message.angle_min) / STEP + FRONT - middle, 0.0..=768.0)?;
    let steps = u16::try_from(message.ranges.len()).ok()?.checked_mul(cluster)?;
    let end = start.checked_add(steps.checked_sub(1)?)?.min(768);
    Window::new(start..=end).ok()?.with_cluster_count(cluster.try_into().ok()?).ok()
}

/// Value that a sensor sends for a range.
fn value(range: f32) -> u32 {
    if range.is_infinite() {
        return BEYOND_RANGE;
    }
    // The cast turns NaN and negative numbers into 0.
    let value = (f64::from(range) * 1000.0).round() as u32;
    match Geometry::URG_04LX.measurement(value) {
        Measurement::Distance(distance) if distance == value => value,
        _ => UNKNOWN,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros;

    #[test]
    fn error_codes_become_two_and_distances_are_exact() {
        for (sent, expected) in [(0, 16), (6, 16), (16, 16), (4095, 16), (1, 19), (19, 19)] {
            assert_eq!(value(Geometry::URG_04LX.measurement(sent).range()), expected, "{sent}");
        }
        for sent in 20..4095 {
            assert_eq!(value(Geometry::URG_04LX.measurement(sent).range()), sent);
        }
        for range in [-1.0, 0.0, 5.0, 1e30, f32::NEG_INFINITY] {
            assert!(value(range) < 20, "{range}");
        }
    }

    #[test]
    fn a_message_of_another_laser_scanner_is_none_of_ours() {
        let scan = Scan::builder(Window::DETECTION, vec![500; 682]).build().unwrap();
        let mut bytes = Vec::new();
        ros::write_scan(&mut bytes, &scan, scan.first_ray_stamp(), "laser");
        let ours = ros::read_scan(&bytes).unwrap();
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
}
