//! ROS 2 messages of a sensor: scans, diagnostics and places as CDR, for any transport to ROS. Recordings and
//! `urg publish` use them; you can pass them to your own middleware.
//!
//! ```
//! use urg_emulator::Emulator;
//! use urg_recording::ros::{self, MessageType};
//! use tokio_scip::{Sensor, Window};
//!
//! # #[tokio::main(flavor = "current_thread", start_paused = true)]
//! # async fn main() -> Result<(), tokio_scip::Error> {
//! let sensor = Sensor::builder().connect(Emulator::default()).await?;
//! let scan = sensor.scan(Window::DETECTION).await?;
//! let mut message = Vec::new();
//! ros::write_scan(&mut message, &scan, scan.first_ray_stamp(), "laser");
//! assert_eq!(MessageType::LASER_SCAN.dds_name(), "sensor_msgs::msg::dds_::LaserScan_");
//! assert_eq!(message.len(), 4 + 8 + 12 + 28 + 4 + 4 * 682 + 4);
//! # Ok(())
//! # }
//! ```
//!
//! A message is XCDR1, little-endian, with its encapsulation header of four bytes. DDS, `rmw_zenoh` and MCAP
//! files all use this form. The module knows no topics, files or networks.

/// Expands to the definition of the header that both messages begin with.
macro_rules! header_definition {
    () => {
        "\
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"
    };
}

mod cdr;
mod diagnostics;
mod laser_scan;
mod std_msgs;
mod transform;

use std::time::{Duration, SystemTime};

use self::cdr::CdrWriter;
pub use self::diagnostics::{DiagnosticLevel, DiagnosticStatus, write_diagnostics};
pub use self::laser_scan::{LaserScan, write_scan};
pub use self::transform::{Transform, write_transforms};
pub(crate) use self::{
    cdr::CdrError,
    laser_scan::read_scan,
    std_msgs::{read_labelled_bytes, read_text, write_labelled_bytes, write_text},
    transform::child_frames,
};

/// Message type, as ROS 2 names and defines it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MessageType {
    name: &'static str,
    definition: &'static str,
    hash: &'static str,
}

impl MessageType {
    /// Scan, as every laser scanner publishes it.
    pub const LASER_SCAN: Self = laser_scan::TYPE;
    /// Condition of devices.
    pub const DIAGNOSTIC_ARRAY: Self = diagnostics::TYPE;
    /// Places of frames within others.
    pub const TF_MESSAGE: Self = transform::TYPE;
    /// Bytes with a label.
    pub(crate) const LABELLED_BYTES: Self = std_msgs::BYTES_TYPE;
    /// A text.
    pub(crate) const TEXT: Self = std_msgs::TEXT_TYPE;

    /// Full name, such as `sensor_msgs/msg/LaserScan`.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Definition (`ros2msg`), followed by the definitions of all messages in it.
    pub fn definition(&self) -> &'static str {
        self.definition
    }

    /// Hash of the definition (REP 2016), which Jazzy and later compare.
    pub fn hash(&self) -> &'static str {
        self.hash
    }

    /// Name on a network: `sensor_msgs::msg::dds_::LaserScan_`.
    pub fn dds_name(&self) -> String {
        format!("{}_", self.name.replace("/msg/", "::msg::dds_::"))
    }

    /// Returns true for each form of the name that programs write: of ROS 2, of ROS 1 and of DDS.
    pub(crate) fn is_named(&self, name: &str) -> bool {
        fn parts(name: &str) -> impl Iterator<Item = &str> {
            let parts = name.split(['/', ':']).map(|part| part.trim_end_matches('_'));
            parts.filter(|part| !matches!(*part, "" | "msg" | "dds"))
        }
        name == self.name || parts(name).eq(parts(self.name))
    }
}

/// Longest name of a frame. ROS sets no limit.
const MAX_FRAME_BYTES: usize = 240;

/// Returns true if a text can be the name of a frame: tf2 refuses an empty one and one with a leading
/// `/`. Blanks and control characters are no part of a name either, nor are more than 240 bytes.
pub fn is_frame_id(text: &str) -> bool {
    let is_part = |c: char| !c.is_control() && !c.is_whitespace();
    !text.is_empty()
        && !text.starts_with('/')
        && text.chars().all(is_part)
        && text.len() <= MAX_FRAME_BYTES
}

fn write_header(cdr: &mut CdrWriter<'_>, stamp: SystemTime, frame_id: &str) {
    let stamp = since_1970(stamp);
    cdr.number(i32::try_from(stamp.as_secs()).unwrap_or(i32::MAX).to_le_bytes());
    cdr.number(stamp.subsec_nanos().to_le_bytes());
    cdr.string(frame_id);
}

/// Time since 1970, or zero for a time before 1970.
pub(crate) fn since_1970(time: SystemTime) -> Duration {
    time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default()
}
