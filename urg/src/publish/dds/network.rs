//! Choice of network interfaces for DDS, and Cyclone's configuration.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use super::static_peers::MAX_PEER_INDEX;
use crate::publish::discovery::{Discovery, Range};

const MAX_INTERFACES: usize = 4;

/// Highest index of a participant on this machine. The index selects its ports, and a domain
/// has ports for 120 participants.
const MAX_INDEX: u32 = 119;

/// Highest vendor number that Cyclone's configuration accepts. All DDS vendors have lower ones.
const MAX_VENDOR: u32 = 32;

/// Addresses of this machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Network {
    /// All addresses except loopback. If they change, the participant has to be reopened.
    addresses: BTreeSet<Ipv4Addr>,
    /// Addresses for DDS, one per interface.
    used: Vec<Ipv4Addr>,
}

impl Network {
    /// Reads the interfaces of the system. `only` restricts DDS to one address.
    pub(super) fn current(only: Option<IpAddr>, discovery: &Discovery) -> Self {
        if let Some(IpAddr::V4(only)) = only {
            return Self { addresses: BTreeSet::from([only]), used: vec![only] };
        }
        if discovery.range != Range::Subnet && discovery.static_peers.is_empty() {
            return Self { addresses: BTreeSet::new(), used: vec![Ipv4Addr::LOCALHOST] };
        }
        // An error means out of memory. The next check tries again.
        let interfaces = if_addrs::get_if_addrs().unwrap_or_default();
        let found = interfaces.into_iter().filter_map(|interface| match interface.ip() {
            IpAddr::V4(address) if !address.is_loopback() => {
                Some((interface.is_oper_up(), interface.name, address))
            }
            _ => None,
        });
        Self::from_interfaces(found.collect())
    }

    /// Chooses among interfaces, each with its state (up or not), name and address.
    fn from_interfaces(mut found: Vec<(bool, String, Ipv4Addr)>) -> Self {
        let addresses = found.iter().map(|(.., address)| *address).collect();
        // Cyclone does not mix link-local addresses with others.
        if found.iter().any(|(.., address)| !address.is_link_local()) {
            found.retain(|(.., address)| !address.is_link_local());
        } else {
            found.truncate(1);
        }
        let mut names = BTreeSet::new();
        found.retain(|(_, name, _)| names.insert(name.clone()));
        found.sort_by_key(|(is_up, ..)| !is_up);
        found.truncate(MAX_INTERFACES);
        let mut used: Vec<_> = found.into_iter().map(|(.., address)| address).collect();
        if used.is_empty() {
            used.push(Ipv4Addr::LOCALHOST);
        }
        Self { addresses, used }
    }

    pub(super) fn used(&self) -> &[Ipv4Addr] {
        &self.used
    }

    /// Whether loopback is the only interface.
    pub(super) fn is_absent(&self) -> bool {
        self.addresses.is_empty()
    }

    /// Checks whether an address was added or removed since `self`.
    pub(super) fn differs(&self, now: &Self) -> bool {
        self.addresses != now.addresses
    }

    /// Writes Cyclone's configuration. The participant announces itself to `pulse` as well.
    pub(super) fn config(&self, discovery: &Discovery, pulse: SocketAddr) -> String {
        let is_local = self.used == [Ipv4Addr::LOCALHOST];
        let is_off = discovery.range == Range::Off;
        let has_multicast = discovery.range == Range::Subnet;
        let mut interfaces = String::new();
        for address in &self.used {
            // The loopback of Linux supports multicast, but does not have the flag.
            let multicast = if is_local && has_multicast { " multicast=\"true\"" } else { "" };
            let _ = write!(interfaces, "<NetworkInterface address=\"{address}\"{multicast}/>");
        }
        let mut peers = format!("<Peer address=\"{pulse}\" PruneDelay=\"inf\"/>");
        let asks_this_machine = !is_off && (is_local || !has_multicast);
        if asks_this_machine {
            peers.push_str("<Peer address=\"127.0.0.1\" PruneDelay=\"inf\"/>");
        }
        let is_asked = asks_this_machine || !discovery.static_peers.is_empty();
        let max_index = if is_asked { MAX_PEER_INDEX } else { MAX_INDEX };
        // A unique tag isolates the participant, as in ROS 2.
        let tag =
            if is_off { format!("<Tag>urg_{}</Tag>", std::process::id()) } else { String::new() };
        let multicast = if has_multicast { "default" } else { "false" };
        let vendors: Vec<String> = (1..=MAX_VENDOR).map(|number| format!("1.{number}")).collect();
        let vendors = vendors.join(",");
        // LeaseDuration: same as Fast DDS.
        // SPDPInterval: a reader that forgot this participant finds it within one interval.
        // WriterLingerDuration: do not wait at exit to resend scans, which are stale by then.
        // WhcHigh: never block on a reader that acknowledges nothing. The history depth limits
        // the memory.
        // FragmentSize: send each message of up to 60 kB whole. When Cyclone resends fragments,
        // a late reader on Fast DDS 2.14 (Jazzy) may take an empty message and then hang.
        // IgnoreTypeInformation: match readers by the name of their type. Readers on Fast DDS 3
        // (Kilted) ask each other for type objects. Cyclone receives the answers too, finds them
        // invalid, and from then on refuses every reader of that type without a message to it.
        format!(
            "<Domain>\
             <General><Interfaces>{interfaces}</Interfaces>\
             <AllowMulticast>{multicast}</AllowMulticast>\
             <MaxMessageSize>65000B</MaxMessageSize><FragmentSize>60000B</FragmentSize></General>\
             <Discovery><ParticipantIndex>auto</ParticipantIndex>\
             <MaxAutoParticipantIndex>{max_index}</MaxAutoParticipantIndex>\
             <LeaseDuration>20s</LeaseDuration><SPDPInterval>2s</SPDPInterval>{tag}\
             <Peers AddLocalhost=\"false\">{peers}</Peers></Discovery>\
             <Internal><WriterLingerDuration>0s</WriterLingerDuration>\
             <Watermarks><WhcHigh>64MB</WhcHigh></Watermarks></Internal>\
             <Compatibility><IgnoreTypeInformation>{vendors}</IgnoreTypeInformation>\
             </Compatibility>\
             </Domain>"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn used(found: &[(bool, &str, &str)]) -> Vec<String> {
        let found = found
            .iter()
            .map(|(up, name, address)| (*up, (*name).to_owned(), address.parse().unwrap()))
            .collect();
        Network::from_interfaces(found).used.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn interfaces_that_are_up_come_first_and_cyclone_takes_four() {
        let found = [
            (false, "docker0", "172.17.0.1"),
            (true, "eth0", "10.0.0.1"),
            (true, "eth0", "10.0.0.2"),
            (true, "wlan0", "10.1.0.1"),
            (true, "tun0", "10.2.0.1"),
            (true, "eth1", "10.3.0.1"),
        ];
        assert_eq!(used(&found), ["10.0.0.1", "10.1.0.1", "10.2.0.1", "10.3.0.1"]);
    }

    #[test]
    fn a_link_local_address_is_used_only_where_there_is_no_other() {
        assert_eq!(used(&[(true, "a", "169.254.1.1"), (true, "b", "10.0.0.1")]), ["10.0.0.1"]);
        assert_eq!(
            used(&[(true, "a", "169.254.1.1"), (true, "b", "169.254.1.2")]),
            ["169.254.1.1"]
        );
        assert_eq!(used(&[]), ["127.0.0.1"]);
    }
}
