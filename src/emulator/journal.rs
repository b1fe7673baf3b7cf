//! What the sensor has received and done, for tests to look at.

use std::collections::VecDeque;

use tokio::time::Instant;

use super::request::{Arrived, Request};

/// What a command line was worth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Verdict {
    /// A whole command of SCIP 1.1 with parameters that exist.
    WellFormed,
    /// A terminator and nothing before it.
    Empty,
    /// Anything else.
    Malformed,
}

/// A command line that reached the sensor.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Received {
    /// When its terminator had arrived.
    pub at: Instant,
    /// The line without its terminator, at most 64 bytes.
    pub line: Vec<u8>,
    /// Whether it was a command.
    pub verdict: Verdict,
    /// Whether the two ends of the line had different speeds.
    pub garbled: bool,
    /// Whether it began to arrive while an earlier command, not an empty one,
    /// waited for the end of its reply.
    pub overlapping: bool,
}

/// What has come and gone since the emulated sensor was built.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Counts {
    /// Command lines that arrived, of any kind.
    pub commands: u64,
    /// Of these, lines that were garbled because of a wrong baud rate.
    pub garbled: u64,
    /// Lines that were not garbled and no well-formed command.
    pub malformed: u64,
    /// Terminators without a command.
    pub empty: u64,
    /// Lines that began to arrive while an earlier command was unanswered.
    pub overlapping: u64,
    /// Lines that were not kept because too many were waiting already.
    pub overrun: u64,
    /// `G` commands answered with distances.
    pub scans: u64,
    /// Replies of any kind that were due, before any fault.
    pub replies: u64,
    /// Power-ups after the first one, by [`power_cycle`](super::Emulator::power_cycle)
    /// or by a fault.
    pub resets: u64,
}

#[derive(Debug)]
pub(super) struct Journal {
    pub(super) counts: Counts,
    log: VecDeque<Received>,
    capacity: usize,
}

impl Journal {
    pub(super) fn new(capacity: usize) -> Self {
        Self { counts: Counts::default(), log: VecDeque::new(), capacity }
    }

    pub(super) fn record(&mut self, arrived: &Arrived) {
        let verdict = match arrived.request {
            Request::Version | Request::Laser(_) | Request::Speed(_) | Request::Scan { .. } => {
                Verdict::WellFormed
            }
            Request::Empty => Verdict::Empty,
            Request::Scip2 | Request::Undefined | Request::Refused(_) => Verdict::Malformed,
        };
        let counts = &mut self.counts;
        counts.commands += 1;
        counts.garbled += u64::from(arrived.garbled);
        counts.malformed += u64::from(verdict == Verdict::Malformed && !arrived.garbled);
        counts.empty += u64::from(verdict == Verdict::Empty);
        counts.overlapping += u64::from(arrived.overlapping);
        if self.capacity == 0 {
            return;
        }
        if self.log.len() == self.capacity {
            self.log.pop_front();
        }
        self.log.push_back(Received {
            at: arrived.at,
            line: arrived.bytes.clone(),
            verdict,
            garbled: arrived.garbled,
            overlapping: arrived.overlapping,
        });
    }

    pub(super) fn log(&self) -> Vec<Received> {
        self.log.iter().cloned().collect()
    }
}
