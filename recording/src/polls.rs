//! [`Polls`]: the recorded replies to polls, and the `/scan` messages whose reply was not recorded. A
//! replay sends them and [`Recording::scans`] decodes them, so both have the same scans.

use std::collections::{BTreeSet, VecDeque};
use std::fmt;
use std::time::{Duration, SystemTime};

use super::event::Event;
use super::from_ros::MessageScan;
use super::identity::{parse_version, version_frame};
use super::left_out::{LeftOutCounter, LeftOutReason};
use super::reader::Item;
use super::record::{Entry, Record, RecordedReply};
use super::{Recording, RecordingError};
use crate::ros::LaserScan;
use tokio_scip::protocol::{Command, Reply};
use tokio_scip::{Version, Window};

/// Number of polls to search for the window of a stream that is not described. They stay in memory,
/// so the search also ends after this many bytes of replies.
const WINDOW_SEARCH_POLLS: usize = 256;
const WINDOW_SEARCH_BYTES: usize = 1 << 20;
/// Number of replies whose scans may still follow, from a consumer that is behind.
const MAX_STAMPS: usize = 1 << 16;
/// Number of descriptions whose streams may still begin.
const MAX_STREAMS: usize = 16;
/// Number of sources to name.
const MAX_SOURCES: usize = 16;

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
    /// A `/scan` message made of a reply that was recorded.
    Repeated,
}

impl Answer {
    /// Values of a successful answer.
    pub(super) fn values(&self) -> Option<Vec<u32>> {
        match self {
            Self::Reply(reply) => reply.values(),
            Self::Values(values) => Some(values.clone()),
            Self::Repeated => None,
        }
    }
}

impl PollReply {
    /// Values of the stream's window, if this is a scan of it.
    pub(super) fn stream_values(&self) -> Option<(Window, Vec<u32>)> {
        let window = self.window?;
        let mut values = self.answer.values()?;
        // The driver may have asked for extra points before or after the window.
        let surplus = window.start().saturating_sub(self.asked.start());
        values.drain(..usize::from(surplus / u16::from(window.cluster_count())).min(values.len()));
        values.truncate(window.points());
        (values.len() == window.points()).then_some((window, values))
    }
}

/// Finds the polls among the records of a file, and the stream that they belong to.
#[derive(Debug, Default)]
pub(super) struct StreamPolls {
    /// Windows of the current stream and of those that were described since and have not begun: a
    /// stream begins with its first poll. Without a description, from the first polls.
    streams: VecDeque<Window>,
    is_described: bool,
    /// Frames of the scans.
    pub(super) frame_ids: BTreeSet<String>,
    left_out: LeftOutCounter,
    /// Stamps and windows of the latest replies to polls.
    stamps: VecDeque<(SystemTime, Window)>,
    /// Polls that wait to be returned, and the bytes of their replies.
    waiting: VecDeque<PollReply>,
    waiting_bytes: usize,
}

impl StreamPolls {
    fn new(left_out: LeftOutCounter) -> Self {
        Self { left_out, ..Self::default() }
    }

