//! Discovery range of participants, from the environment variables of ROS 2.

use std::env;
use std::net::Ipv4Addr;

use crate::failure::Failure;

/// `ROS_AUTOMATIC_DISCOVERY_RANGE`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) enum Range {
    /// Every participant that multicast reaches.
    #[default]
    Subnet,
    /// This machine, and static peers.
    Localhost,
    Off,
}

/// Where to discover readers.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Discovery {
    pub(crate) range: Range,
    /// Hosts to announce the participant to: `ROS_STATIC_PEERS`.
    pub(crate) static_peers: Vec<String>,
}

/// Checks for the name or IPv4 address of a host.
fn is_host(text: &str) -> bool {
    let is_label = |c: char| c.is_ascii_alphanumeric() || ".-_".contains(c);
    // Digits alone are an address with a mistake.
    let has_letter = text.contains(|c: char| c.is_ascii_alphabetic());
    let is_name = has_letter && text.chars().all(is_label) && text.len() <= 253;
    is_name || text.parse::<Ipv4Addr>().is_ok()
}

impl Discovery {
    /// Reads `ROS_AUTOMATIC_DISCOVERY_RANGE`, `ROS_STATIC_PEERS` and the older `ROS_LOCALHOST_ONLY`.
    pub(crate) fn from_environment() -> Result<Self, Failure> {
        Self::resolve(|name| env::var_os(name).map(|text| text.to_string_lossy().into_owned()))
    }

    pub(super) fn is_beyond_this_machine(&self) -> bool {
        self.range == Range::Subnet || !self.static_peers.is_empty()
    }

    fn resolve(variable: impl Fn(&str) -> Option<String>) -> Result<Self, Failure> {
        let peers = variable("ROS_STATIC_PEERS").unwrap_or_default();
        let peers = peers.split(';').filter(|peer| !peer.is_empty()).map(str::to_owned);
        let static_peers: Vec<_> = peers.collect();
        if let Some(wrong) = static_peers.iter().find(|peer| !is_host(peer)) {
            return Err(Failure::Usage(format!(
                "invalid ROS_STATIC_PEERS {wrong:?}: expected IPv4 addresses or names of \
                 machines, such as 192.168.1.10;robot.local"
            )));
        }
        let is_local = variable("ROS_LOCALHOST_ONLY").as_deref() == Some("1");
        let range = variable("ROS_AUTOMATIC_DISCOVERY_RANGE");
        // ROS ignores static peers in some cases.
        let (range, has_peers) = match range.as_deref() {
            _ if is_local => (Range::Localhost, false),
            None | Some("" | "SUBNET") => (Range::Subnet, true),
            Some("LOCALHOST") => (Range::Localhost, true),
            Some("SYSTEM_DEFAULT") => (Range::Subnet, false),
            Some("OFF") => (Range::Off, false),
            Some(other) => {
                return Err(Failure::Usage(format!(
                    "invalid ROS_AUTOMATIC_DISCOVERY_RANGE {other:?}: expected SUBNET, LOCALHOST, \
                     OFF or SYSTEM_DEFAULT"
                )));
            }
        };
        Ok(Self { range, static_peers: if has_peers { static_peers } else { Vec::new() } })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_environment_is_read_as_ros_2_does() {
        let peers = "10.0.0.1;robot.local;";
        for (range, localhost_only, expected, has_peers) in [
            ("", "", Range::Subnet, true),
            ("SUBNET", "0", Range::Subnet, true),
            ("LOCALHOST", "", Range::Localhost, true),
            ("OFF", "", Range::Off, false),
            ("SYSTEM_DEFAULT", "", Range::Subnet, false),
            ("SUBNET", "1", Range::Localhost, false),
        ] {
            let text = |name: &str| match name {
                "ROS_AUTOMATIC_DISCOVERY_RANGE" => range,
                "ROS_STATIC_PEERS" => peers,
                _ => localhost_only,
            };
            let found = Discovery::resolve(|name| Some(text(name).to_owned())).unwrap();
            let peers = if has_peers { "10.0.0.1 robot.local" } else { "" };
            assert_eq!((found.range, &*found.static_peers.join(" ")), (expected, peers), "{range}");
        }
    }
}
