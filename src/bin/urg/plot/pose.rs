//! [`Pose`]: a sensor's place in the common frame of several sensors.

use std::str::FromStr;

use serde::Serialize;

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
    use super::*;

    #[test]
    fn a_place_is_three_numbers() {
        for text in ["1,2", "1,2,3,4", "1,2,x", "1,2,inf", "1,,2"] {
            let refused = text.parse::<Pose>().unwrap_err();
            assert!(refused.contains("expected X,Y,YAW"), "{text}: {refused}");
        }
    }
}
