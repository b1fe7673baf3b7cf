//! [`Polls`]: the recorded replies to polls, and the `/scan` messages whose reply was not recorded. A
//! replay sends them and [`Recording::scans`] decodes them, so both have the same scans.

use std::collections::VecDeque;
use std::time::{Duration, SystemTime};

use super::event::Event;
use super::from_ros::MessageScan;
use super::identity::{parse_version, version_frame};
use super::reader::Item;
use super::record::{Entry, Record, RecordedReply};
use super::{Recording, RecordingError};
use tokio_scip::protocol::{Command, Reply};
use tokio_scip::{Version, Window};

/// Number of polls to search for the window of a stream that is not described. They stay in memory,
/// so the search also ends after this many bytes of replies.
const WINDOW_SEARCH_POLLS: usize = 256;
const WINDOW_SEARCH_BYTES: usize = 1 << 20;
/// Number of replies whose scans may still follow, from a consumer that is behind.
const MAX_STAMPS: usize = 1 << 16;

/// Answer to a poll.
#[derive(Debug)]
pub(super) struct PollReply {
    /// Log time of its receipt.
    pub(super) at: SystemTime,
    /// Requested window.
    pub(super) asked: Window,
    /// Window of the recorded stream, if this is a poll of it.
    pub(super) window: Option<Window>,
    /// Wall clock when the first byte arrived.
    pub(super) stamp: SystemTime,
    /// Time of one revolution, if the answer has it.
    pub(super) scan_time: Option<Duration>,
    pub(super) answer: Answer,
}

/// What a recording has of an answer.
#[derive(Debug)]
pub(super) enum Answer {
    Reply(RecordedReply),
    /// Values of a `/scan` message.
    Values(Vec<u32>),
}

impl Answer {
    /// Values of a successful answer.
    pub(super) fn values(&self) -> Option<Vec<u32>> {
        match self {
            Self::Reply(reply) => reply.values(),
            Self::Values(values) => Some(values.clone()),
        }
    }
}

impl PollReply {
    /// Values of the stream's window, if this is a scan of it.
    pub(super) fn stream_values(&self) -> Option<(Window, Vec<u32>)> {
        let window = self.window?;
        let mut values = self.answer.values()?;
        // The driver may have asked for extra points before or after the window.
        let surplus = window.start().number().saturating_sub(self.asked.start().number());
        values.drain(..usize::from(surplus / u16::from(window.cluster_count())).min(values.len()));
        values.truncate(window.points());
        (values.len() == window.points()).then_some((window, values))
    }
}

/// Finds the polls among the records of a file, and the stream that they belong to.
#[derive(Debug, Default)]
pub(super) struct StreamPolls {
    /// Window of the stream: from the latest metadata, or else from the first polls.
    window: Option<Window>,
    /// Stamps of the latest replies to polls.
    stamps: VecDeque<SystemTime>,
    /// Polls that wait to be returned, and the bytes of their replies.
    waiting: VecDeque<PollReply>,
    waiting_bytes: usize,
}

impl StreamPolls {
    /// The records that follow belong to a stream of this window.
    pub(super) fn describe(&mut self, window: Option<Window>) {
        self.window = window.or(self.window);
    }

    /// Takes the next record of the file.
    pub(super) fn add(&mut self, record: Record) {
        let Record { at, stamp, .. } = record;
        let poll =
            |asked, answer| PollReply { at, asked, window: None, stamp, scan_time: None, answer };
        let poll = match record.entry {
            Entry::Reply(reply) => {
                let Some(Command::Distances(asked)) = reply.command else { return };
                if self.stamps.len() >= MAX_STAMPS {
                    self.stamps.pop_front();
                }
                self.stamps.push_back(stamp);
                self.waiting_bytes += reply.bytes.len();
                poll(asked, Answer::Reply(reply))
            }
            // The driver delivers the stamp of the reply.
            Entry::Scan(_) if self.stamps.iter().rev().any(|known| *known == stamp) => return,
            Entry::Scan(message) => {
                let Some(scan) = MessageScan::from_message(&message, self.window) else { return };
                let MessageScan { window, values, stamp, scan_time } = scan;
                PollReply { stamp, scan_time, ..poll(window, Answer::Values(values)) }
            }
            Entry::Event(_) => return,
        };
        self.waiting.push_back(poll);
    }

