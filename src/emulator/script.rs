//! Replies to `G` that are known in advance, such as those of a recording, in
//! the place of a world.

use std::io;
use std::time::{Duration, SystemTime};

use tokio::time::Instant;

use super::request::Request;
use super::world::Values;

/// For this long the sensor holds a reply that is not due yet; a `G` that comes
/// still earlier gets none. It is less than a driver waits.
const PATIENCE: Duration = Duration::from_millis(400);

/// Where the replies come from.
pub(crate) trait Script: Send {
    /// When the next reply is due, counted from the first one; `None` after the
    /// last.
    fn due(&self) -> Option<Duration>;

    /// Whether a `G` for a single step, `step`, asks for the next reply, and is
    /// no fence.
    fn is_single_step(&self, step: u16) -> bool;

    /// Goes on to the next reply. Gives its bytes where they cannot be made of
    /// the distances, as an answer to `asked`.
    fn advance(&mut self, asked: &[u8]) -> Option<Vec<u8>>;

    /// The wall clock when the latest reply came.
    fn wall_clock(&self) -> SystemTime;

    /// Why there are no more replies, where that is not their end.
    fn failure(&self) -> Option<io::Error>;

    /// The latest distances, at every step that was ever seen.
    fn look(&self, codes: &mut Values);
}

/// A script that is played.
pub(super) struct Performance {
    script: Box<dyn Script>,
    /// Whether replies come when they are due, or as fast as they are asked for.
    paced: bool,
    began: Option<Instant>,
}

/// What a script has for a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Cue {
    /// Nothing: it is served as ever.
    None,
    /// The next reply, not before this.
    Reply(Instant),
    /// No reply.
    Silence,
    /// It is over: the sensor is unplugged.
    End,
}

impl Performance {
    pub(super) fn new(script: Box<dyn Script>, paced: bool) -> Self {
        Self { script, paced, began: None }
    }

    /// What it has for `request` if that is served at `at`.
    pub(super) fn cue(&self, request: &Request, at: Instant) -> Cue {
        match *request {
            Request::Scan { start, end, .. } if start < end || self.script.is_single_step(end) => {}
            _ => return Cue::None,
        }
        match (self.script.due(), self.began) {
            (None, _) => Cue::End,
            (Some(due), Some(began)) if self.paced => {
                let due = began + due;
                if due <= at + PATIENCE { Cue::Reply(due.max(at)) } else { Cue::Silence }
            }
            (Some(_), _) => Cue::Reply(at),
        }
    }

    /// Plays the next reply, at `at`.
    pub(super) fn advance(&mut self, asked: &[u8], at: Instant) -> Option<Vec<u8>> {
        if self.began.is_none() {
            self.began = at.checked_sub(self.script.due().unwrap_or_default());
        }
        self.script.advance(asked)
    }

    pub(super) fn look(&self, codes: &mut Values) {
        self.script.look(codes);
    }

    /// The wall clock when the latest reply came.
    pub(super) fn wall_clock(&self) -> SystemTime {
        self.script.wall_clock()
    }

    /// How reading from a sensor ends that is unplugged because it is over.
    pub(super) fn end(&self) -> io::Result<()> {
        self.script.failure().map_or(Ok(()), Err)
    }
}
