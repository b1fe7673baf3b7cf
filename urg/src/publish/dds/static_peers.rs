//! [`StaticPeers`]: repeats the participant's announcements to the hosts in `ROS_STATIC_PEERS`.
//!
//! Cyclone is not asked to do this. It ends the process for a name without an address. And it
//! blocks on hosts that are down: the system keeps packets for a host that does not answer ARP,
//! until they fill the buffer of the socket that also sends scans. Here each host has a socket
//! of its own, which never blocks.

use std::io;
use std::net::{IpAddr, Ipv4Addr, ToSocketAddrs, UdpSocket};
use std::sync::Arc;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use parking_lot::Mutex;

use crate::publish::discovery::StaticPeer;

/// Highest participant index to try at a peer, as in ROS 2: each index costs a packet.
const MAX_PEER_INDEX: u32 = 32;

const LOOKUP_INTERVAL: Duration = Duration::from_secs(10);

/// Hosts that get the participant's announcements.
pub(super) struct StaticPeers {
    peers: Vec<Peer>,
    /// Ports of the participants of a domain, at a peer without a port of its own.
    ports: Vec<u16>,
}

struct Peer {
    host: String,
    port: Option<u16>,
    socket: UdpSocket,
    address: Arc<Mutex<Address>>,
    /// Ends the lookups of the name when it is dropped.
    _lookups: Option<mpsc::Sender<()>>,
}

/// Address of a peer. A failed lookup does not remove an earlier address.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Address {
    Unknown,
    Missing,
    Known(Ipv4Addr),
}

impl StaticPeers {
    /// Starts the lookups of names. `only` restricts the sender to one local address.
    pub(super) fn new(peers: &[StaticPeer], domain: u16, only: Option<IpAddr>) -> io::Result<Self> {
        let index_0 = 7410 + 250 * u32::from(domain);
        let ports = (0..=MAX_PEER_INDEX).filter_map(|n| u16::try_from(index_0 + 2 * n).ok());
        let peers = peers.iter().map(|peer| Peer::new(peer, only));
        Ok(Self { ports: ports.collect(), peers: peers.collect::<io::Result<_>>()? })
    }

    /// Sends an announcement to all peers with an address. Does not block.
    pub(super) fn announce(&self, announcement: &[u8]) {
        for peer in &self.peers {
            let Address::Known(address) = *peer.address.lock() else { continue };
            for port in peer.port.as_ref().map_or(&self.ports[..], std::slice::from_ref) {
                // A host that is down, or a full buffer: the next announcement tries again.
                let _ = peer.socket.send_to(announcement, (address, *port));
            }
        }
    }

    /// First peer whose name has no address.
    pub(super) fn missing(&self) -> Option<&str> {
        let is_missing = |peer: &&Peer| *peer.address.lock() == Address::Missing;
        self.peers.iter().find(is_missing).map(|peer| peer.host.as_str())
    }
}

impl Peer {
    fn new(peer: &StaticPeer, only: Option<IpAddr>) -> io::Result<Self> {
        let socket = UdpSocket::bind((only.unwrap_or(Ipv4Addr::UNSPECIFIED.into()), 0))?;
        socket.set_nonblocking(true)?;
        let host = peer.host.clone();
        let (address, lookups) = match host.parse() {
            Ok(address) => (Arc::new(Mutex::new(Address::Known(address))), None),
            Err(_) => {
                let address = Arc::new(Mutex::new(Address::Unknown));
                (Arc::clone(&address), Some(look_up(host.clone(), address)?))
            }
        };
        Ok(Self { host, port: peer.port, socket, address, _lookups: lookups })
    }
}

/// Looks up a name at regular intervals on a thread of its own, since a lookup may block for half
/// a minute, until the returned sender is dropped.
fn look_up(host: String, address: Arc<Mutex<Address>>) -> io::Result<mpsc::Sender<()>> {
    let (sender, ended) = mpsc::channel::<()>();
    std::thread::Builder::new().name("lookup".to_owned()).spawn(move || {
        loop {
            let found = (host.as_str(), 0).to_socket_addrs().ok().and_then(|mut found| {
                found.find_map(|found| match found.ip() {
                    IpAddr::V4(address) => Some(address),
                    IpAddr::V6(_) => None,
                })
            });
            let mut address = address.lock();
            match found {
                Some(found) => *address = Address::Known(found),
                None if *address == Address::Unknown => *address = Address::Missing,
                None => {}
            }
            drop(address);
            if ended.recv_timeout(LOOKUP_INTERVAL) != Err(RecvTimeoutError::Timeout) {
                return;
            }
        }
    })?;
    Ok(sender)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn peers(list: &[&str]) -> StaticPeers {
        let list: Vec<_> = list.iter().map(|peer| peer.parse().unwrap()).collect();
        StaticPeers::new(&list, 0, None).unwrap()
    }

    #[test]
    fn an_announcement_goes_to_addresses_and_to_names_once_they_have_one() {
        let receiver = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        receiver.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
        let port = receiver.local_addr().unwrap().port();
        for host in ["127.0.0.1", "localhost"] {
            let peers = peers(&[&format!("{host}:{port}")]);
            let mut packet = [0; 16];
            let received = (0..100).find_map(|_| {
                peers.announce(b"I am here");
                receiver.recv(&mut packet).ok()
            });
            assert_eq!(received.map(|length| &packet[..length]), Some(&b"I am here"[..]), "{host}");
        }
    }

    #[test]
    fn a_name_without_an_address_is_reported_and_the_others_get_announcements() {
        // The system refuses a label of more than 63 characters without asking a name server.
        let nobody = "x".repeat(64);
        let peers = peers(&["127.0.0.1", &nobody]);
        while peers.peers[1].address.lock().eq(&Address::Unknown) {
            std::thread::yield_now();
        }
        assert_eq!(peers.missing(), Some(nobody.as_str()));
        peers.announce(b"I am here");
    }

    #[test]
    fn the_ports_are_those_of_the_participants_of_the_domain() {
        let peers = StaticPeers::new(&[], 2, None).unwrap();
        assert_eq!((peers.ports.first(), peers.ports.last()), (Some(&7910), Some(&7974)));
        assert_eq!(StaticPeers::new(&[], 232, None).unwrap().ports.last(), Some(&65474));
    }
}
