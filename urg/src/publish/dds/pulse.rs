//! Local socket that receives the participant's announcements, like any other participant.
//! The first announcement has the participant's identity, and later ones show that Cyclone is
//! alive, without calling Cyclone, which might hang.

use std::io;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use super::rtps::{Prefix, sender};

/// Size of the receive buffer. Only the start of a packet matters.
const PACKET: usize = 2048;

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
            if let Some(prefix) = self.receive() {
                return Some(prefix);
            }
            if Instant::now() > end {
                return None;
            }
            std::thread::sleep(CHECK_INTERVAL);
        }
    }

    /// Checks whether an announcement has arrived since the last call.
    pub(super) fn beats(&self) -> bool {
        let mut beats = false;
        while self.receive().is_some() {
            beats = true;
        }
        beats
    }

    /// Reads the prefix of a pending packet. Skips packets that are not from Cyclone.
    fn receive(&self) -> Option<Prefix> {
        let mut packet = [0; PACKET];
        loop {
            let length = self.socket.recv(&mut packet).ok()?;
            if let Some(prefix) = packet.get(..length).and_then(prefix) {
                return Some(prefix);
            }
        }
    }
}

/// Parses the sender of a packet, if its vendor is Cyclone.
fn prefix(packet: &[u8]) -> Option<Prefix> {
    sender(packet).filter(|prefix| prefix.starts_with(&[0x01, 0x10]))
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
