//! `sensor_msgs/msg/LaserScan`: its definition and encoding.

use std::time::{Duration, SystemTime};

use super::cdr::{CdrError, CdrReader, CdrWriter};
use super::{MessageType, write_header};
use tokio_scip::Scan;

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

/// Scan in the form of ROS: the fields of `sensor_msgs/msg/LaserScan`, in metres, radians
/// and seconds. [`Scan`] explains them.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LaserScan {
    /// Wall clock when the first point was measured.
    pub stamp: SystemTime,
    /// Frame of the angles.
    pub frame_id: String,
    /// Direction of the first point.
    pub angle_min: f32,
    /// Direction of the last point.
    pub angle_max: f32,
    /// Angle from one point to the next.
    pub angle_increment: f32,
    /// Time from one point to the next.
    pub time_increment: f32,
    /// Time of one revolution of the motor.
    pub scan_time: f32,
    /// Limit of the valid ranges. Of a URG, [below](Scan::range_min) the shortest distance.
    pub range_min: f32,
    /// Limit of the valid ranges. Of a URG, [above](Scan::range_max) the longest distance.
    pub range_max: f32,
    /// Ranges as REP 117 defines them: not finite for a direction without a distance.
    pub ranges: Vec<f32>,
    /// Strengths of the reflections, one for each range, or none.
    pub intensities: Vec<f32>,
}

/// Encodes `scan` as a `sensor_msgs/msg/LaserScan` into `out`, replacing its content.
///
/// Pass the time of the first point as `stamp`: [`Scan::first_ray_stamp`], unless you have to correct a
/// clock. A time before 1970 is written as 1970. The angles are in the frame `frame_id`.
pub fn write_scan(out: &mut Vec<u8>, scan: &Scan, stamp: SystemTime, frame_id: &str) {
    let mut cdr = CdrWriter::new(out);
    write_header(&mut cdr, stamp, frame_id);
    let revolution = scan.scan_time().as_secs_f64();
    // Exact: a `Duration` is a whole number of nanoseconds.
    let turn = revolution / f64::from(scan.geometry().steps_per_revolution());
    for field in [
        scan.angle_min(),
        scan.angle_max(),
        scan.angle_increment(),
        (turn * f64::from(scan.window().cluster_count())) as f32,
        revolution as f32,
        scan.range_min(),
        scan.range_max(),
    ] {
        cdr.number(field.to_le_bytes());
    }
    cdr.length(scan.len());
    scan.ranges().for_each(|range| cdr.number(range.to_le_bytes()));
    let intensities = scan.intensities().unwrap_or_default();
    cdr.length(intensities.len());
    // Exact: an intensity has 18 bits.
    intensities.iter().for_each(|intensity| cdr.number((*intensity as f32).to_le_bytes()));
}

pub(crate) fn read_scan(message: &[u8]) -> Result<LaserScan, CdrError> {
    read_fields(CdrReader::new(message)?).ok_or(CdrError::Malformed)
}

fn read_fields(mut cdr: CdrReader<'_>) -> Option<LaserScan> {
    let (seconds, nanos) = (cdr.i32()?, cdr.u32()?);
    let whole = Duration::from_secs(seconds.unsigned_abs().into());
    let epoch = SystemTime::UNIX_EPOCH;
    let second = if seconds < 0 { epoch.checked_sub(whole) } else { epoch.checked_add(whole) };
    Some(LaserScan {
        stamp: second?.checked_add(Duration::from_nanos(nanos.into()))?,
        frame_id: String::from_utf8_lossy(cdr.text()?).into_owned(),
        angle_min: cdr.f32()?,
        angle_max: cdr.f32()?,
        angle_increment: cdr.f32()?,
        time_increment: cdr.f32()?,
        scan_time: cdr.f32()?,
        range_min: cdr.f32()?,
        range_max: cdr.f32()?,
        ranges: cdr.f32s()?,
        // Some programs leave out what is empty.
        intensities: cdr.f32s().unwrap_or_default(),
    })
}