    /// The records that follow belong to a stream of this window, once one of its polls follows.
    pub(super) fn describe(&mut self, window: Option<Window>) {
        let Some(window) = window else { return };
        self.is_described = true;
        self.streams.retain(|known| *known != window);
        if self.streams.len() == MAX_STREAMS {
            self.streams.pop_front();
        }
        self.streams.push_back(window);
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
                self.stamps.push_back((stamp, asked));
                self.waiting_bytes += reply.bytes.len();
                poll(asked, Answer::Reply(reply))
            }
            Entry::Scan(message) => {
                if self.frame_ids.len() < MAX_SOURCES && !self.frame_ids.contains(&message.frame_id)
                {
                    self.frame_ids.insert(message.frame_id.clone());
                }
                // The driver delivers the stamp of the reply.
                let reply = self.stamps.iter().rev().find(|(known, _)| *known == stamp);
                if let Some((_, asked)) = reply {
                    poll(*asked, Answer::Repeated)
                } else {
                    let known = self.streams.iter().rev().copied();
                    let Some(scan) = MessageScan::from_message(&message, known) else {
                        self.left_out.add(LeftOutReason::OtherLaser, Directions(&message));
                        return;
                    };
                    let MessageScan { window, values, stamp, scan_time } = scan;
                    PollReply { stamp, scan_time, ..poll(window, Answer::Values(values)) }
                }
            }
            Entry::Event(_) => return,
        };
        self.waiting.push_back(poll);
    }

    /// Returns the next poll, once the window of the stream is known, or `is_end` is true because no
    /// record follows.
    pub(super) fn next(&mut self, is_end: bool) -> Option<PollReply> {
        if self.streams.is_empty() {
            let is_enough = self.waiting.len() >= WINDOW_SEARCH_POLLS
                || self.waiting_bytes >= WINDOW_SEARCH_BYTES;
            if !is_end && !is_enough {
                return None;
            }
            self.find_window();
        }
        loop {
            let mut poll = self.waiting.pop_front()?;
            poll.window = self.stream_of(&poll);
            let reason = match poll.answer {
                _ if poll.window.is_some() => None,
                Answer::Reply(_) => Some(LeftOutReason::OtherRequest),
                _ => Some(LeftOutReason::OtherWindow),
            };
            if let Some(reason) = reason {
                self.left_out.add(reason, poll.asked);
            }
            if !matches!(poll.answer, Answer::Repeated) {
                return Some(poll);
            }
        }
    }

    /// Returns the window of the stream that a poll belongs to. The latest description counts.
    fn stream_of(&mut self, poll: &PollReply) -> Option<Window> {
        let is_message = matches!(poll.answer, Answer::Values(_));
        let is_poll_of = |window: &Window| match is_message {
            true => is_same_but_for_end(window, poll.asked),
            false => window.is_polled_as(poll.asked),
        };
        match self.streams.iter().rposition(is_poll_of) {
            Some(place) => {
                self.streams.drain(..place);
                self.streams.front().copied()
            }
            // Of messages alone all belong together.
            None => Some(poll.asked).filter(|_| is_message && !self.is_described),
        }
    }

    /// Finds the window of the stream to which the first poll belongs. The first polls may be
    /// widened ones, because a part of a recording begins anywhere. The driver does not widen one of
    /// four.
    fn find_window(&mut self) {
        let mut asked = self.waiting.iter().map(|poll| poll.asked);
        let Some(first) = asked.next() else { return };
        let narrower = asked.filter(|asked| asked.is_polled_as(first));
        self.streams.extend(narrower.chain([first]).min_by_key(Window::steps));
    }
}

/// Returns true if both have the same points. A message does not tell how many steps its last one
/// has.
fn is_same_but_for_end(window: &Window, other: Window) -> bool {
    let points = |window: &Window| (window.start(), window.cluster_count(), window.points());
    points(window) == points(&other)
}

/// Directions of a message, in words.
struct Directions<'a>(&'a LaserScan);

impl fmt::Display for Directions<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let LaserScan { angle_min, angle_max, angle_increment, ranges, .. } = self.0;
        let [from, to, by] =
            [angle_min, angle_max, angle_increment].map(|angle| angle.to_degrees());
        write!(f, "{} points from {from:.2}° to {to:.2}° every {by:.3}°", ranges.len())
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
    pub(super) serial_numbers: BTreeSet<String>,
    is_over: bool,
}

impl Polls {
    pub(super) fn new(recording: Recording) -> Self {
        let version = parse_version(&version_frame(recording.metadata()));
        let revolution = version.as_ref().and_then(revolution);
        let stream = StreamPolls::new(recording.left_out.clone());
        let (version, failed_polls, serial_numbers) = (None, 0, BTreeSet::new());
        let is_over = false;
        Self { recording, stream, version, revolution, failed_polls, serial_numbers, is_over }
    }

    /// Frames of the scans read so far.
    pub(super) fn frame_ids(&self) -> &BTreeSet<String> {
        &self.stream.frame_ids
    }

    fn add_serial_number(&mut self, number: String) {
        if self.serial_numbers.len() < MAX_SOURCES && !number.is_empty() {
            self.serial_numbers.insert(number);
        }
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
            if let Some(version) = &version {
                self.add_serial_number(version.serial_number.to_string());
            }
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
                Some(Ok(Item::Description(window))) => {
                    let number = self.recording.metadata().get("serial_number").cloned();
                    self.add_serial_number(number.unwrap_or_default());
                    self.stream.describe(window);
                }
                Some(Ok(Item::Unread(_))) => {}
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
        Some(self.parse()?.values().iter().map(|value| u32::from(*value)).collect())
    }
}
