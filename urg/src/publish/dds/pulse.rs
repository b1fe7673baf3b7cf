//! Local socket that receives the participant's announcements, like any other participant.
//! The first announcement has the participant's identity, and later ones show that Cyclone is
//! alive, without calling Cyclone, which might hang.

use std::io;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use super::rtps::{Prefix, senders};

/// First bytes of the prefix of every participant of Cyclone: the number of the vendor.
const CYCLONE: [u8; 2] = [0x01, 0x10];

/// Pause between two checks for the first packet.
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

    /// Blocks until the first announcement, for at most `timeout`. Returns the participant's
    /// prefix.
    pub(super) fn first(&self, timeout: Duration) -> Option<Prefix> {
        let end = Instant::now() + timeout;
        loop {
            let prefix = self.arrived().next();
            if prefix.is_some() || Instant::now() > end {
                return prefix;
            }
            std::thread::sleep(CHECK_INTERVAL);
        }
    }

    /// Checks whether an announcement has arrived since the last call.
    pub(super) fn beats(&self) -> bool {
        self.arrived().count() > 0
    }

    /// Receives the announcements that have arrived. Skips packets that are not from Cyclone.
    fn arrived(&self) -> impl Iterator<Item = Prefix> {
        senders(&self.socket).filter(|prefix| prefix.starts_with(&CYCLONE))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_beats_once_for_each_look_at_what_arrived() {
        let pulse = Pulse::bind().unwrap();
        let sender = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        assert!(!pulse.beats());
        sender.send_to(b"noise", pulse.address()).unwrap();
        assert!(!pulse.beats());
        for _ in 0..2 {
            sender.send_to(b"RTPS\x02\x05\x01\x10\x01\x10abcdefghij", pulse.address()).unwrap();
        }
        assert!(pulse.first(Duration::from_secs(10)).is_some());
        assert!(pulse.beats());
        assert!(!pulse.beats());
    }
}
