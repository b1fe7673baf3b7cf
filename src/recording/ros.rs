//! The ROS 2 messages of a recording: their definitions, and how they are
//! encoded.

use std::time::{Duration, SystemTime};

use super::cdr::{CdrReader, CdrWriter};
use crate::Scan;

/// A channel of a recording: its topic, and what its messages are.
pub(super) struct Topic {
    pub(super) name: &'static str,
    pub(super) message: &'static str,
    /// The message's definition, and those of all messages in it.
    pub(super) definition: &'static str,
}

/// The scans, as any laser scanner publishes them.
pub(super) const SCAN: Topic = Topic {
    name: "/scan",
    message: "sensor_msgs/msg/LaserScan",
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

/// What the sensor sent. A message of its own would say more, but
/// `ros2 bag play` would have to be taught it; as it is, the label of the only
/// dimension is the command that was answered.
pub(super) const REPLIES: Topic = Topic {
    name: "/scip/replies",
    message: "std_msgs/msg/UInt8MultiArray",
    definition: "\
std_msgs/MultiArrayLayout layout
uint8[] data
================================================================================
MSG: std_msgs/MultiArrayLayout
std_msgs/MultiArrayDimension[] dim
uint32 data_offset
================================================================================
MSG: std_msgs/MultiArrayDimension
string label
uint32 size
uint32 stride
",
};

/// What happened besides, as JSON.
pub(super) const EVENTS: Topic =
    Topic { name: "/scip/events", message: "std_msgs/msg/String", definition: "string data\n" };

/// A scan as a recording has it: the fields of `sensor_msgs/msg/LaserScan`, in
/// metres, radians and seconds. [`Scan`] explains them.
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
    /// From one point to the next.
    pub angle_increment: f32,
    /// From one point to the next, in seconds.
    pub time_increment: f32,
    /// A turn of the motor.
    pub scan_time: f32,
    /// The shortest range that is measured.
    pub range_min: f32,
    /// The longest range that is measured.
    pub range_max: f32,
    /// The ranges after REP 117: not finite where there is no distance.
    pub ranges: Vec<f32>,
}

pub(super) fn write_scan(out: &mut Vec<u8>, scan: &Scan, frame_id: &str) {
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

pub(super) fn read_scan(message: &[u8]) -> Option<LaserScan> {
    let mut cdr = CdrReader::new(message)?;
    let (seconds, nanos) = (cdr.i32()?, cdr.u32()?);
    let since_1970 =
        Duration::from_secs(seconds.try_into().ok()?) + Duration::from_nanos(nanos.into());
    Some(LaserScan {
        stamp: SystemTime::UNIX_EPOCH + since_1970,
        frame_id: cdr.string()?,
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

/// `parts` are the reply's bytes.
pub(super) fn write_reply(out: &mut Vec<u8>, command: &str, parts: &[&[u8]]) {
    let mut cdr = CdrWriter::new(out);
    let length = parts.iter().map(|part| part.len()).sum();
    cdr.length(1);
    cdr.string(command);
    // Size and stride of a dimension, and where the data begins.
    cdr.length(length);
    cdr.length(length);
    cdr.u32(0);
    cdr.bytes(parts);
}

/// The command that was answered, and the reply's bytes.
pub(super) fn read_reply(message: &[u8]) -> Option<(String, Vec<u8>)> {
    let mut cdr = CdrReader::new(message)?;
    if cdr.u32()? != 1 {
        return None;
    }
    let command = cdr.string()?;
    let (_size, _stride, _offset) = (cdr.u32()?, cdr.u32()?, cdr.u32()?);
    Some((command, cdr.bytes()?.to_vec()))
}

pub(super) fn write_text(out: &mut Vec<u8>, text: &str) {
    CdrWriter::new(out).string(text);
}

pub(super) fn read_text(message: &[u8]) -> Option<String> {
    CdrReader::new(message)?.string()
}

/// A time before 1970 is taken as 1970.
pub(super) fn since_1970(time: SystemTime) -> Duration {
    time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default()
}
