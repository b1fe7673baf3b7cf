//! Receiver of DDS packets, and the parser of what their senders say about themselves.

use std::net::UdpSocket;
use std::time::Duration;

/// GUID prefix, common to a participant and its entities.
pub(super) type Prefix = [u8; 12];

/// Kind of a submessage with a sample, as an announcement is one.
const DATA: u8 = 0x15;

/// Flags of a submessage.
const LITTLE_ENDIAN: u8 = 1;
const INLINE_QOS: u8 = 2;

/// Entity id of the writer of announcements.
const ANNOUNCER: [u8; 4] = [0, 1, 0, 0xC2];

/// Ids of parameters: of the lease, and of the end of a list.
const LEASE: u16 = 2;
const SENTINEL: u16 = 1;

/// Packet of a participant.
#[derive(Debug)]
pub(super) struct Packet {
    pub(super) sender: Prefix,
    pub(super) bytes: Vec<u8>,
}

impl Packet {
    /// Lease in an announcement: the silence after which others forget the participant.
    pub(super) fn lease(&self) -> Option<Duration> {
        let mut rest = self.bytes.get(20..)?;
        loop {
            let (&[kind, flags, high, low], after) = rest.split_first_chunk()?;
            let length = short([high, low], flags & LITTLE_ENDIAN != 0);
            // The last submessage may leave out its length.
            let body = if length == 0 { after } else { after.get(..length.into())? };
            if kind == DATA && body.get(8..12) == Some(&ANNOUNCER) {
                return announced_lease(body, flags);
            }
            rest = after.get(body.len()..)?;
        }
    }
}

fn announced_lease(body: &[u8], flags: u8) -> Option<Duration> {
    let is_little = flags & LITTLE_ENDIAN != 0;
    let before_payload = short(*body.get(2..)?.first_chunk()?, is_little);
    let mut payload = body.get(4..)?.get(before_payload.into()..)?;
    if flags & INLINE_QOS != 0 {
        while next_parameter(&mut payload, is_little)?.0 != SENTINEL {}
    }
    // The representation of the payload has a byte order of its own.
    let (&[_, representation, _, _], mut list) = payload.split_first_chunk()?;
    let is_little = representation & 1 != 0;
    loop {
        match next_parameter(&mut list, is_little)? {
            (SENTINEL, _) => return None,
            (LEASE, value) => {
                let mut seconds = *value.first_chunk::<4>()?;
                if is_little {
                    seconds.reverse();
                }
                return Some(Duration::from_secs(u32::from_be_bytes(seconds).into()));
            }
            _ => {}
        }
    }
}

/// Takes a parameter, its id and value, from the front of a list.
fn next_parameter<'a>(list: &mut &'a [u8], is_little: bool) -> Option<(u16, &'a [u8])> {
    let (&[id0, id1, length0, length1], rest) = list.split_first_chunk()?;
    let id = short([id0, id1], is_little);
    // The length of a sentinel has no meaning.
    let length = if id == SENTINEL { 0 } else { short([length0, length1], is_little) };
    let (value, rest) = rest.split_at_checked(length.into())?;
    *list = rest;
    Some((id, value))
}

fn short(bytes: [u8; 2], is_little: bool) -> u16 {
    if is_little { u16::from_le_bytes(bytes) } else { u16::from_be_bytes(bytes) }
}

/// Receives the packets that have arrived. Skips packets that are not RTPS, or longer than any
/// announcement.
pub(super) fn packets(socket: &UdpSocket) -> impl Iterator<Item = Packet> {
    let mut packet = [0; 8192];
    let packets =
        std::iter::from_fn(move || match socket.recv(&mut packet) {
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
pub(super) mod tests {
    use super::*;

    const HEADER: &[u8; 20] = b"RTPS\x02\x05\x01\x10\x01\x10abcdefghij";

    fn packet(parts: &[&[u8]]) -> Packet {
        let bytes = [&[&HEADER[..]], parts].concat().concat();
        Packet { sender: sender(&bytes).unwrap(), bytes }
    }

    /// Returns a little-endian announcement of a lease of `seconds`, as Cyclone DDS and Fast DDS
    /// send it: a timestamp, then data.
    pub(in crate::publish::dds) fn announced(seconds: u8) -> Packet {
        packet(&[
            &[0x09, 1, 8, 0, 1, 2, 3, 4, 5, 6, 7, 8],
            &[DATA, 5, 48, 0, 0, 0, 16, 0, 0, 1, 0, 0xC7, 0, 1, 0, 0xC2, 0, 0, 0, 0, 1, 0, 0, 0],
            &[0, 3, 0, 0, 0x15, 0, 4, 0, 2, 5, 0, 0, 2, 0, 8, 0, seconds, 0, 0, 0, 0, 0, 0, 0],
            &[1, 0, 0, 0],
        ])
    }

    #[test]
    fn a_packet_names_its_sender() {
        let packet = b"RTPS\x02\x05\x01\x10\x01\x10abcdefghij and so on";
        assert_eq!(sender(packet), Some(*b"\x01\x10abcdefghij"));
        assert_eq!(sender(&packet[..19]), None);
        assert_eq!(sender(b"HTTP\x02\x05\x01\x10\x01\x10abcdefghij"), None);
    }

    #[test]
    fn an_announcement_has_a_lease() {
        assert_eq!(announced(24).lease(), Some(Duration::from_secs(24)));
        // Big-endian, with inline QoS and without a length.
        let big = packet(&[
            &[DATA, 6, 0, 0, 0, 0, 0, 16, 0, 1, 0, 0xC7, 0, 1, 0, 0xC2, 0, 0, 0, 0, 0, 0, 0, 1],
            &[0, 0x70, 0, 4, 9, 9, 9, 9, 0, 1, 0, 0],
            &[0, 2, 0, 0, 0, 2, 0, 8, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0],
        ]);
        assert_eq!(big.lease(), Some(Duration::from_secs(256)));
        let none = packet(&[&[0x09, 1, 8, 0, 1, 2, 3, 4, 5, 6, 7, 8], &[7, 1, 0, 0]]);
        assert_eq!(none.lease(), None);
    }

    #[test]
    fn a_damaged_announcement_has_no_lease() {
        let whole = announced(24).bytes;
        for length in 20..whole.len() - 8 {
            assert_eq!(packet(&[&whole[20..length]]).lease(), None, "{length} bytes");
        }
        for (at, value) in (20..whole.len()).flat_map(|at| (0..=255).map(move |it| (at, it))) {
            let mut damaged = whole.clone();
            damaged[at] = value;
            // It must end, and not panic.
            packet(&[&damaged[20..]]).lease();
        }
    }
}
