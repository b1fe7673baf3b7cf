//! `--tf`: where you mounted the sensor on the robot.

use urg_recording::ros::Transform;

use crate::args::frame_id;
use crate::plot::pose::{self, FARTHEST};

/// Parses `PARENT,X,Y,Z,YAW`: metres forward, left and up, and degrees counter-clockwise. The
/// child, the frame of the sensor, is not known yet.
pub(crate) fn mounting(text: &str) -> Result<Transform, String> {
    let (parent, numbers) = text.split_once(',').unwrap_or((text, ""));
    let is_frame = frame_id(parent).is_ok() && !parent.starts_with('/');
    match pose::distances_and_angle(numbers).filter(|_| is_frame) {
        Some((translation, yaw)) => {
            Ok(Transform { parent: parent.to_owned(), child: String::new(), translation, yaw })
        }
        None => Err(format!(
            "expected PARENT,X,Y,Z,YAW in metres and degrees, such as base_link,0.2,0,0.1,90, \
                     and at most {FARTHEST} m and 360°"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_has_a_parent_three_distances_and_an_angle() {
        let expected = Transform {
            parent: "base_link".to_owned(),
            child: String::new(),
            translation: [0.2, 0.0, -0.1],
            yaw: std::f64::consts::PI,
        };
        assert_eq!(mounting("base_link,0.2,0,-0.1,180"), Ok(expected));
        for text in [
            "",
            "a",
            "a,0,0,0",
            "a,0,0,0,0,0",
            ",0,0,0,0",
            "/a,0,0,0,0",
            "a,NaN,0,0,0",
            "a,0,0,0,361",
        ] {
            assert!(mounting(text).is_err(), "{text}");
        }
    }
}
