//! Choice of network interfaces for DDS, and Cyclone's configuration.

use std::collections::BTreeSet;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use crate::publish::discovery::{Discovery, Range};

/// Maximum of Cyclone.
const MAX_INTERFACES: usize = 4;

/// Highest index of a participant on this machine. The index selects its ports, and a domain
/// has ports for 120 participants.
const MAX_INDEX: u32 = 119;

/// Highest vendor number that Cyclone's configuration accepts. All DDS vendors have lower ones.
const MAX_VENDOR: u32 = 32;

/// Addresses of this machine.
#[derive(Debug, Clone)]
pub(super) struct Network {
    /// All addresses except loopback, if any, with the index of their interface. If they change, the
    /// participant has to be reopened. An interface that is made again has another index.
    pub(super) addresses: BTreeSet<(Option<u32>, Ipv4Addr)>,
    /// Addresses for DDS, one per interface.
    used: Vec<Ipv4Addr>,
    /// Addresses for which DDS has no room.
    left_out: Vec<Ipv4Addr>,
    /// Whether all used interfaces are up.
    pub(super) is_up: bool,
}

impl Network {
    /// Reads the interfaces of the system. `only` restricts DDS to one address.
    pub(super) fn current(only: Option<IpAddr>, discovery: &Discovery) -> Self {
        if !discovery.is_beyond_this_machine() && only.is_none() {
            return Self::from_interfaces(Vec::new());
        }
        // An error means out of memory. The next check tries again.
        let found = if_addrs::get_if_addrs().unwrap_or_default().into_iter().filter_map(|it| {
            let IpAddr::V4(address) = it.ip() else { return None };
            let is_used = only.map_or(!address.is_loopback(), |only| only == address);
            is_used.then(|| (it.is_oper_up(), it.index, it.name, address))
        });
        Self::from_interfaces(found.collect())
    }

    /// Chooses among interfaces: whether each is up, its index, name and address.
    fn from_interfaces(mut found: Vec<(bool, Option<u32>, String, Ipv4Addr)>) -> Self {
        let addresses = found.iter().map(|(_, index, _, address)| (*index, *address)).collect();
        // Cyclone does not mix link-local addresses with others.
        if found.iter().any(|(.., address)| !address.is_link_local()) {
            found.retain(|(.., address)| !address.is_link_local());
        } else {
            found.truncate(1);
        }
        let mut names = BTreeSet::new();
        found.retain(|(_, _, name, _)| names.insert(name.clone()));
        found.sort_by_key(|(is_up, ..)| !is_up);
        let is_up = found.iter().take(MAX_INTERFACES).all(|(is_up, ..)| *is_up);
        let mut used: Vec<_> = found.into_iter().map(|(.., address)| address).collect();
        let left_out = used.split_off(used.len().min(MAX_INTERFACES));
        if used.is_empty() {
            used.push(Ipv4Addr::LOCALHOST);
        }
        Self { addresses, used, left_out, is_up }
    }

    /// Line for the user if there are more interfaces than DDS can use.
    pub(super) fn shortage(&self) -> Option<String> {
        let list = |addresses: &[Ipv4Addr]| {
            addresses.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
        };
        let (used, left_out) = (list(&self.used), list(&self.left_out));
        (!left_out.is_empty()).then(|| {
            format!("DDS uses only {used}, and not {left_out}: choose one with --interface")
        })
    }

    /// Whether to ask participants on this machine one by one: they may not listen to multicast.
    pub(super) fn asks_this_machine(&self, discovery: &Discovery) -> bool {
        match discovery.range {
            Range::Subnet => self.used == [Ipv4Addr::LOCALHOST],
            Range::Localhost => true,
            Range::Off => false,
        }
    }

