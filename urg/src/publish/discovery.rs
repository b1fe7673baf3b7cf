//! Discovery range of participants, from the environment variables of ROS 2.

use std::env;
use std::net::Ipv4Addr;
use std::str::FromStr;

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
    /// `ROS_STATIC_PEERS`.
    pub(crate) static_peers: Vec<StaticPeer>,
}

/// Host to announce the participant to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct StaticPeer {
    /// IPv4 address or name.
    pub(crate) host: String,
    /// Port to use instead of the ports of the domain.
    pub(crate) port: Option<u16>,
}

impl FromStr for StaticPeer {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let (host, port) = match text.split_once(':') {
            Some((host, port)) => (host, Some(port.parse::<u16>().map_err(drop)?)),
            None => (text, None),
        };
        let is_name = |text: &str| {
            let is_label = |c: char| c.is_ascii_alphanumeric() || ".-_".contains(c);
            // Digits alone are an address with a mistake.
            text.chars().all(is_label) && text.contains(|c: char| c.is_ascii_alphabetic())
        };
        let is_host = host.parse::<Ipv4Addr>().is_ok() || (is_name(host) && host.len() <= 253);
        if !is_host || port == Some(0) {
            return Err(());
        }
        Ok(Self { host: host.to_owned(), port })
    }
}

impl Discovery {
    /// Reads `ROS_AUTOMATIC_DISCOVERY_RANGE`, `ROS_STATIC_PEERS` and the older
    /// `ROS_LOCALHOST_ONLY`.
    pub(crate) fn from_environment() -> Result<Self, Failure> {
        Self::resolve(|name| env::var_os(name).map(|text| text.to_string_lossy().into_owned()))
    }

    pub(super) fn is_beyond_this_machine(&self) -> bool {
        self.range == Range::Subnet || !self.static_peers.is_empty()
    }

    fn resolve(variable: impl Fn(&str) -> Option<String>) -> Result<Self, Failure> {
        let peers = variable("ROS_STATIC_PEERS").unwrap_or_default();
        let peers = peers.split(';').filter(|peer| !peer.is_empty()).map(|peer| {
            peer.parse().map_err(|()| {
                Failure::Usage(format!(
                    "invalid ROS_STATIC_PEERS {peer:?}: expected IPv4 addresses or names of \
                     machines, such as 192.168.1.10;robot.local"
                ))
            })
        });
        let static_peers = peers.collect::<Result<Vec<StaticPeer>, _>>()?;
        // ROS ignores static peers if the older variable is set.
        if variable("ROS_LOCALHOST_ONLY").as_deref() == Some("1") {
            return Ok(Self { range: Range::Localhost, static_peers: Vec::new() });
        }
        match variable("ROS_AUTOMATIC_DISCOVERY_RANGE").as_deref() {
            None | Some("" | "SUBNET") => Ok(Self { range: Range::Subnet, static_peers }),
            Some("LOCALHOST") => Ok(Self { range: Range::Localhost, static_peers }),
            // ROS ignores static peers in these two ranges.
            Some("SYSTEM_DEFAULT") => Ok(Self { range: Range::Subnet, static_peers: Vec::new() }),
            Some("OFF") => Ok(Self { range: Range::Off, static_peers: Vec::new() }),
            Some(other) => Err(Failure::Usage(format!(
                "invalid ROS_AUTOMATIC_DISCOVERY_RANGE {other:?}: expected SUBNET, LOCALHOST, \
                 OFF or SYSTEM_DEFAULT"
            ))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolved(range: &str, peers: &str, localhost_only: &str) -> Result<Discovery, Failure> {
        Discovery::resolve(|name| {
            Some(match name {
                "ROS_AUTOMATIC_DISCOVERY_RANGE" => range.to_owned(),
                "ROS_STATIC_PEERS" => peers.to_owned(),
                _ => localhost_only.to_owned(),
            })
        })
    }

    #[test]
    fn the_environment_is_read_as_ros_2_does() {
        let expect = |range, peers: &[&str]| Discovery {
            range,
            static_peers: peers.iter().map(|peer| peer.parse().unwrap()).collect(),
        };
        for (range, peers, only, expected) in [
            ("", "", "", expect(Range::Subnet, &[])),
            (
                "SUBNET",
                "10.0.0.1;robot.local;",
                "0",
                expect(Range::Subnet, &["10.0.0.1", "robot.local"]),
            ),
            ("LOCALHOST", "10.0.0.1", "", expect(Range::Localhost, &["10.0.0.1"])),
            ("OFF", "10.0.0.1", "", expect(Range::Off, &[])),
            ("SYSTEM_DEFAULT", "10.0.0.1", "", expect(Range::Subnet, &[])),
            ("SUBNET", "10.0.0.1", "1", expect(Range::Localhost, &[])),
        ] {
            assert_eq!(resolved(range, peers, only).unwrap(), expected, "{range} {peers} {only}");
        }
    }

    #[test]
    fn what_ros_2_does_not_know_is_a_usage_error() {
        let long = "x".repeat(300);
        for (range, peers) in [
            ("subnet", ""),
            ("", "10.0.0.1 10.0.0.2"),
            ("", "<Peer/>"),
            ("", "10.0.0.256"),
            ("", "::1"),
            ("", "10.0.0.1:0"),
            ("", "10.0.0.1:99999"),
            ("", &long),
        ] {
            let refused = resolved(range, peers, "");
            assert!(matches!(refused, Err(Failure::Usage(_))), "{range} {peers}: {refused:?}");
        }
    }
}
