//! A recording as an emulated sensor: the replies in it, one for each poll.

use std::io;
use std::time::{Duration, SystemTime};

use super::reader::{Entry, Reply, command_named};
use super::{Recording, RecordingError};
use crate::Window;
use crate::emulator::{Emulator, Script, Values};
use crate::protocol::{Command, Reply as Parsed};

/// By how many groups a driver widens a window so that polls differ.
const WIDENED: u16 = 3;
/// Error code 19, "Non-Measurable Distance": what was never measured.
const UNKNOWN: u16 = 19;

/// How fast a recording is replayed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum ReplayPace {
    /// As it was recorded: no reply comes before its time. In a gap of the
    /// recording polls time out.
    #[default]
    Recorded,
    /// As fast as replies are asked for. A stream that is to see every scan wants
    /// a deep ring ([`ring_depth`](crate::SensorBuilder::ring_depth)).
    Max,
}

/// An emulated sensor that plays what was recorded.
pub(super) fn emulator(
    mut recording: Recording,
    pace: ReplayPace,
) -> Result<Emulator, RecordingError> {
    let version = skip_to(&mut recording, |command| *command == Command::Version)?;
    let replies = Replies::new(recording, version.stamp)?;
    let lines = version.bytes.split(|&byte| byte == b'\n').skip(2).filter(|line| !line.is_empty());
    let paced = pace == ReplayPace::Recorded;
    Ok(Emulator::builder().version_lines(lines).script(replies, paced).build())
}

/// The first reply to such a command that was a success.
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
    /// The values of a success, none unless they are distances.
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
    /// What the stream asked for.
    window: Window,
    next: Option<Due>,
    /// The wall clock when the latest reply came.
    stamp: SystemTime,
    /// When the first of them came.
    began: SystemTime,
    /// The latest value of each step.
    memory: Box<Values>,
    /// Why the file could not be read any further.
    failure: Option<RecordingError>,
}

/// A reply, and when it came.
struct Due {
    at: SystemTime,
    reply: Reply,
}

impl Replies {
    /// `stamp` is when the sensor said something before.
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

    /// The first reply to any poll tells what was asked for.
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

    /// The next reply to the stream's polls. What others asked for is seen in
    /// passing.
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

    /// Whether `window` is the stream's, or that with some groups more.
    fn is_of_stream(&self, window: Window) -> bool {
        let widened = (0..=WIDENED).filter_map(|groups| self.window.widened(groups));
        widened.into_iter().any(|(widened, _)| widened == window)
    }

    /// Takes in what a reply says. False if it says no distances.
    fn remember(&mut self, window: Window, reply: &Reply) -> bool {
        let Some(values) = reply.values() else { return false };
        let first = usize::from(window.start().number());
        let seen = self.memory.get_mut(first..first + window.steps()).unwrap_or_default();
        // Each step of a group has the group's value, so that the smallest of
        // them is that value again.
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
        // Distances are sent as an answer to what is asked now: the driver's
        // polls differ from each other, and it need not ask what was asked then.
        if self.remember(window, &reply) {
            return None;
        }
        // What was refused or damaged is so again, and never distances by chance.
        let echo = Command::Distances(window).bytes();
        let rest = reply.bytes.strip_prefix(&*echo);
        let command = std::str::from_utf8(asked).ok().and_then(command_named);
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

    fn look(&self, codes: &mut Values) {
        *codes = *self.memory;
    }
}
