//! Detects participants that announce themselves again after more than their lease.
//!
//! By then Cyclone has forgotten such a participant. But the participant, if its process was
//! only stopped, still remembers Cyclone. Cyclone's counter restarts, so the participant takes
//! new requests for old ones, and never answers. They find each other again only if Cyclone's
//! participant is reopened under a new name.

use std::collections::HashMap;
use std::io;
use std::net::{Ipv4Addr, UdpSocket};
use std::time::{Duration, Instant, SystemTime};

use socket2::{Domain, Protocol, SockAddr, Socket, Type};

use super::rtps::{Packet, Prefix, packets};

/// Default multicast group of DDS for announcements.
const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);

/// Silence after which others forget this process. Its lease, as in `network`, is a second
/// longer: checks may be late.
const OWN_LEASE: Duration = Duration::from_secs(19);

/// Lease of a participant that announces none.
const DEFAULT_LEASE: Duration = Duration::from_secs(100);

/// Maximum number of participants to remember. A domain has room for 120 per machine.
const MAX_NEIGHBOURS: usize = 10_000;

/// Participants by their identity. Outlives Cyclone's participant: another one may answer the
/// new participant directly, and then be silent before it announces itself to all.
pub(super) type Heard = HashMap<Prefix, Neighbour>;

#[derive(Debug, Clone, Copy)]
pub(super) struct Neighbour {
    /// When its latest announcement was received.
    last: Instant,
    lease: Duration,
}

pub(super) struct Neighbours {
    socket: UdpSocket,
    checked: (Instant, SystemTime),
}

impl Neighbours {
    /// Gives each participant in `heard` a new lease: any of them may know the new participant.
    pub(super) fn listen(
        domain: u16,
        interfaces: &[Ipv4Addr],
        heard: &mut Heard,
    ) -> io::Result<Self> {
        let port = 7400 + 250 * u32::from(domain);
        let port = u16::try_from(port).map_err(io::Error::other)?;
        let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
        // All participants on this machine share the port.
        socket.set_reuse_address(true)?;
        socket.set_nonblocking(true)?;
        socket.bind(&SockAddr::from(std::net::SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, port)))?;
        for interface in interfaces {
            // An interface without multicast receives no announcements anyway.
            let _ = socket.join_multicast_v4(&GROUP, interface);
        }
        let checked = (Instant::now(), SystemTime::now());
        heard.values_mut().for_each(|neighbour| neighbour.last = checked.0);
        Ok(Self { socket: socket.into(), checked })
    }

    /// Checks whether a forgotten participant is back, or this process itself, after it was
    /// stopped or the machine slept. Returns a line for the user. Call it at regular intervals.
    pub(super) fn returned(&mut self, heard: &mut Heard) -> Option<String> {
        let (now, clock) = (Instant::now(), SystemTime::now());
        let (before, clock_before) = std::mem::replace(&mut self.checked, (now, clock));
        // Only the wall clock includes the time that the machine slept.
        let slept = clock.duration_since(clock_before).unwrap_or_default();
        let stopped = slept.max(now - before);
        if stopped > OWN_LEASE {
            return Some(format!("this program was stopped for {} s", stopped.as_secs()));
        }
        // Takes all of them, also after one that is back.
        let silences = packets(&self.socket).filter_map(|packet| hear(heard, &packet, now));
        let silence = silences.max()?;
        Some(format!("a reader is back that was silent for {} s", silence.as_secs()))
    }
}

/// Remembers an announcement. Returns the silence before it, if the participant had been
/// forgotten.
fn hear(heard: &mut Heard, packet: &Packet, now: Instant) -> Option<Duration> {
    if heard.len() >= MAX_NEIGHBOURS {
        heard.clear();
    }
    let neighbour =
        heard.entry(packet.sender).or_insert(Neighbour { last: now, lease: DEFAULT_LEASE });
    let silence = now - std::mem::replace(&mut neighbour.last, now);
    // Checks may be late.
    let is_back = silence > neighbour.lease.mul_f64(0.95);
    neighbour.lease = packet.lease().unwrap_or(neighbour.lease);
    is_back.then_some(silence)
}

#[cfg(test)]
mod tests {
    use super::super::rtps::tests::announced;
    use super::*;

    fn announcement(number: u8) -> Packet {
        Packet { sender: [number; 12], ..announced(24) }
    }

    #[test]
    fn a_participant_that_was_silent_for_its_lease_is_back() {
        let (mut heard, start) = (Heard::default(), Instant::now());
        let mut hear = |number, seconds| {
            super::hear(&mut heard, &announcement(number), start + Duration::from_secs(seconds))
        };
        assert_eq!(hear(1, 0), None, "it is new");
        assert_eq!(hear(1, 22), None);
        assert_eq!(hear(2, 33), None, "another one is new");
        assert_eq!(hear(1, 46), Some(Duration::from_secs(24)));
        assert_eq!(hear(1, 49), None, "once");
    }

    #[test]
    fn a_participant_that_was_last_heard_before_a_reopening_is_back_after_its_lease() {
        let mut heard = Heard::default();
        for number in [1, 2] {
            hear(&mut heard, &announcement(number), Instant::now());
        }
        Neighbours::listen(0, &[], &mut heard).unwrap();
        let reopened = Instant::now();
        let mut hear = |number, seconds| {
            super::hear(&mut heard, &announcement(number), reopened + Duration::from_secs(seconds))
        };
        assert_eq!(hear(1, 15), None, "it has a new lease");
        assert!(hear(2, 42).is_some());
    }

    #[test]
    fn a_process_that_was_stopped_is_back_itself() {
        let mut heard = Heard::default();
        let mut neighbours = Neighbours::listen(0, &[], &mut heard).unwrap();
        let long = OWN_LEASE + Duration::from_secs(1);
        assert_eq!(neighbours.returned(&mut heard), None);
        neighbours.checked.0 -= long;
        assert!(neighbours.returned(&mut heard).is_some());
        neighbours.checked.1 -= long;
        assert!(neighbours.returned(&mut heard).is_some(), "its machine slept");
        assert_eq!(neighbours.returned(&mut heard), None);
    }
}
