//! Local socket that receives the participant's announcements, like any other participant.
//! The first announcement has the participant's identity, and later ones show that Cyclone is
//! alive, without calling Cyclone, which might hang.

use std::io;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use super::rtps::{Packet, packets};

/// First bytes of the prefix of every participant of Cyclone: the number of the vendor.
const CYCLONE: [u8; 2] = [0x01, 0x10];

const CHECK_INTERVAL: Duration = Duration::from_millis(5);

/// Receiver of a participant's announcements.
pub(super) struct Pulse {
    socket: UdpSocket,
    address: SocketAddr,
}

impl Pulse {
    pub(super) fn bind() -> io::Result<Self> {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
        socket.set_nonblocking(true)?;
        let address = socket.local_addr()?;
        Ok(Self { socket, address })
    }

    /// Address to add to the participant's peers.
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }

    /// Blocks until the first announcement, for at most `timeout`.
    pub(super) fn first(&self, timeout: Duration) -> Option<Packet> {
        let end = Instant::now() + timeout;
        loop {
            let first = self.latest();
            if first.is_some() || Instant::now() > end {
                return first;
            }
            std::thread::sleep(CHECK_INTERVAL);
        }
    }

    /// Latest announcement, if one has arrived since the last call. Skips packets that are not
    /// from Cyclone.
    pub(super) fn latest(&self) -> Option<Packet> {
        packets(&self.socket).filter(|packet| packet.sender.starts_with(&CYCLONE)).last()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_beats_once_for_each_check_at_what_arrived() {
        let pulse = Pulse::bind().unwrap();
        let sender = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        assert!(pulse.latest().is_none());
        sender.send_to(b"noise", pulse.address()).unwrap();
        assert!(pulse.latest().is_none());
        let announcement = b"RTPS\x02\x05\x01\x10\x01\x10abcdefghij and more";
        for _ in 0..2 {
            sender.send_to(announcement, pulse.address()).unwrap();
        }
        assert_eq!(pulse.first(Duration::from_secs(10)).unwrap().bytes, announcement);
        assert!(pulse.latest().is_none());
    }
}
