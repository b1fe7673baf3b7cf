//! ROS 2 messages as CDR, with their definitions: for whatever hands scans to
//! ROS, today recordings.
//!
//! A module beside `recording` and not in it, because a publisher encodes the
//! same messages. Knows no topics, files or networks.

mod cdr;
mod laser_scan;
mod std_msgs;

use std::time::{Duration, SystemTime};

pub use self::laser_scan::LaserScan;
pub(crate) use self::laser_scan::{read_scan, write_scan};
pub(crate) use self::std_msgs::{read_labelled_bytes, read_text, write_labelled_bytes, write_text};

/// A message type, as ROS 2 names and defines it.
#[derive(Debug)]
pub(crate) struct MessageType {
    /// Its full name, such as `std_msgs/msg/String`.
    pub(crate) name: &'static str,
    /// Its definition (`ros2msg`), and those of all messages in it.
    pub(crate) definition: &'static str,
}

/// A scan, as every laser scanner publishes it.
pub(crate) const LASER_SCAN: MessageType = laser_scan::TYPE;
/// Bytes with a label.
pub(crate) const LABELLED_BYTES: MessageType = std_msgs::BYTES_TYPE;
/// A text.
pub(crate) const TEXT: MessageType = std_msgs::TEXT_TYPE;

/// Returns how long after 1970 `time` is; zero for a time before 1970.
pub(crate) fn since_1970(time: SystemTime) -> Duration {
    time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default()
}
