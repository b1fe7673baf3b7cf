//! The types of `std_msgs` that recordings have: `UInt8MultiArray` for a reply, `String` for a text. They
//! are never published, so they need no hash.

use super::MessageType;
use super::cdr::{CdrError, CdrReader, CdrWriter};

/// Carries a sensor's reply. Our own message type would be plainer, but `ros2 bag play`
/// needs each type installed. The label of the only dimension is the answered command.
pub(super) const BYTES_TYPE: MessageType = MessageType {
    name: "std_msgs/msg/UInt8MultiArray",
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
    hash: "",
};

pub(super) const TEXT_TYPE: MessageType =
    MessageType { name: "std_msgs/msg/String", definition: "string data\n", hash: "" };

/// Encodes the bytes in `parts`, one after the other.
pub(crate) fn write_labelled_bytes(out: &mut Vec<u8>, label: &str, parts: &[&[u8]]) {
    let mut cdr = CdrWriter::new(out);
    let length = parts.iter().map(|part| part.len()).sum();
    cdr.length(1);
    cdr.string(label);
    // Size and stride of the dimension, and where the data starts.
    cdr.length(length);
    cdr.length(length);
    cdr.length(0);
    cdr.bytes(parts);
}

pub(crate) fn read_labelled_bytes(message: &[u8]) -> Result<(&str, &[u8]), CdrError> {
    read_fields(CdrReader::new(message)?).ok_or(CdrError::Malformed)
}

fn read_fields(mut cdr: CdrReader<'_>) -> Option<(&str, &[u8])> {
    if cdr.u32()? != 1 {
        return None;
    }
    let label = cdr.string()?;
    let (_size, _stride, _offset) = (cdr.u32()?, cdr.u32()?, cdr.u32()?);
    Some((label, cdr.bytes()?))
}

pub(crate) fn write_text(out: &mut Vec<u8>, text: &str) {
    CdrWriter::new(out).string(text);
}

pub(crate) fn read_text(message: &[u8]) -> Result<&str, CdrError> {
    CdrReader::new(message)?.string().ok_or(CdrError::Malformed)
}
