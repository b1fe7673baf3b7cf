//! [`StaticPeers`]: repeats the participant's announcements to the hosts in `ROS_STATIC_PEERS`.
//!
//! Cyclone is not asked to do this. It ends the process for a name without an address. And it
//! blocks on hosts that are down: the system keeps packets for a host that does not answer ARP,
//! until they fill the buffer of the socket that also sends scans (five such hosts delay scans by
//! 3 s, ten stop them). Here each host has a socket of its own, which never blocks.

use std::io;
use std::net::{IpAddr, Ipv4Addr, ToSocketAddrs, UdpSocket};
use std::sync::{Arc, Weak};
use std::time::Duration;

use parking_lot::Mutex;

/// Highest participant index to try at a peer, as in ROS 2: each index costs a packet.
const MAX_PEER_INDEX: u16 = 32;

const LOOKUP_INTERVAL: Duration = Duration::from_secs(10);

/// Hosts that get the participant's announcements.
pub(super) struct StaticPeers {
    peers: Vec<Peer>,
    /// Port of the first participant of a machine.
    first_port: u16,
}

struct Peer {
    host: String,
    socket: UdpSocket,
    address: Arc<Mutex<Lookup>>,
}

/// `None` before the first lookup, `Some(None)` without an address. A failed lookup does not remove
/// an earlier address.
type Lookup = Option<Option<Ipv4Addr>>;

impl StaticPeers {
    /// Starts the lookups of names. `only` restricts the sender to one local address.
    pub(super) fn new(hosts: &[String], domain: u16, only: Option<IpAddr>) -> io::Result<Self> {
        // A domain of ROS ends below port 65,536.
        let first_port = 7410_u16.saturating_add(domain.saturating_mul(250));
        let peer = |host: &String| {
            let socket = UdpSocket::bind((only.unwrap_or(Ipv4Addr::UNSPECIFIED.into()), 0))?;
            socket.set_nonblocking(true)?;
            let known = host.parse().ok().map(Some);
            let address = Arc::new(Mutex::new(known));
            if known.is_none() {
                let (host, address) = (host.clone(), Arc::downgrade(&address));
                let thread = std::thread::Builder::new().name("lookup".to_owned());
                thread.spawn(move || look_up(&host, &address))?;
            }
            Ok(Peer { host: host.clone(), socket, address })
        };
        Ok(Self { peers: hosts.iter().map(peer).collect::<io::Result<_>>()?, first_port })
    }

    /// Sends an announcement to all peers with an address. Does not block.
    pub(super) fn announce(&self, announcement: &[u8]) {
        for peer in &self.peers {
            let Some(Some(address)) = *peer.address.lock() else { continue };
            for index in 0..=MAX_PEER_INDEX {
                let port = self.first_port.saturating_add(2 * index);
                // A host that is down, or a full buffer: the next announcement tries again.
                let _ = peer.socket.send_to(announcement, (address, port));
            }
        }
    }

    /// First peer whose name has no address.
    pub(super) fn missing(&self) -> Option<&str> {
        let is_missing = |peer: &&Peer| *peer.address.lock() == Some(None);
        self.peers.iter().find(is_missing).map(|peer| peer.host.as_str())
    }
}

/// Looks up a name again and again until nobody needs its address. Each call to the system may
/// block for half a minute.
fn look_up(host: &str, address: &Weak<Mutex<Lookup>>) {
    loop {
        let mut found = (host, 0).to_socket_addrs().into_iter().flatten();
        let found = found.find_map(|found| match found.ip() {
            IpAddr::V4(address) => Some(address),
            IpAddr::V6(_) => None,
        });
        let Some(address) = address.upgrade() else { return };
        let mut lookup = address.lock();
        *lookup = Some(found.or(lookup.flatten()));
        drop(lookup);
        drop(address);
        std::thread::sleep(LOOKUP_INTERVAL);
    }
}
