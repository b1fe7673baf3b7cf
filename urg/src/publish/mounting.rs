//! `--tf`: where you mounted the sensor on the robot.

use urg_recording::ros::Transform;

use crate::args::frame_id;

/// Maximum distance along an axis, in metres.
const MAX_DISTANCE: f64 = 1000.0;

/// Parses `PARENT,X,Y,Z,YAW`: metres forward, left and up, and degrees counter-clockwise. The
/// child, the frame of the sensor, is not known yet.
pub(crate) fn mounting(text: &str) -> Result<Transform, String> {
    let (parent, numbers) = text.split_once(',').unwrap_or((text, ""));
    let numbers: Option<Vec<f64>> =
        numbers.split(',').map(|number| number.trim().parse().ok()).collect();
    match numbers.as_deref() {
        // False for NaN.
        Some(&[x, y, z, yaw])
            if frame_id(parent).is_ok()
                && !parent.starts_with('/')
                && [x, y, z].iter().all(|metres| metres.abs() <= MAX_DISTANCE)
                && yaw.abs() <= 360.0 =>
        {
            Ok(Transform {
                parent: parent.to_owned(),
                child: String::new(),
                translation: [x, y, z],
                yaw: yaw.to_radians(),
            })
        }
        _ => Err(format!(
            "expected PARENT,X,Y,Z,YAW in metres and degrees, such as base_link,0.2,0,0.1,90, \
                     and at most {MAX_DISTANCE} m and 360°"
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
