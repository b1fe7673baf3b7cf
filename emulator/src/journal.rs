//! What the sensor has received and done, for tests.

use std::collections::VecDeque;

use tokio::time::Instant;

use super::line_buffer::CommandLine;
use super::world::WorldTime;

/// Kind of a command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Verdict {
    /// Complete command of a protocol that the sensor knows, with valid parameters.
    WellFormed,
    /// Terminator without a command.
    Empty,
    /// Anything else.
    Malformed,
}

/// Command line that reached the sensor.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Received {
    /// When its terminator had arrived.
    pub at: Instant,
    /// Line without its terminator, at most 64 bytes.
    pub line: Vec<u8>,
    /// Result of parsing it as a command.
    pub verdict: Verdict,
    /// True if the two ends of the line had different baud rates.
    pub garbled: bool,
    /// True if its first byte arrived before the reply to an earlier command had ended
    /// (except for empty commands).
    pub overlapping: bool,
}

/// Scan that the sensor sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct SentScan {
    /// When the terminator of its `G`, or of its stream's `M`, had arrived. For a `G`, lies between
    /// [`requested_at`](tokio_scip::scan::ScanTimes::requested_at) and
    /// [`Scan::received_at`](tokio_scip::Scan::received_at).
    pub requested_at: Instant,
    /// End of the revolution that measured its distances.
    pub revolution_end: Instant,
    /// The same, and the times of its rays, counted from power-up. With them,
    /// [`Path::pose`](crate::Path::pose) and [`Walk::position`](crate::Walk::position) tell what
    /// the scan shows.
    pub time: WorldTime,
}

/// Counters since the emulated sensor was built.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Counts {
    /// Received command lines of any kind.
    pub commands: u64,
    /// Lines that were garbled because of a wrong baud rate.
    pub garbled: u64,
    /// Lines that were not garbled and are not a well-formed command.
    pub malformed: u64,
    /// Terminators without a command.
    pub empty: u64,
    /// Lines whose first byte arrived while an earlier command was unanswered.
    pub overlapping: u64,
    /// Lines that were dropped because the sensor's command queue was full.
    pub overrun: u64,
    /// Scans sent: `G` commands answered with distances, and scans of a stream.
    pub scans: u64,
    /// Replies of any kind, also those that a fault suppressed.
    pub replies: u64,
    /// Power-ups after the first one, by [`power_cycle`](super::Emulator::power_cycle)
    /// or by a fault.
    pub resets: u64,
}

/// Counters, latest command lines and latest scans.
#[derive(Debug)]
pub(super) struct Journal {
    pub(super) counts: Counts,
    pub(super) log: VecDeque<Received>,
    pub(super) scans: VecDeque<SentScan>,
    capacity: usize,
}

impl Journal {
    pub(super) fn new(capacity: usize) -> Self {
        Self { counts: Counts::default(), log: VecDeque::new(), scans: VecDeque::new(), capacity }
    }

    pub(super) fn record(&mut self, arrived: &CommandLine, verdict: Verdict) {
        let counts = &mut self.counts;
        counts.commands += 1;
        counts.garbled += u64::from(arrived.garbled);
        counts.malformed += u64::from(verdict == Verdict::Malformed && !arrived.garbled);
        counts.empty += u64::from(verdict == Verdict::Empty);
        counts.overlapping += u64::from(arrived.overlapping);
        let received = Received {
            at: arrived.at,
            line: arrived.bytes.clone(),
            verdict,
            garbled: arrived.garbled,
            overlapping: arrived.overlapping,
        };
        push(&mut self.log, self.capacity, received);
    }

    pub(super) fn record_scan(&mut self, scan: SentScan) {
        self.counts.scans += 1;
        push(&mut self.scans, self.capacity, scan);
    }
}

/// Adds an item to those that are kept.
fn push<T>(kept: &mut VecDeque<T>, capacity: usize, item: T) {
    kept.push_back(item);
    while kept.len() > capacity {
        kept.pop_front();
    }
}
