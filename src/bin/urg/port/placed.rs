//! `NAME=PORT@X,Y,YAW`: a named sensor and its place, for pictures of several
//! sensors in one frame.

use std::collections::BTreeSet;
use std::str::FromStr;

use tokio_scip::Rate;

use super::missing;
use super::name::PortArg;
use super::named::NamedPort;
use crate::failure::Failure;
use crate::plot::pose::Pose;
use crate::recording;

/// The sensors of one picture: a PORT, or several of NAME=PORT@X,Y,YAW.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct PlacedPorts {
    #[arg(value_name = "PORT", help = help())]
    ports: Vec<PlacedPort>,
}

fn help() -> String {
    let recording = if recording::AVAILABLE { "FILE.mcap, " } else { "" };
    format!(
        "Where the sensor is: a serial port, serial:NUMBER, tcp://HOST:PORT, {recording}or \
         emulated (see `urg help`); for several sensors in one picture NAME=PORT@X,Y,YAW, one \
         after the other"
    )
}

impl PlacedPorts {
    /// Returns the ports, each with its rate. Fails if there is none, and if one of
    /// several has no name of its own.
    pub(crate) async fn polled_at(
        &self,
        rate: Option<Rate>,
    ) -> Result<Vec<(PlacedPort, Rate)>, Failure> {
        if self.ports.is_empty() {
            return Err(missing::failure().await);
        }
        let names = self.ports.iter().filter_map(|port| port.named.name.as_deref());
        let unique: BTreeSet<_> = names.collect();
        if self.ports.len() > 1 && unique.len() < self.ports.len() {
            let text = "several sensors need a name each, such as \
                        `front=/dev/ttyACM0@0.2,0,0 rear=/dev/ttyACM1@-0.2,0,180`";
            return Err(Failure::Usage(text.to_owned()));
        }
        let mut polled = Vec::new();
        for placed in &self.ports {
            let arg = PortArg { name: Some(placed.named.port.clone()) };
            let (port, rate) = arg.polled_at(rate).await?;
            let named = NamedPort { port, ..placed.named.clone() };
            polled.push((PlacedPort { named, pose: placed.pose }, rate));
        }
        Ok(polled)
    }
}

/// A named sensor, and where it is.
#[derive(Debug, Clone)]
pub(crate) struct PlacedPort {
    pub(crate) named: NamedPort,
    pub(crate) pose: Pose,
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
}
