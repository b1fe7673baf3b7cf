//! `NAME=PORT@X,Y,YAW`: a named sensor and its place, for pictures of several
//! sensors in one frame.

use std::str::FromStr;

use serde::Serialize;

use super::named::NamedPort;

/// A named sensor, and where it is.
#[derive(Debug, Clone)]
pub(crate) struct PlacedPort {
    pub(crate) named: NamedPort,
    pub(crate) pose: Pose,
}

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

impl FromStr for PlacedPort {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (named, pose) = match text.rsplit_once('@') {
            // An `@` further ahead belongs to the port. A pose begins as a number does.
            Some((named, pose))
                if pose.starts_with(|c: char| c.is_ascii_digit() || "+-.".contains(c)) =>
            {
                (named, pose.parse()?)
            }
            _ => (text, Pose::default()),
        };
        Ok(Self { named: named.parse()?, pose })
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
    use super::*;

    #[test]
    fn a_place_stands_behind_the_port() {
        let placed: PlacedPort = "front=emulated@0.2,-1,180".parse().unwrap();
        assert_eq!(placed.named.name.as_deref(), Some("front"));
        assert_eq!(placed.pose, Pose { x: 0.2, y: -1.0, yaw: 180.0 });
        let alone: PlacedPort = "emulated".parse().unwrap();
        assert_eq!((alone.named.name, alone.pose), (None, Pose::default()));
        let path: PlacedPort = "a=/dev/x@y".parse().unwrap();
        assert_eq!(path.named.port.to_string(), "/dev/x@y");
    }

    #[test]
    fn a_place_is_three_numbers() {
        for text in ["1,2", "1,2,3,4", "1,2,x", "1,2,inf", "1,,2"] {
            let refused = format!("a=emulated@{text}").parse::<PlacedPort>().unwrap_err();
            assert!(refused.contains("expected X,Y,YAW"), "{text}: {refused}");
        }
    }
}
