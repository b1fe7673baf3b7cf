//! [`Recording::replay`]: a recording as an emulated sensor, which answers each
//! poll with the next recorded reply.

use std::io;
use std::time::{Duration, SystemTime};

use super::left_out::LeftOutReason;
use super::polls::{Answer, PollReply, Polls};
use super::reply::{RecordedReply, Values};
use super::stream::Model;
use super::{Recording, RecordingError};
use tokio_scip::Window;
use tokio_scip::protocol::scip2::Stamp;
use urg_emulator::{Emulator, Model as EmulatedModel, ReplayPace, Script};

impl Recording {
    /// Creates an emulated sensor that answers as the recorded one did: see [the module](super#replaying).
    ///
    /// # Errors
    ///
    /// Fails with [`RecordingError::NoScans`] if there is nothing to replay. If the cause is an unreadable
    /// file, fails with [`RecordingError::Damaged`] or [`RecordingError::Read`].
    pub fn replay(self, pace: ReplayPace) -> Result<Emulator, RecordingError> {
        let replies = Replies::new(Polls::new(self))?;
        let mut lines = replies.polls.version_lines();
        if replies.model.0.is_some() {
            // In SCIP 2 a driver takes no empty text.
            let empty = lines.iter_mut().filter(|line| line.ends_with(b":"));
            empty.for_each(|line| line.extend(b"unknown"));
        }
        let builder = Emulator::builder().version_lines(lines);
        let builder = match replies.model.0.as_deref() {
            // Any model of SCIP 2 on USB, but one that asking for intensities would lock.
            Some(told) => builder.model(EmulatedModel::Utm30lx).parameters(told.clone()),
            None => builder,
        };
        Ok(builder.script(replies, pace).build())
    }
}

/// Replies to the polls of one stream, in the order of their arrival.
struct Replies {
    polls: Polls,
    /// Sensor that is replayed, the first one of the recording.
    model: Model,
    /// Window of its stream, once it has one.
    window: Option<Window>,
    next: Option<PollReply>,
    /// Wall clock when the latest reply arrived.
    stamp: SystemTime,
    /// Log time of the first reply.
    began: SystemTime,
    /// Latest distance and intensity of each step.
    memory: [Vec<u32>; 2],
    /// Sensor's clock at the latest scan, in SCIP 2.
    clock: Duration,
    /// First error of reading the file. The replay continues with what it can read, and ends with it.
    failure: Option<RecordingError>,
}

impl Replies {
    /// Reads up to the first reply to a poll.
    fn new(polls: Polls) -> Result<Self, RecordingError> {
        let mut replies = Self {
            polls,
            model: Model::default(),
            window: None,
            next: None,
            stamp: SystemTime::UNIX_EPOCH,
            began: SystemTime::UNIX_EPOCH,
            memory: Default::default(),
            clock: Duration::ZERO,
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

    /// Reads the next reply to the stream's polls. Remembers the values of replies to other polls.
    fn read(&mut self) {
        while let Some(item) = self.polls.next() {
            let poll = match item {
                Ok(poll) => poll,
                Err(error) => {
                    tracing::warn!(%error, "the replay leaves out a part of the recording");
                    self.failure.get_or_insert(error);
                    continue;
                }
            };
            let Some(window) = poll.window else {
                if poll.asked.model.is_like(&self.model) {
                    self.remember(&poll);
                }
                continue;
            };
            if self.window.is_none() {
                self.model = poll.asked.model.clone();
            } else if !poll.asked.model.is_like(&self.model) {
                self.polls.recording.left_out.add(LeftOutReason::OtherLaser, window);
                continue;
            }
            // Another stream begins, which says nothing about the steps of the one before.
            if self.window.replace(window) != Some(window) {
                let geometry = self.model.geometry();
                let steps = usize::from(*geometry.answered_steps().end()) + 1;
                self.memory = [vec![geometry.unknown_value(); steps], vec![0; steps]];
            }
            self.next = Some(poll);
            return;
        }
    }

    /// Stores the values of a reply. Returns false if it has no values.
    fn remember(&mut self, poll: &PollReply) -> bool {
        let Some(values) = poll.answer.values() else { return false };
        let first = usize::from(poll.asked.window.start());
        let Values { distances, intensities, clock } = values;
        for (memory, values) in self.memory.iter_mut().zip([distances, intensities]) {
            let seen = memory.get_mut(first..first + poll.asked.window.steps()).unwrap_or_default();
            // Each step of a group gets the group's value. The emulated sensor sends the
            // smallest value of a group, so it sends that value again.
            let groups = seen.chunks_mut(poll.asked.window.cluster_count().into());
            groups.zip(values).for_each(|(group, value)| group.fill(value));
        }
        let since = poll.at.duration_since(self.began).unwrap_or_default();
        self.clock = clock.map_or(since, Stamp::since_zero);
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
        self.window.is_some_and(|window| window.steps() == 1 && window.end() == step)
    }

    fn advance(&mut self, asked: &[u8]) -> Option<Vec<u8>> {
        let poll = self.next.take()?;
        self.stamp = poll.stamp;
        let has_values = self.remember(&poll);
        let Answer::Reply(reply) = poll.answer else { return None };
        // The same reply to the current poll, which has another label, or is widened differently.
        let answer = reply.to(asked);
        let asked_again = |answer: &RecordedReply| match answer.values() {
            Some(_) => has_values && answer.window(Some(&self.model)) == Some(poll.asked.window),
            None => !has_values,
        };
        let answer = answer.filter(asked_again);
        match (answer, has_values) {
            (Some(answer), _) => Some(answer.bytes),
            // The emulated sensor encodes the distances for the current poll.
            (None, true) => None,
            // It would parse as distances by chance.
            (None, false) => Some(reply.bytes),
        }
    }

    fn wall_clock(&self) -> SystemTime {
        self.stamp
    }

    fn failure(&self) -> Option<io::Error> {
        let error = self.failure.clone()?;
        Some(io::Error::new(io::ErrorKind::InvalidData, error))
    }

    fn measure(&self, distances: &mut [u32], intensities: &mut [u32]) {
        for (slots, memory) in [distances, intensities].into_iter().zip(&self.memory) {
            slots.iter_mut().zip(memory).for_each(|(slot, value)| *slot = *value);
        }
    }

    fn clock(&self) -> Option<u64> {
        u64::try_from(self.clock.as_micros()).ok()
    }
}
