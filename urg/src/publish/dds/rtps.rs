//! Receiver of DDS packets, and the parser of the RTPS header.

use std::iter;
use std::net::UdpSocket;

/// GUID prefix, common to a participant and its entities.
pub(super) type Prefix = [u8; 12];

/// Packet of a participant.
#[derive(Debug)]
pub(super) struct Packet {
    pub(super) sender: Prefix,
    pub(super) bytes: Vec<u8>,
}

/// Receives the packets that have arrived. Skips packets that are not RTPS, or longer than any
/// announcement.
pub(super) fn packets(socket: &UdpSocket) -> impl Iterator<Item = Packet> {
    let mut packet = [0; 8192];
    let packets =
        iter::from_fn(move || match socket.recv(&mut packet) {
            Ok(length) if length == packet.len() => Some(None),
            Ok(length) => Some(packet.get(..length).and_then(|bytes| {
                Some(Packet { sender: sender(bytes)?, bytes: bytes.to_owned() })
            })),
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
