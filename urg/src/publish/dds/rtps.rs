//! Senders of DDS packets: the receiver of announcements, and the parser of the RTPS header.

use std::iter;
use std::net::UdpSocket;

/// GUID prefix, common to a participant and its entities.
pub(super) type Prefix = [u8; 12];

/// Receives the packets that have arrived, and returns their senders. Skips packets that are
/// not RTPS.
pub(super) fn senders(socket: &UdpSocket) -> impl Iterator<Item = Prefix> {
    // Only the start of a packet matters.
    let mut packet = [0; 2048];
    let packets = iter::from_fn(move || match socket.recv(&mut packet) {
        Ok(length) => Some(packet.get(..length).and_then(sender)),
        // WSAEMSGSIZE: Windows returns it for a packet longer than the buffer.
        Err(error) if error.raw_os_error() == Some(10_040) => Some(None),
        Err(_) => None,
    });
    packets.flatten()
}

fn sender(packet: &[u8]) -> Option<Prefix> {
    packet.strip_prefix(b"RTPS")?.get(4..16)?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_packet_names_its_sender() {
        let packet = b"RTPS\x02\x05\x01\x10\x01\x10abcdefghij and so on";
        assert_eq!(sender(packet), Some(*b"\x01\x10abcdefghij"));
        assert_eq!(sender(&packet[..19]), None);
        assert_eq!(sender(b"HTTP\x02\x05\x01\x10\x01\x10abcdefghij"), None);
    }
}
