//! Local socket that receives the participant's announcements, like any other participant.
//! The first announcement has the participant's identity, and later ones show that Cyclone is
//! alive, without calling Cyclone, which might hang.

use std::io;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

/// GUID prefix, common to a participant and its entities.
pub(super) type Prefix = [u8; 12];

/// First bytes of the prefix of every participant of Cyclone: the number of the vendor.
const CYCLONE: [u8; 2] = [0x01, 0x10];

const RECEIVE_TIMEOUT: Duration = Duration::from_millis(1);

/// Receiver of a participant's announcements.
pub(super) struct Pulse(UdpSocket);

pub(super) struct Announcement {
    pub(super) sender: Prefix,
    pub(super) bytes: Vec<u8>,
}

impl Pulse {
    /// Returns the address to add to the participant's peers, too.
    pub(super) fn bind() -> io::Result<(Self, SocketAddr)> {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
        socket.set_read_timeout(Some(RECEIVE_TIMEOUT))?;
        let address = socket.local_addr()?;
        Ok((Self(socket), address))
    }

    /// Blocks until the first announcement, for at most `timeout`.
    pub(super) fn first(&self, timeout: Duration) -> Option<Announcement> {
        let end = Instant::now() + timeout;
        std::iter::repeat_with(|| self.latest())
            .find(|first| first.is_some() || Instant::now() > end)
            .flatten()
    }

    /// Latest announcement, if one has arrived since the last call. Skips packets that are not
    /// from Cyclone.
    pub(super) fn latest(&self) -> Option<Announcement> {
        let mut packet = [0; 8192];
        let mut latest = None;
        while let Ok(length) = self.0.recv(&mut packet) {
            let bytes = packet.get(..length).unwrap_or_default();
            latest = announcement(bytes).or(latest);
        }
        latest
    }
}

fn announcement(bytes: &[u8]) -> Option<Announcement> {
    let sender: Prefix = bytes.strip_prefix(b"RTPS")?.get(4..16)?.try_into().ok()?;
    sender.starts_with(&CYCLONE).then(|| Announcement { sender, bytes: bytes.to_owned() })
}
