//! [`Recording::replay`]: a recording as an emulated sensor, which answers each
//! poll with the next recorded reply.

use std::io;
use std::time::{Duration, SystemTime};

use super::polls::{PollReply, Polls};
use super::record::{Entry, Reply, parse_command};
use super::{Recording, RecordingError};
use crate::Window;
use crate::emulator::{Emulator, PlaybackPace, Script, Values};
use crate::protocol::Command;

/// Error code 19, "Non-Measurable Distance": the value of a step that the
/// recording does not cover.
const UNKNOWN: u16 = 19;

/// The speed of a replay.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum ReplayPace {
    /// The recorded speed: no reply comes before its time. In a gap of the
    /// recording polls time out.
    #[default]
    Recorded,
    /// As fast as polls come. A stream that must not miss a scan needs a deep
    /// ring ([`ring_depth`](crate::SensorBuilder::ring_depth)).
    Max,
}

impl Recording {
    /// Returns an emulated sensor that answers as the recorded one did: see
    /// [the module](super#replaying).
    ///
    /// # Errors
    ///
    /// Fails with [`RecordingError::NoReplies`] if there is nothing to replay, and
    /// with [`RecordingError::Damaged`] or [`RecordingError::Read`] if that is
    /// because the file cannot be read.
    pub fn replay(mut self, pace: ReplayPace) -> Result<Emulator, RecordingError> {
        let mut failure = None;
        let version = first_version(&mut self, &mut failure)
            .ok_or_else(|| failure.clone().unwrap_or(RecordingError::NoReplies))?;
        let replies = Replies::new(Polls::new(self), version.stamp, failure)?;
        let lines = version.bytes.split(|&byte| byte == b'\n').skip(2);
        let lines = lines.filter(|line| !line.is_empty());
        let pace = match pace {
            ReplayPace::Recorded => PlaybackPace::AsRecorded,
            ReplayPace::Max => PlaybackPace::Immediate,
        };
        Ok(Emulator::builder().version_lines(lines).script(replies, pace).build())
    }
}

/// Reads the first successful reply to `V`.
fn first_version(recording: &mut Recording, failure: &mut Option<RecordingError>) -> Option<Reply> {
    recording.find_map(|record| match keep_error(record, failure)?.entry {
        Entry::Reply(reply) => {
            let is_version = reply.command == Some(Command::Version) && reply.parse().is_some();
            is_version.then_some(reply)
        }
        _ => None,
    })
}

/// Logs an error, and keeps the first one: the replay goes on with what can be
/// read, and reports it at its end.
fn keep_error<T>(
    item: Result<T, RecordingError>,
    failure: &mut Option<RecordingError>,
) -> Option<T> {
    item.inspect_err(|error| {
        tracing::warn!(%error, "the replay leaves out a part of the recording");
        failure.get_or_insert_with(|| error.clone());
    })
    .ok()
}

/// The replies to the polls of one stream, in the order in which they came.
struct Replies {
    polls: Polls,
    /// The window of the stream.
    window: Window,
    next: Option<PollReply>,
    /// The wall clock when the latest reply came.
    stamp: SystemTime,
    /// The log time of the first of them.
    began: SystemTime,
    /// The latest value of each step.
    memory: Box<Values>,
    /// The first error of reading the file.
    failure: Option<RecordingError>,
}

impl Replies {
    /// Reads up to the first reply to a poll. `stamp` is the wall clock until
    /// then.
    fn new(
        polls: Polls,
        stamp: SystemTime,
        failure: Option<RecordingError>,
    ) -> Result<Self, RecordingError> {
        let mut replies = Self {
            polls,
            window: Window::FULL,
            next: None,
            stamp,
            began: SystemTime::UNIX_EPOCH,
            memory: Box::new([UNKNOWN; crate::emulator::STEPS]),
            failure,
        };
        replies.read();
        let (Some(first), Some(window)) = (&replies.next, replies.polls.window()) else {
            return Err(replies.failure.unwrap_or(RecordingError::NoReplies));
        };
        (replies.began, replies.window) = (first.at, window);
        Ok(replies)
    }

    /// Reads the next reply to the stream's polls. The values of replies to other
    /// polls are remembered.
    fn read(&mut self) {
        self.next = None;
        while let Some(item) = self.polls.next() {
            let Some(poll) = keep_error(item, &mut self.failure) else { continue };
            if self.polls.is_of_stream(poll.asked) {
                self.next = Some(poll);
                return;
            }
            self.remember(&poll);
        }
    }

    /// Stores the values of a reply. Returns false if it has none.
    fn remember(&mut self, poll: &PollReply) -> bool {
        let Some(values) = poll.reply.values() else { return false };
        let first = usize::from(poll.asked.start().number());
        let seen = self.memory.get_mut(first..first + poll.asked.steps()).unwrap_or_default();
        // Each step of a group gets the group's value, so that the emulated
        // sensor, which sends the smallest of them, sends that value again.
        let groups = seen.chunks_mut(poll.asked.cluster_count().into());
        groups.zip(values).for_each(|(group, value)| group.fill(value));
        true
    }
}

impl Script for Replies {
    fn due(&self) -> Option<Duration> {
        let next = self.next.as_ref()?;
        Some(next.at.duration_since(self.began).unwrap_or_default())
    }

    fn is_single_step(&self, step: u16) -> bool {
        self.window.steps() == 1 && self.window.end().number() == step
    }

    fn advance(&mut self, asked: &[u8]) -> Option<Vec<u8>> {
        let poll = self.next.take()?;
        self.stamp = poll.reply.stamp;
        self.read();
        // The emulated sensor encodes distances for the current poll: the driver's
        // polls differ, so this one need not equal the recorded one.
        if self.remember(&poll) {
            return None;
        }
        // A refused or malformed reply is sent as it was, with the echo of the
        // current poll, unless it would parse as distances by chance.
        let PollReply { asked: window, reply, .. } = poll;
        let echo = Command::Distances(window).bytes();
        let rest = reply.bytes.strip_prefix(&*echo);
        let command = std::str::from_utf8(asked).ok().and_then(parse_command);
        let answer = rest.map(|rest| Reply { command, bytes: [asked, rest].concat(), ..reply });
        Some(match answer {
            Some(answer) if answer.values().is_none() => answer.bytes,
            _ => reply.bytes,
        })
    }

    fn wall_clock(&self) -> SystemTime {
        self.stamp
    }

    fn failure(&self) -> Option<io::Error> {
        let error = self.failure.clone()?;
        Some(io::Error::new(io::ErrorKind::InvalidData, error))
    }

    fn measure(&self, values: &mut Values) {
        *values = *self.memory;
    }
}