    /// Writes Cyclone's configuration. The participant announces itself to `pulse` as well, and
    /// traces discovery to the file `trace`.
    pub(super) fn config(
        &self,
        discovery: &Discovery,
        pulse: SocketAddr,
        trace: Option<String>,
    ) -> String {
        let has_multicast = discovery.range == Range::Subnet;
        // The loopback of Linux supports multicast, but does not have the flag.
        let is_forced = has_multicast && self.used == [Ipv4Addr::LOCALHOST];
        let flag = if is_forced { " multicast=\"true\"" } else { "" };
        let interface = |address| format!("<NetworkInterface address=\"{address}\"{flag}/>");
        let interfaces: String = self.used.iter().map(interface).collect();
        // A unique tag isolates the participant, as in ROS 2.
        let tag = (discovery.range == Range::Off).then(std::process::id);
        let tag = tag.map(|id| format!("<Tag>urg_{id}</Tag>")).unwrap_or_default();
        let multicast = if has_multicast { "default" } else { "false" };
        let vendors = (1..=MAX_VENDOR).map(|it| format!("1.{it}")).collect::<Vec<_>>().join(",");
        let trace = trace
            .map(|path| format!("<Category>discovery</Category><OutputFile>{path}</OutputFile>"));
        let trace = trace.unwrap_or_default();
        // LeaseDuration: as in `trace`. SPDPInterval: a reader that forgot this participant finds it within
        // one interval. WriterLingerDuration: do not wait at exit to resend scans, which are stale by then.
        // GenerateKeyhash: else Fast DDS lists ended writers until their lease expires
        // (`findings/fastdds_ended_writers.sh`). WhcHigh: never block on a reader that acknowledges
        // nothing. The history depth limits the memory. FragmentSize: send up to 60 kB whole. When Cyclone
        // resends fragments, a late reader on Fast DDS 2.14 (Jazzy) may take an empty message and hang.
        // IgnoreTypeInformation: match readers by the name of their type. Readers on Fast DDS 3
        // (Kilted) ask each other for type objects. Cyclone receives the answers too, finds them
        // invalid, and from then on refuses every reader of that type without a message to it.
        format!(
            "<Domain>\
             <General><Interfaces>{interfaces}</Interfaces>\
             <AllowMulticast>{multicast}</AllowMulticast>\
             <MaxMessageSize>65000B</MaxMessageSize><FragmentSize>60000B</FragmentSize></General>\
             <Discovery><ParticipantIndex>auto</ParticipantIndex>\
             <MaxAutoParticipantIndex>{MAX_INDEX}</MaxAutoParticipantIndex>\
             <LeaseDuration>24s</LeaseDuration><SPDPInterval>2s</SPDPInterval>{tag}\
             <Peers AddLocalhost=\"false\"><Peer address=\"{pulse}\" PruneDelay=\"inf\"/></Peers></Discovery>\
             <Internal><WriterLingerDuration>0s</WriterLingerDuration><GenerateKeyhash>true</GenerateKeyhash>\
             <Watermarks><WhcHigh>64MB</WhcHigh></Watermarks></Internal>\
             <Compatibility><IgnoreTypeInformation>{vendors}</IgnoreTypeInformation></Compatibility>\
             <Tracing>{trace}</Tracing></Domain>"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interfaces_that_are_up_come_first_and_cyclone_takes_four() {
        let network = |found: &[(bool, &str, &str)]| {
            let interface = |&(is_up, name, address): &(bool, &str, &str)| {
                (is_up, None, name.to_owned(), address.parse().unwrap())
            };
            Network::from_interfaces(found.iter().map(interface).collect())
        };
        let found = [
            (false, "docker0", "172.17.0.1"),
            (true, "eth0", "10.0.0.1"),
            (true, "eth0", "10.0.0.2"),
            (true, "wlan0", "10.1.0.1"),
            (true, "usb0", "169.254.1.1"),
            (true, "tun0", "10.2.0.1"),
            (true, "eth1", "10.3.0.1"),
        ];
        let line = "DDS uses only 10.0.0.1, 10.1.0.1, 10.2.0.1, 10.3.0.1, and not 172.17.0.1: \
                    choose one with --interface";
        assert_eq!(network(&found).shortage().as_deref(), Some(line));
        assert_eq!(network(&found[1..]).shortage(), None);
        assert!(network(&found).is_up && !network(&found[..1]).is_up);
        let link_local = [found[4], (true, "usb1", "169.254.1.2")];
        assert_eq!(network(&link_local).used, [Ipv4Addr::new(169, 254, 1, 1)]);
        assert_eq!(network(&[]).used, [Ipv4Addr::LOCALHOST]);
    }
}
