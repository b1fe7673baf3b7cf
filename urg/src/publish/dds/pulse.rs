//! Local socket that receives the participant's announcements, like any other participant.
//! The first announcement has the participant's identity, and later ones show that Cyclone is
//! alive, without calling Cyclone, which might hang. Static peers get a copy of each.

use std::io;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use super::static_peers::StaticPeers;

/// GUID prefix, common to a participant and its entities.
pub(super) type Prefix = [u8; 12];

/// First bytes of the prefix of every participant of Cyclone: the number of the vendor.
const CYCLONE: [u8; 2] = [0x01, 0x10];

/// Receiver of a participant's announcements.
pub(super) struct Pulse {
    socket: UdpSocket,
    pub(super) static_peers: StaticPeers,
}

impl Pulse {
    /// Returns the address to add to the participant's peers, too.
    pub(super) fn bind(static_peers: StaticPeers) -> io::Result<(Self, SocketAddr)> {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
        socket.set_read_timeout(Some(Duration::from_millis(1)))?;
        let address = socket.local_addr()?;
        Ok((Self { socket, static_peers }, address))
    }

    /// Blocks until the first announcement, for at most `timeout`.
    pub(super) fn first(&self, timeout: Duration) -> Option<Prefix> {
        let end = Instant::now() + timeout;
        std::iter::repeat_with(|| self.relay())
            .find(|first| first.is_some() || Instant::now() > end)
            .flatten()
    }

    /// Sends the latest announcement to the static peers, if one has arrived since the last call.
    /// Returns its sender. Skips packets that are not from Cyclone.
    pub(super) fn relay(&self) -> Option<Prefix> {
        let mut packet = [0; 8192];
        let mut latest = None;
        while let Ok(length) = self.socket.recv(&mut packet) {
            let bytes = packet.get(..length).unwrap_or_default();
            latest = sender(bytes).map(|sender| (sender, bytes.to_owned())).or(latest);
        }
        let (sender, announcement) = latest?;
        self.static_peers.announce(&announcement);
        Some(sender)
    }
}

fn sender(announcement: &[u8]) -> Option<Prefix> {
    let prefix: Prefix = announcement.strip_prefix(b"RTPS")?.get(4..16)?.try_into().ok()?;
    prefix.starts_with(&CYCLONE).then_some(prefix)
}
