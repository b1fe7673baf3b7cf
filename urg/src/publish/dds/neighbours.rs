//! Detects participants that announce themselves again after more than their lease.
//!
//! By then Cyclone has forgotten such a participant. But the participant, if its process was
//! only stopped, still remembers Cyclone. Cyclone's counter restarts, so the participant takes
//! new requests for old ones, and never answers. They find each other again only if Cyclone's
//! participant is reopened under a new name.

use std::collections::HashMap;
use std::io;
use std::net::{Ipv4Addr, UdpSocket};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use parking_lot::Mutex;
use socket2::{Domain, Protocol, SockAddr, Socket, Type};

use super::rtps::{Prefix, packets};

/// Default multicast group of DDS for announcements.
const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);

/// Silence after which a participant is forgotten. ROS 2 has a lease of 20 s; a second less,
/// because checks may be late.
const LEASE: Duration = Duration::from_secs(19);

/// Maximum number of participants to remember. A domain has room for 120 per machine.
const MAX_NEIGHBOURS: usize = 10_000;

/// When each participant was last heard. Outlives Cyclone's participant: another one may answer the
/// new participant directly, and then be silent before it announces itself to all.
pub(super) type Heard = Arc<Mutex<HashMap<Prefix, Instant>>>;

pub(super) struct Neighbours {
    socket: UdpSocket,
    heard: Heard,
    checked: (Instant, SystemTime),
}

impl Neighbours {
    /// Gives each participant in `heard` a new lease: any of them may know the new participant.
    pub(super) fn listen(domain: u16, interfaces: &[Ipv4Addr], heard: &Heard) -> io::Result<Self> {
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
        heard.lock().values_mut().for_each(|last| *last = checked.0);
        Ok(Self { socket: socket.into(), heard: Arc::clone(heard), checked })
    }

    /// Checks whether a forgotten participant is back. Also true if this process itself was
    /// stopped, or the machine slept. Call it at regular intervals.
    pub(super) fn is_one_back(&mut self) -> bool {
        let (now, clock) = (Instant::now(), SystemTime::now());
        let (before, clock_before) = std::mem::replace(&mut self.checked, (now, clock));
        // Only the wall clock includes the time that the machine slept.
        let slept = clock.duration_since(clock_before).unwrap_or_default();
        if now - before > LEASE || slept > LEASE {
            return true;
        }
        // Takes all of them, also after one that is back.
        packets(&self.socket).filter(|packet| self.hear(packet.sender, now)).count() > 0
    }

    /// Notes an announcement. True if the participant had been forgotten.
    fn hear(&self, sender: Prefix, now: Instant) -> bool {
        let mut heard = self.heard.lock();
        if heard.len() >= MAX_NEIGHBOURS {
            heard.clear();
        }
        heard.insert(sender, now).is_some_and(|before| now - before > LEASE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_participant_that_was_silent_for_its_lease_is_back() {
        let neighbours = Neighbours::listen(0, &[], &Heard::default()).unwrap();
        let start = Instant::now();
        let after = |seconds| start + Duration::from_secs(seconds);
        assert!(!neighbours.hear([1; 12], start), "it is new");
        assert!(!neighbours.hear([1; 12], after(15)));
        assert!(!neighbours.hear([2; 12], after(33)), "another one is new");
        assert!(neighbours.hear([1; 12], after(36)));
        assert!(!neighbours.hear([1; 12], after(39)), "once");
    }

    #[test]
    fn a_participant_that_was_last_heard_before_a_reopening_is_back_after_its_lease() {
        let heard = Heard::default();
        let before = Neighbours::listen(0, &[], &heard).unwrap();
        before.hear([1; 12], Instant::now());
        before.hear([2; 12], Instant::now());
        let after = Neighbours::listen(0, &[], &heard).unwrap();
        let reopened = Instant::now();
        assert!(!after.hear([1; 12], reopened + Duration::from_secs(15)), "it has a new lease");
        assert!(after.hear([2; 12], reopened + Duration::from_secs(42)));
    }

    #[test]
    fn a_process_that_was_stopped_is_back_itself() {
        let mut neighbours = Neighbours::listen(0, &[], &Heard::default()).unwrap();
        assert!(!neighbours.is_one_back());
        neighbours.checked.0 -= LEASE + Duration::from_secs(1);
        assert!(neighbours.is_one_back());
        neighbours.checked.1 -= LEASE + Duration::from_secs(1);
        assert!(neighbours.is_one_back(), "its machine slept");
        assert!(!neighbours.is_one_back());
    }
}
