//! `--tf`: where you mounted the sensor on the robot.

use std::str::FromStr;

use tokio_scip::ros::Transform;

use crate::args::frame_id;

/// Maximum distance along an axis, in metres.
const MAX_DISTANCE: f64 = 1000.0;

/// Pose of a sensor in the frame `parent`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Mounting {
    parent: String,
    /// Metres forward, left and up.
    translation: [f64; 3],
    /// Degrees counter-clockwise.
    yaw: f64,
}

impl Mounting {
    pub(crate) fn transform(&self, child: &str) -> Transform {
        Transform {
            parent: self.parent.clone(),
            child: child.to_owned(),
            translation: self.translation,
            yaw: self.yaw.to_radians(),
        }
    }
}

impl FromStr for Mounting {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
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
                Ok(Self { parent: parent.to_owned(), translation: [x, y, z], yaw })
            }
            _ => Err(format!(
                "expected PARENT,X,Y,Z,YAW in metres and degrees, such as base_link,0.2,0,0.1,90, \
                 and at most {MAX_DISTANCE} m and 360°"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_has_a_parent_three_distances_and_an_angle() {
        let mounting: Mounting = "base_link,0.2,0,-0.1,180".parse().unwrap();
        let expected = Transform {
            parent: "base_link".to_owned(),
            child: "laser".to_owned(),
            translation: [0.2, 0.0, -0.1],
            yaw: std::f64::consts::PI,
        };
        assert_eq!(mounting.transform("laser"), expected);
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
            assert!(text.parse::<Mounting>().is_err(), "{text}");
        }
    }
}