    /// Returns the next poll, once the window of the stream is known, or `is_end` is true because no
    /// record follows.
    pub(super) fn next(&mut self, is_end: bool) -> Option<PollReply> {
        if self.window.is_none() {
            let is_enough = self.waiting.len() >= WINDOW_SEARCH_POLLS
                || self.waiting_bytes >= WINDOW_SEARCH_BYTES;
            if !is_end && !is_enough {
                return None;
            }
            self.find_window();
        }
        let mut poll = self.waiting.pop_front()?;
        poll.window = self.window.filter(|window| window.is_polled_as(poll.asked));
        Some(poll)
    }

    /// Finds the window of the stream to which the first poll belongs. The first polls may be
    /// widened ones, because a part of a recording begins anywhere. The driver does not widen one of
    /// four.
    fn find_window(&mut self) {
        let mut asked = self.waiting.iter().map(|poll| poll.asked);
        let Some(first) = asked.next() else { return };
        let narrower = asked.filter(|asked| asked.is_polled_as(first));
        self.window = narrower.chain([first]).min_by_key(Window::steps);
    }
}

/// Polls of a recording, in the order of the file.
pub(super) struct Polls {
    pub(super) recording: Recording,
    stream: StreamPolls,
    /// First successful reply to `V`.
    pub(super) version: Option<RecordedReply>,
    /// Time of one revolution, from the sensor's latest reply to `V`, or else from the metadata.
    pub(super) revolution: Option<Duration>,
    /// Number of polls without a scan, by the recorded events.
    pub(super) failed_polls: u64,
    is_over: bool,
}

impl Polls {
    pub(super) fn new(recording: Recording) -> Self {
        let version = parse_version(&version_frame(recording.metadata()));
        let revolution = version.as_ref().and_then(revolution);
        let (stream, version) = (StreamPolls::default(), None);
        Self { recording, stream, version, revolution, failed_polls: 0, is_over: false }
    }

    /// Reply to `V` without its terminator: the first one that was read, or else what the metadata
    /// have of it.
    pub(super) fn version_frame(&self) -> Vec<u8> {
        let frame = self.version.as_ref().and_then(|reply| reply.bytes.strip_suffix(b"\n\n"));
        frame.map_or_else(|| version_frame(self.recording.metadata()), <[u8]>::to_vec)
    }

    fn add(&mut self, record: Record) {
        self.failed_polls += u64::from(matches!(record.entry, Entry::Event(Event::Error { .. })));
        if let Entry::Reply(reply) = &record.entry
            && reply.command == Some(Command::Version)
        {
            let version = reply.parse().map(|reply| Version::from_reply(&reply));
            self.revolution = version.as_ref().and_then(revolution).or(self.revolution);
            if version.is_some() && self.version.is_none() {
                self.version = Some(reply.clone());
            }
        }
        self.stream.add(record);
    }
}

impl Iterator for Polls {
    type Item = Result<PollReply, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(poll) = self.stream.next(self.is_over) {
                return Some(Ok(poll));
            }
            match self.recording.next_item() {
                Some(Ok(Item::Record(record))) => self.add(record),
                Some(Ok(Item::Description(window))) => self.stream.describe(window),
                Some(Err(error)) => return Some(Err(error)),
                None if self.is_over => return None,
                None => self.is_over = true,
            }
        }
    }
}

/// Nominal time of one revolution.
fn revolution(version: &Version) -> Option<Duration> {
    let rpm = version.specification.as_ref()?.motor_speed?;
    Some(Duration::from_secs(60) / u32::from(rpm.max(1)))
}

impl RecordedReply {
    /// Parses a successful reply to its command.
    pub(super) fn parse(&self) -> Option<Reply> {
        let frame = self.bytes.strip_suffix(b"\n\n")?;
        let reply = Reply::parse(self.command.as_ref()?, frame).ok()?;
        reply.status().is_ok().then_some(reply)
    }

    /// Values of a successful reply to `G`.
    pub(super) fn values(&self) -> Option<Vec<u32>> {
        let Some(Command::Distances(_)) = self.command else { return None };
        Some(self.parse()?.values().to_vec())
    }
}
