//! `sensor_msgs/msg/LaserScan`: its definition, and how a scan is encoded.

#[cfg(feature = "mcap")]
use std::time::Duration;
use std::time::SystemTime;

#[cfg(feature = "mcap")]
use super::cdr::CdrReader;
use super::cdr::CdrWriter;
use super::{MessageType, write_header};
use crate::Scan;

pub(super) const TYPE: MessageType = MessageType {
    name: "sensor_msgs/msg/LaserScan",
    definition: concat!(
        "\
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
",
        header_definition!()
    ),
    hash: "RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
};

/// A scan as ROS has it: the fields of `sensor_msgs/msg/LaserScan`, in metres,
/// radians and seconds. [`Scan`] explains them.
#[cfg(feature = "mcap")]
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LaserScan {
    /// The wall clock when the first point was measured.
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

/// Writes `scan` as a `sensor_msgs/msg/LaserScan` into `out`, in place of what was
/// there.
///
/// `stamp` is the time of the first point, [`Scan::first_ray_stamp`] unless a clock
/// has to be corrected; a time before 1970 is written as 1970. The angles are in the
/// frame `frame_id`.
pub fn write_scan(out: &mut Vec<u8>, scan: &Scan, stamp: SystemTime, frame_id: &str) {
    let mut cdr = CdrWriter::new(out);
    write_header(&mut cdr, stamp, frame_id);
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
#[cfg(feature = "mcap")]
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
