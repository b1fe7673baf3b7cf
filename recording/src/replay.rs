//! [`Recording::replay`]: a recording as an emulated sensor, which answers each
//! poll with the next recorded reply.

use std::io;
use std::time::{Duration, SystemTime};

use super::polls::{Answer, PollReply, Polls};
use super::record::{RecordedReply, parse_command};
use super::{Recording, RecordingError};
use tokio_scip::Window;
use tokio_scip::protocol::Command;
use urg_emulator::{Emulator, ReplayPace, Script, Values};

/// Error code 19, "Non-Measurable Distance": value of a step outside the recording.
const UNKNOWN: u32 = 19;

impl Recording {
    /// Creates an emulated sensor that answers as the recorded one did: see [the
    /// module](super#replaying).
    ///
    /// # Errors
    ///
    /// Fails with [`RecordingError::NoScans`] if there is nothing to replay. If the
    /// cause is an unreadable file, fails with [`RecordingError::Damaged`] or
    /// [`RecordingError::Read`].
    pub fn replay(self, pace: ReplayPace) -> Result<Emulator, RecordingError> {
        let replies = Replies::new(Polls::new(self))?;
        let version = replies.polls.version_frame();
        let lines = version.split(|&byte| byte == b'\n').skip(2).map(<[u8]>::to_vec);
        let lines: Vec<_> = lines.filter(|line| !line.is_empty()).collect();
        Ok(Emulator::builder().version_lines(lines).script(replies, pace).build())
    }
}

/// Logs an error, and keeps the first one. The replay continues with what it can read,
/// and reports the error at its end.
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

/// Replies to the polls of one stream, in the order of their arrival.
struct Replies {
    polls: Polls,
    /// Window of the stream.
    window: Window,
    next: Option<PollReply>,
    /// Wall clock when the latest reply arrived.
    stamp: SystemTime,
    /// Log time of the first reply.
    began: SystemTime,
    /// Latest value of each step.
    memory: Vec<u32>,
    /// First error of reading the file.
    failure: Option<RecordingError>,
}

impl Replies {
    /// Reads up to the first reply to a poll.
    fn new(polls: Polls) -> Result<Self, RecordingError> {
        let mut replies = Self {
            polls,
            window: Window::FULL,
            next: None,
            stamp: SystemTime::UNIX_EPOCH,
            began: SystemTime::UNIX_EPOCH,
            memory: vec![UNKNOWN; urg_emulator::STEPS],
            failure: None,
        };
        replies.read();
        let Some(first) = &replies.next else {
            return Err(replies.failure.unwrap_or_else(|| replies.polls.recording.no_scans()));
        };
        let version = replies.polls.version.as_ref();
        replies.stamp = version.map_or(first.stamp, |version| version.stamp);
        replies.began = first.at;
        Ok(replies)
    }

    /// Reads the next reply to the stream's polls. Remembers the values of replies to
    /// other polls.
    fn read(&mut self) {
        self.next = None;
        while let Some(item) = self.polls.next() {
            let Some(poll) = keep_error(item, &mut self.failure) else { continue };
            let Some(window) = poll.window else {
                self.remember(&poll);
                continue;
            };
            // Another stream begins, which says nothing about the steps of the one before.
            if std::mem::replace(&mut self.window, window) != window {
                self.memory.fill(UNKNOWN);
            }
            self.next = Some(poll);
            return;
        }
    }

    /// Stores the values of a reply. Returns false if it has no values.
    fn remember(&mut self, poll: &PollReply) -> bool {
        let Some(values) = poll.answer.values() else { return false };
        let first = usize::from(poll.asked.start());
        let seen = self.memory.get_mut(first..first + poll.asked.steps()).unwrap_or_default();
        // Each step of a group gets the group's value. The emulated sensor sends the
        // smallest value of a group, so it sends that value again.
        let groups = seen.chunks_mut(poll.asked.cluster_count().into());
        groups.zip(values).for_each(|(group, value)| group.fill(value));
        true
    }
}

impl Script for Replies {
    /// Not earlier: a pipe may not have the next reply yet when the one before it is sent.
    fn prepare(&mut self) {
        if self.next.is_none() {
            self.read();
        }
    }

    fn due(&self) -> Option<Duration> {
        let next = self.next.as_ref()?;
        Some(next.at.duration_since(self.began).unwrap_or_default())
    }

    fn is_single_step(&self, step: u16) -> bool {
        self.window.steps() == 1 && self.window.end() == step
    }

    fn advance(&mut self, asked: &[u8]) -> Option<Vec<u8>> {
        let poll = self.next.take()?;
        self.stamp = poll.stamp;
        // The emulated sensor encodes the distances for the current poll, which may be
        // widened differently from the recorded one.
        if self.remember(&poll) {
            return None;
        }
        // A refused or malformed reply is sent unchanged, with the echo of the current
        // poll, unless it would parse as distances by chance.
        let PollReply { asked: window, answer: Answer::Reply(reply), .. } = poll else {
            return None;
        };
        let echo = Command::Distances(window).bytes();
        let rest = reply.bytes.strip_prefix(&*echo);
        let command = std::str::from_utf8(asked).ok().and_then(parse_command);
        let answer =
            rest.map(|rest| RecordedReply { command, bytes: [asked, rest].concat(), ..reply });
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
        values.iter_mut().zip(&self.memory).for_each(|(slot, value)| *slot = *value);
    }
}
