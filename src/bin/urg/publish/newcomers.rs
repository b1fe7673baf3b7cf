//! The pause before a DDS participant announces its nodes: until the participants that are
//! there know it, and until its turn comes among those that started in the same moment.
//!
//! Fast DDS keeps the announcements of all participants in one list, sorted by source
//! timestamp, and rustdds sends them without one. An announcement that arrives after a later
//! one of its participant may then stand behind that in the list: Fast DDS acknowledges it,
//! and skips it for good. So announcements must arrive in order. They do not where the
//! receiver did not know the participant yet, or lost some, and they are sent again.

use std::time::{Duration, Instant};

use ros2_client::dds::rustdds::{
    DomainParticipant, DomainParticipantStatusEvent, DomainParticipantStatusListener, RTPSEntity,
    StatusEvented,
};

/// The pause at the start. On an idle machine participants discover each other within a
/// quarter of it.
const FIRST_PAUSE: Duration = Duration::from_millis(500);

/// The pause after each discovery: a newcomer requests what was announced before it came.
const QUIET: Duration = Duration::from_millis(300);

/// The time that one participant has to announce its nodes.
const TURN: Duration = Duration::from_millis(100);

/// The longest wait for quiet, and the longest for a turn: scans must not wait for ever.
const LONGEST_PAUSE: Duration = Duration::from_secs(5);

const CHECK_INTERVAL: Duration = Duration::from_millis(10);

/// Bytes of a participant's identity that are the same for all that use rustdds.
const VENDOR_BYTES: usize = 2;

/// Watches for newly discovered participants.
pub(super) struct Newcomers {
    listener: DomainParticipantStatusListener,
    pause: Pause,
}

impl Newcomers {
    /// Starts to watch for those that `participant` discovers. Takes its events: an event
    /// has one reader.
    pub(super) fn of(participant: &DomainParticipant) -> Self {
        let own = participant.guid().to_bytes();
        Self { listener: participant.status_listener(), pause: Pause::new(own, Instant::now()) }
    }

    /// Blocks until there was no newcomer for a while.
    pub(super) fn wait_until_quiet(&mut self) {
        loop {
            while let Some(event) = self.listener.try_recv_status() {
                if let DomainParticipantStatusEvent::ParticipantDiscovered { dpd } = event {
                    self.pause.add(dpd.guid.to_bytes(), Instant::now());
                }
            }
            if Instant::now() >= self.pause.end {
                return;
            }
            std::thread::sleep(CHECK_INTERVAL);
        }
    }

    /// Blocks until the turn of this participant. Those that started in the same moment
    /// know each other by now, and take turns in the order of their identities.
    pub(super) fn wait_for_turn(&self) {
        std::thread::sleep(self.pause.turn());
    }
}

/// The end of the pause, as far as it is known.
struct Pause {
    own: [u8; 16],
    /// The number of participants of rustdds whose turn is earlier.
    before: u32,
    end: Instant,
    latest_end: Instant,
}

impl Pause {
    fn new(own: [u8; 16], now: Instant) -> Self {
        Self { own, before: 0, end: now + FIRST_PAUSE, latest_end: now + LONGEST_PAUSE }
    }

    fn add(&mut self, newcomer: [u8; 16], now: Instant) {
        let vendor = |identity: [u8; 16]| identity.into_iter().take(VENDOR_BYTES);
        if vendor(newcomer).eq(vendor(self.own)) && newcomer < self.own {
            self.before += 1;
        }
        self.end = self.end.max(now + QUIET).min(self.latest_end);
    }

    fn turn(&self) -> Duration {
        (TURN * self.before).min(LONGEST_PAUSE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn identity(bytes: &[u8]) -> [u8; 16] {
        let mut identity = [0; 16];
        identity[..bytes.len()].copy_from_slice(bytes);
        identity
    }

    #[test]
    fn a_newcomer_prolongs_the_pause_but_not_for_ever() {
        let start = Instant::now();
        let mut pause = Pause::new(identity(&[1, 18, 5]), start);
        assert_eq!(pause.end, start + FIRST_PAUSE);
        pause.add(identity(&[1, 15, 1]), start + Duration::from_millis(10));
        assert_eq!(pause.end, start + FIRST_PAUSE);
        pause.add(identity(&[1, 15, 2]), start + FIRST_PAUSE);
        assert_eq!(pause.end, start + FIRST_PAUSE + QUIET);
        pause.add(identity(&[1, 15, 3]), start + LONGEST_PAUSE);
        assert_eq!(pause.end, start + LONGEST_PAUSE);
    }

    #[test]
    fn participants_of_this_engine_take_turns_in_the_order_of_their_identities() {
        let now = Instant::now();
        let all = [identity(&[1, 18, 7]), identity(&[1, 18, 3]), identity(&[1, 18, 5])];
        let turns = all.map(|own| {
            let mut pause = Pause::new(own, now);
            all.iter().filter(|other| **other != own).for_each(|other| pause.add(*other, now));
            // Fast DDS: whatever it is, it is no reason to wait for a turn.
            pause.add(identity(&[1, 15, 1]), now);
            pause.turn()
        });
        assert_eq!(turns, [2 * TURN, Duration::ZERO, TURN]);
    }
}
