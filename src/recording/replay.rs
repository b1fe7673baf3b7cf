//! [`Recording::replay`]: a recording as an emulated sensor, which answers each
//! poll with the next recorded reply.

use std::io;
use std::time::{Duration, SystemTime};

use super::record::{Entry, Reply, parse_command};
use super::{Recording, RecordingError};
use crate::Window;
use crate::emulator::{Emulator, PlaybackPace, Script, Values};
use crate::protocol::{Command, Reply as Parsed};

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
    /// with the errors of reading the file up to the first scan.
    pub fn replay(mut self, pace: ReplayPace) -> Result<Emulator, RecordingError> {
        let version = skip_to(&mut self, |command| *command == Command::Version)?;
        let replies = Replies::new(self, version.stamp)?;
        let lines = version.bytes.split(|&byte| byte == b'\n').skip(2);
        let lines = lines.filter(|line| !line.is_empty());
        let pace = match pace {
            ReplayPace::Recorded => PlaybackPace::AsRecorded,
            ReplayPace::Max => PlaybackPace::Immediate,
        };
        Ok(Emulator::builder().version_lines(lines).script(replies, pace).build())
    }
}

/// Returns the first successful reply to a command that is `wanted`.
fn skip_to(
    recording: &mut Recording,
    wanted: impl Fn(&Command) -> bool,
) -> Result<Reply, RecordingError> {
    for record in recording {
        if let Entry::Reply(reply) = record?.entry
            && reply.command.as_ref().is_some_and(&wanted)
            && reply.values().is_some()
        {
            return Ok(reply);
        }
    }
    Err(RecordingError::NoReplies)
}

impl Reply {
    /// Returns the values of a successful reply to `G`, none for other commands,
    /// and `None` if the reply is malformed or refused.
    fn values(&self) -> Option<Vec<u16>> {
        let command = self.command.as_ref()?;
        let reply = Parsed::parse(command, self.bytes.strip_suffix(b"\n\n")?).ok()?;
        let mut values = Vec::new();
        if let Command::Distances(_) = command {
            reply.values_into(&mut values);
        }
        reply.status().is_ok().then_some(values)
    }
}

/// The replies to the polls of one stream, in the order in which they came.
struct Replies {
    recording: Recording,
    /// The window of the stream.
    window: Window,
    next: Option<Due>,
    /// The wall clock when the latest reply came.
    stamp: SystemTime,
    /// When the first of them came.
    began: SystemTime,
    /// The latest value of each step.
    memory: Box<Values>,
    /// The error that ended reading the file.
    failure: Option<RecordingError>,
}

/// A reply and the time it was received.
struct Due {
    at: SystemTime,
    reply: Reply,
}

impl Replies {
    /// Reads up to the first reply to a poll. `stamp` is the wall clock until
    /// then.
    fn new(recording: Recording, stamp: SystemTime) -> Result<Self, RecordingError> {
        let window = recording.window();
        let mut replies = Self {
            recording,
            window: window.unwrap_or(Window::FULL),
            next: None,
            stamp,
            began: SystemTime::UNIX_EPOCH,
            memory: Box::new([UNKNOWN; crate::emulator::STEPS]),
            failure: None,
        };
        replies.next = match window {
            Some(_) => replies.read()?,
            None => replies.read_any()?,
        };
        match &replies.next {
            Some(first) => replies.began = first.at,
            None => return Err(RecordingError::NoReplies),
        }
        Ok(replies)
    }

    /// Reads the first reply to any poll, and takes its window for the stream's.
    fn read_any(&mut self) -> Result<Option<Due>, RecordingError> {
        for record in &mut self.recording {
            let record = record?;
            if let Entry::Reply(reply) = record.entry
                && let Some(Command::Distances(window)) = reply.command
            {
                self.window = window;
                return Ok(Some(Due { at: record.at, reply }));
            }
        }
        Ok(None)
    }

    /// Reads the next reply to the stream's polls. The values of replies to other
    /// polls are remembered.
    fn read(&mut self) -> Result<Option<Due>, RecordingError> {
        while let Some(record) = self.recording.next() {
            let record = record?;
            if let Entry::Reply(reply) = record.entry
                && let Some(Command::Distances(window)) = reply.command
            {
                if self.is_of_stream(window) {
                    return Ok(Some(Due { at: record.at, reply }));
                }
                self.remember(window, &reply);
            }
        }
        Ok(None)
    }

    /// Checks if `window` is the stream's, or that widened by the driver.
    fn is_of_stream(&self, window: Window) -> bool {
        let widened =
            (0..=Window::MAX_EXTRA_POINTS).filter_map(|groups| self.window.widened(groups));
        widened.into_iter().any(|(widened, _)| widened == window)
    }

    /// Stores the values of a reply. Returns false if it has none.
    fn remember(&mut self, window: Window, reply: &Reply) -> bool {
        let Some(values) = reply.values() else { return false };
        let first = usize::from(window.start().number());
        let seen = self.memory.get_mut(first..first + window.steps()).unwrap_or_default();
        // Each step of a group gets the group's value, so that the emulated
        // sensor, which sends the smallest of them, sends that value again.
        let groups = seen.chunks_mut(window.cluster_count().into());
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
        let Due { reply, .. } = self.next.take()?;
        self.stamp = reply.stamp;
        self.next = self.read().unwrap_or_else(|error| {
            tracing::warn!(%error, "the replay ends here");
            self.failure = Some(error);
            None
        });
        let Some(Command::Distances(window)) = reply.command else { return None };
        // The emulated sensor encodes distances for the current poll: the driver's
        // polls differ, so this one need not equal the recorded one.
        if self.remember(window, &reply) {
            return None;
        }
        // A refused or malformed reply is sent as it was, with the echo of the
        // current poll, unless it would parse as distances by chance.
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
