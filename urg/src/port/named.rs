//! Arguments of commands that take several sensors: `NAME=PORT`, and `NAME=PORT@X,Y,YAW` with
//! the sensor's pose in the common frame.

use std::str::FromStr;

use tokio_scip::scan::Pose;

use super::name::PortName;
use crate::plot::pose;

#[derive(Debug, Clone)]
pub(crate) struct NamedPort {
    pub(crate) name: Option<String>,
    pub(crate) port: PortName,
}

impl From<PortName> for NamedPort {
    fn from(port: PortName) -> Self {
        Self { name: None, port }
    }
}

impl FromStr for NamedPort {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, port) = match text.split_once('=') {
            // A later `=` belongs to the port, as in `tcp://host:1?baud=19200`.
            Some((name, port)) if !name.contains(['/', ':', '.', '?']) => {
                (Some(token(name)?.to_owned()), port)
            }
            _ => (None, text),
        };
        Ok(Self { name, port: port.parse()? })
    }
}

/// Checks a name against the rules of ROS. Such names are also valid Prometheus labels, and
/// need no quotes in a shell.
pub(crate) fn token(text: &str) -> Result<&str, String> {
    let valid = text.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
        && !text.contains("__");
    valid.then_some(text).ok_or_else(|| {
        format!(
            "invalid name `{text}`: expected letters, digits and single `_`, and no digit first"
        )
    })
}

#[derive(Debug, Clone)]
pub(crate) struct PlacedPort {
    pub(crate) named: NamedPort,
    pub(crate) pose: Pose,
}

impl From<PortName> for PlacedPort {
    fn from(port: PortName) -> Self {
        Self { named: port.into(), pose: Pose::default() }
    }
}

impl FromStr for PlacedPort {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (named, pose) = match text.rsplit_once('@') {
            // An earlier `@` belongs to the port.
            Some((named, pose)) if is_meant_as_pose(pose) => (named, pose::parse(pose)?),
            _ => (text, Pose::default()),
        };
        let mut named: NamedPort = named.parse()?;
        if let PortName::Emulated(place) = &mut named.port {
            *place = pose;
        }
        Ok(Self { named, pose })
    }
}

/// Checks whether `text` begins like a number or has three parts or more, and so is a pose, even if
/// an invalid one, and not part of a path.
fn is_meant_as_pose(text: &str) -> bool {
    let is_file = text.contains('/') || text.ends_with(".mcap");
    text.starts_with(|c: char| c.is_ascii_digit() || "+-.".contains(c))
        || (text.matches(',').count() >= 2 && !is_file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_precedes_the_first_equals_sign() {
        for (text, name) in [
            ("tcp://host:1?baud=19200", None),
            ("/dev/a=b", None),
            ("./a=b", None),
            ("front_2=emulated", Some("front_2")),
        ] {
            assert_eq!(text.parse::<NamedPort>().unwrap().name.as_deref(), name, "{text}");
        }
        for text in ["1st=emulated", "=emulated", "a-b=emulated", "a__b=emulated"] {
            let refused = text.parse::<NamedPort>().unwrap_err();
            assert!(refused.contains("invalid name"), "{text}: {refused}");
        }
    }

    #[test]
    fn a_place_stands_behind_the_port() {
        let place: PlacedPort = "front=emulated@0.2,-1,180".parse().unwrap();
        assert_eq!(place.named.name.as_deref(), Some("front"));
        let heading = std::f64::consts::PI;
        assert_eq!(place.pose, Pose { x: 0.2, y: -1.0, heading, upside_down: false });
        // The emulated sensor measures its room from that pose.
        assert!(matches!(place.named.port, PortName::Emulated(pose) if pose == place.pose));
        let place: PlacedPort = "emulated@0,0,0,upside-down".parse().unwrap();
        assert!(place.pose.upside_down);
        for port in ["emulated", "/dev/x@y", "a@b,c,d.mcap"] {
            let place: PlacedPort = port.parse().unwrap();
            assert_eq!((place.named.port.to_string(), place.pose), (port.into(), Pose::default()));
        }
        for text in ["emulated@nan,0,0", "emulated@x,0,0", "emulated@,,", "emulated@1"] {
            let refused = text.parse::<PlacedPort>().unwrap_err();
            assert!(refused.contains("invalid place") && refused.contains("X,Y,YAW"), "{refused}");
        }
    }
}
