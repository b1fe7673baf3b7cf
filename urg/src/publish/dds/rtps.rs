//! Parser of the RTPS header: the sender of a DDS packet.

/// GUID prefix, common to a participant and its entities.
pub(super) type Prefix = [u8; 12];

pub(super) fn sender(packet: &[u8]) -> Option<Prefix> {
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
