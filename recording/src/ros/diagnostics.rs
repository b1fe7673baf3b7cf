//! `diagnostic_msgs/msg/DiagnosticArray`: its definition and encoding, for the condition of devices.

use std::time::SystemTime;

use super::cdr::CdrWriter;
use super::{MessageType, write_header};

pub(super) const TYPE: MessageType = MessageType {
    name: "diagnostic_msgs/msg/DiagnosticArray",
    definition: concat!(
        "\
std_msgs/Header header
diagnostic_msgs/DiagnosticStatus[] status
================================================================================
MSG: diagnostic_msgs/DiagnosticStatus
byte OK=0
byte WARN=1
byte ERROR=2
byte STALE=3
byte level
string name
string message
string hardware_id
diagnostic_msgs/KeyValue[] values
================================================================================
MSG: diagnostic_msgs/KeyValue
string key
string value
",
        header_definition!()
    ),
    hash: "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
};

/// Level of a [`DiagnosticStatus`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum DiagnosticLevel {
    /// All is well.
    Ok,
    /// Works, but needs attention.
    Warn,
    /// Does not work.
    Error,
    /// No report for too long.
    Stale,
}

/// Condition of a device, as in `diagnostic_msgs/msg/DiagnosticStatus`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DiagnosticStatus {
    /// Severity of the condition.
    pub level: DiagnosticLevel,
    /// Part of the system, by convention a node and one of its topics.
    pub name: String,
    /// Condition in words.
    pub message: String,
    /// Device, such as its serial number.
    pub hardware_id: String,
    /// Values by name.
    pub values: Vec<(&'static str, String)>,
}

/// Encodes a `diagnostic_msgs/msg/DiagnosticArray` into `out`, replacing its content. A
/// `stamp` before 1970 is written as 1970.
pub fn write_diagnostics(out: &mut Vec<u8>, stamp: SystemTime, statuses: &[DiagnosticStatus]) {
    let mut cdr = CdrWriter::new(out);
    write_header(&mut cdr, stamp, "");
    cdr.length(statuses.len());
    for status in statuses {
        cdr.u8(status.level as u8);
        cdr.string(&status.name);
        cdr.string(&status.message);
        cdr.string(&status.hardware_id);
        cdr.length(status.values.len());
        for (key, value) in &status.values {
            cdr.string(key);
            cdr.string(value);
        }
    }
}
