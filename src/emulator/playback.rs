//! [`Playback`]: replies to `G` that are known in advance, such as those of a
//! recording, sent in place of what a world would measure.
//!
//! The replies come from a [`Script`]; the recording module implements it.

use std::io;
use std::time::{Duration, SystemTime};

use tokio::time::Instant;

use super::scip::HostCommand;
use super::world::Values;

/// The longest time for which the sensor holds a reply back until it is due; an
/// earlier `G` is not answered. It is less than the deadline of a driver.
const MAX_HOLD: Duration = Duration::from_millis(400);

/// A source of replies in a fixed order.
pub(crate) trait Script: Send {
    /// Returns the time from the first reply to the next one, `None` after the
    /// last one.
    fn due(&self) -> Option<Duration>;

    /// Returns true if a `G` for the single step `step` asks for the next reply,
    /// and is not a fence.
    fn is_single_step(&self, step: u16) -> bool;

    /// Goes on to the next reply. Returns its bytes, as an answer to `command`, if
    /// they cannot be encoded from distances.
    fn advance(&mut self, command: &[u8]) -> Option<Vec<u8>>;

    /// Returns the wall clock at which the latest reply arrived.
    fn wall_clock(&self) -> SystemTime;

    /// Returns the error that ended the script before its end, if any.
    fn failure(&self) -> Option<io::Error>;

    /// Copies the latest value of each step that was ever measured.
    fn measure(&self, values: &mut Values);
}

/// The time at which replies are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PlaybackPace {
    /// At the recorded times.
    AsRecorded,
    /// As soon as they are requested.
    Immediate,
}

/// A script that is played.
pub(super) struct Playback {
    script: Box<dyn Script>,
    pace: PlaybackPace,
    started_at: Option<Instant>,
}

/// The script's answer to a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NextReply {
    /// The command is none of the script's: the device answers it.
    NotScripted,
    /// The script's next reply, not before this time.
    At(Instant),
    /// No reply: the next one is due too far in the future.
    TooEarly,
    /// The script has ended: the sensor is unplugged.
    End,
}

impl Playback {
    pub(super) fn new(script: Box<dyn Script>, pace: PlaybackPace) -> Self {
        Self { script, pace, started_at: None }
    }

    /// Returns the answer to `command` if it is served at `at`.
    pub(super) fn next_reply(&self, command: &HostCommand, at: Instant) -> NextReply {
        match *command {
            HostCommand::Scan { start, end, .. }
                if start < end || self.script.is_single_step(end) => {}
            _ => return NextReply::NotScripted,
        }
        match (self.script.due(), self.started_at) {
            (None, _) => NextReply::End,
            (Some(due), Some(started_at)) if self.pace == PlaybackPace::AsRecorded => {
                let due = started_at + due;
                if due <= at + MAX_HOLD { NextReply::At(due.max(at)) } else { NextReply::TooEarly }
            }
            (Some(_), _) => NextReply::At(at),
        }
    }

    /// Plays the next reply at `at`. Returns its bytes if they cannot be encoded from
    /// distances.
    pub(super) fn advance(&mut self, command: &[u8], at: Instant) -> Option<Vec<u8>> {
        if self.started_at.is_none() {
            self.started_at = at.checked_sub(self.script.due().unwrap_or_default());
        }
        self.script.advance(command)
    }

    pub(super) fn measure(&self, values: &mut Values) {
        self.script.measure(values);
    }

    /// Returns the wall clock at which the latest reply arrived.
    pub(super) fn wall_clock(&self) -> SystemTime {
        self.script.wall_clock()
    }

    /// Returns the result of reading from the sensor after the script's end.
    pub(super) fn end(&self) -> io::Result<()> {
        self.script.failure().map_or(Ok(()), Err)
    }
}
