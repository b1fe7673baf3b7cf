//! `sensor_msgs/msg/LaserScan`: its definition, and how a scan is encoded.

use std::time::{Duration, SystemTime};

use super::cdr::{CdrReader, CdrWriter};
use super::{MessageType, since_1970};
use crate::Scan;

pub(super) const TYPE: MessageType = MessageType {
    name: "sensor_msgs/msg/LaserScan",
    definition: "\
std_msgs/Header header
float32 angle_min
float32 angle_max
float32 angle_increment
float32 time_increment
float32 scan_time
float32 range_min
float32 range_max
float32[] ranges
float32[] intensities
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
",
};

/// A scan as ROS has it: the fields of `sensor_msgs/msg/LaserScan`, in metres,
/// radians and seconds. [`Scan`] explains them.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LaserScan {
    /// The wall clock when the reply's first byte arrived.
    pub stamp: SystemTime,
    /// The frame that the angles are in.
    pub frame_id: String,
    /// The direction of the first point.
    pub angle_min: f32,
    /// The direction of the last point.
    pub angle_max: f32,
    /// The angle from one point to the next.
    pub angle_increment: f32,
    /// The time from one point to the next.
    pub time_increment: f32,
    /// The time of one revolution of the motor.
    pub scan_time: f32,
    /// The shortest range that is measured.
    pub range_min: f32,
    /// The longest range that is measured.
    pub range_max: f32,
    /// The ranges as REP 117 defines them: not finite where there is no distance.
    pub ranges: Vec<f32>,
}

pub(crate) fn write_scan(out: &mut Vec<u8>, scan: &Scan, frame_id: &str) {
    let mut cdr = CdrWriter::new(out);
    let stamp = since_1970(scan.stamp());
    cdr.i32(i32::try_from(stamp.as_secs()).unwrap_or(i32::MAX));
    cdr.u32(stamp.subsec_nanos());
    cdr.string(frame_id);
    for field in [
        scan.angle_min(),
        scan.angle_max(),
        scan.angle_increment(),
        scan.time_increment(),
        scan.scan_time(),
        scan.range_min(),
        scan.range_max(),
    ] {
        cdr.f32(field);
    }
    cdr.length(scan.len());
    scan.ranges().for_each(|range| cdr.f32(range));
    // SCIP 1.1 has no intensities.
    cdr.length(0);
}

/// Returns the scan, or `None` if `message` is malformed.
pub(crate) fn read_scan(message: &[u8]) -> Option<LaserScan> {
    let mut cdr = CdrReader::new(message)?;
    let (seconds, nanos) = (cdr.i32()?, cdr.u32()?);
    let since_1970 =
        Duration::from_secs(seconds.try_into().ok()?) + Duration::from_nanos(nanos.into());
    Some(LaserScan {
        stamp: SystemTime::UNIX_EPOCH + since_1970,
        frame_id: cdr.string()?.to_owned(),
        angle_min: cdr.f32()?,
        angle_max: cdr.f32()?,
        angle_increment: cdr.f32()?,
        time_increment: cdr.f32()?,
        scan_time: cdr.f32()?,
        range_min: cdr.f32()?,
        range_max: cdr.f32()?,
        ranges: cdr.f32s()?,
    })
}
