//! [`Pose`]: a sensor's place in the common frame of several sensors.

use std::str::FromStr;

use serde::Serialize;

use super::Place;

/// A place and a direction in the common frame.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub(crate) struct Pose {
    /// Metres ahead of the origin.
    pub(crate) x: f64,
    /// Metres to its left.
    pub(crate) y: f64,
    /// Degrees counter-clockwise.
    pub(crate) yaw: f64,
}

impl Pose {
    /// Returns the place in the common frame that the sensor measures `range` metres
    /// away in the direction `angle` (radians counter-clockwise from its front).
    pub(crate) fn place(self, range: f64, angle: f64) -> Place {
        let seen = super::place(range, angle + self.yaw.to_radians());
        Place { right: seen.right - self.y, ahead: seen.ahead + self.x }
    }
}

impl FromStr for Pose {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<f64>> = text
            .split(',')
            .map(|number| number.trim().parse().ok().filter(|number: &f64| number.is_finite()))
            .collect();
        match numbers.as_deref() {
            Some(&[x, y, yaw]) => Ok(Self { x, y, yaw }),
            _ => Err(format!(
                "invalid place `{text}`: expected X,Y,YAW in metres and degrees, such as 0.2,0,90"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    #[test]
    fn a_sensor_that_looks_back_sees_its_front_behind_the_origin() {
        let rear = Pose { x: -0.2, y: 0.5, yaw: 180.0 };
        let near = |a: Place, right: f64, ahead: f64| {
            (a.right - right).abs() < 1e-9 && (a.ahead - ahead).abs() < 1e-9
        };
        assert!(near(rear.place(0.0, 0.0), -0.5, -0.2));
        assert!(near(rear.place(2.0, 0.0), -0.5, -2.2));
        // Its left is the common frame's right.
        assert!(near(rear.place(2.0, FRAC_PI_2), 1.5, -0.2));
    }

    #[test]
    fn a_place_is_three_numbers() {
        for text in ["1,2", "1,2,3,4", "1,2,x", "1,2,inf", "1,,2"] {
            let refused = text.parse::<Pose>().unwrap_err();
            assert!(refused.contains("expected X,Y,YAW"), "{text}: {refused}");
        }
    }
}
