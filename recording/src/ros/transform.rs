//! `tf2_msgs/msg/TFMessage`: its definition, and how the place of a sensor is encoded.

use std::time::SystemTime;

use super::cdr::{CdrReader, CdrWriter};
use super::{MessageType, write_header};

pub(super) const TYPE: MessageType = MessageType {
    name: "tf2_msgs/msg/TFMessage",
    definition: concat!(
        "\
geometry_msgs/TransformStamped[] transforms
================================================================================
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
================================================================================
MSG: geometry_msgs/Transform
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
",
        header_definition!()
    ),
    hash: "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
};

/// Place of a frame within another, as in `geometry_msgs/msg/TransformStamped`.
#[derive(Debug, Clone, PartialEq)]
pub struct Transform {
    /// The frame that the place is in, such as `base_link`.
    pub parent: String,
    /// The frame that has this place, such as `laser`.
    pub child: String,
    /// Position of the child's origin: x, y and z in metres.
    pub translation: [f64; 3],
    /// Roll, pitch and yaw of the child in radians, about the parent's x, y and z axis in this
    /// order. A sensor mounted upside down has a roll of π.
    pub rotation: [f64; 3],
}

impl Transform {
    /// Computes x, y, z and w of the rotation.
    fn quaternion(&self) -> [f64; 4] {
        let [(sr, cr), (sp, cp), (sy, cy)] = self.rotation.map(|angle| (angle / 2.0).sin_cos());
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    }
}

/// Returns the frames that a `tf2_msgs/msg/TFMessage` places, or `None` if it is malformed.
pub(crate) fn child_frames(message: &[u8]) -> Option<Vec<&str>> {
    let mut cdr = CdrReader::new(message).ok()?;
    let mut frames = Vec::new();
    for _ in 0..cdr.u32()? {
        let (_seconds, _nanoseconds, _parent) = (cdr.i32()?, cdr.u32()?, cdr.string()?);
        frames.push(cdr.string()?);
        cdr.skip_f64s(7)?;
    }
    Some(frames)
}

/// Writes a `tf2_msgs/msg/TFMessage` into `out`, in place of what was there. A `stamp`
/// before 1970 is written as 1970.
pub fn write_transforms(out: &mut Vec<u8>, stamp: SystemTime, transforms: &[Transform]) {
    let mut cdr = CdrWriter::new(out);
    cdr.length(transforms.len());
    for transform in transforms {
        write_header(&mut cdr, stamp, &transform.parent);
        cdr.string(&transform.child);
        let numbers = transform.translation.into_iter().chain(transform.quaternion());
        numbers.for_each(|number| cdr.number(number.to_le_bytes()));
    }
}
