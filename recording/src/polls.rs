//! [`Polls`]: the recorded replies to polls, and the `/scan` messages whose reply was not recorded. A
//! replay sends them and [`Recording::scans`] decodes them, so both have the same scans.

use std::collections::{BTreeSet, VecDeque};
use std::time::{Duration, SystemTime};

use super::event::Event;
use super::from_ros::{MessageScan, ends};
use super::left_out::{LeftOutCounter, LeftOutReason};
use super::reader::Item;
use super::record::{Entry, Record};
use super::reply::{RecordedReply, ReplyKind, Values, parse_version, version_lines};
use super::stream::{Model, Stream};
use super::{Recording, RecordingError};
use tokio_scip::{Version, Window};

/// Number of polls to search for the window of a stream that is not described. They stay in memory,
/// so the search also ends after this many bytes of replies.
const WINDOW_SEARCH_POLLS: usize = 256;
const WINDOW_SEARCH_BYTES: usize = 1 << 20;
/// Number of replies whose scans may still follow, from a consumer that is behind.
const MAX_STAMPS: usize = 1 << 16;
/// Number of descriptions whose streams may still begin.
const MAX_STREAMS: usize = 16;
/// Number of polls among which a message that was played again and its reply find each other.
const MAX_UNPAIRED: usize = 8;
/// Least time between a measurement and its playback.
const PLAYED_AFTER: Duration = Duration::from_secs(1);
/// Number of sources to name.
const MAX_SOURCES: usize = 16;

/// Answer to a poll.
#[derive(Debug, Clone)]
pub(super) struct PollReply {
    /// Log time of its receipt.
    pub(super) at: SystemTime,
    /// Sensor, and requested window.
    pub(super) asked: Stream,
    /// Window of the recorded stream, if this is a poll of it.
    pub(super) window: Option<Window>,
    /// Wall clock when the first byte arrived.
    pub(super) stamp: SystemTime,
    /// Time of one revolution, if the answer has it.
    pub(super) scan_time: Option<Duration>,
    /// True for a message that was played and recorded again, which gave it another time than its reply.
    is_played: bool,
    pub(super) answer: Answer,
}

#[derive(Debug, Clone)]
pub(super) enum Answer {
    Reply(RecordedReply),
    /// Values of a `/scan` message.
    Values(Values),
    /// A `/scan` message made of a reply that was recorded.
    Repeated,
}

impl Answer {
    /// Values of a successful answer.
    pub(super) fn values(&self) -> Option<Values> {
        match self {
            Self::Reply(reply) => reply.values(),
            Self::Values(values) => Some(values.clone()),
            Self::Repeated => None,
        }
    }
}

impl PollReply {
    /// Values of the stream's window, if this is a scan of it.
    pub(super) fn stream_values(&self) -> Option<(Window, Values)> {
        let window = self.window?;
        Some((window, self.values_of(&window)?))
    }

    /// Values of a window that was asked for, or is a part of that.
    fn values_of(&self, window: &Window) -> Option<Values> {
        let mut values = self.answer.values()?;
        // The driver may have asked for extra points before or after the window, or for a stream of more
        // windows, whose clusters it makes.
        let clusters = self.asked.window.cluster_count();
        let surplus = window.start().saturating_sub(self.asked.window.start());
        let (surplus, steps) = (usize::from(surplus / u16::from(clusters)), window.steps());
        for values in [&mut values.distances, &mut values.intensities] {
            values.drain(..surplus.min(values.len()));
            values.truncate(steps.div_ceil(clusters.into()));
        }
        if clusters != window.cluster_count() {
            values.cluster(window.cluster_count(), &self.asked.model.geometry());
        }
        (values.distances.len() == window.points()).then_some(values)
    }

    /// Returns true if this is a message of that reply, with another time or before it: both have the same
    /// distances. rosbags 0.11.9 sorts what was received at the same time.
    fn is_made_of(&self, reply: &Self) -> bool {
        let distances = |poll: &Self| {
            let (values, geometry) =
                (poll.values_of(&self.asked.window)?, poll.asked.model.geometry());
            let distance = |value: &u32| geometry.measurement(*value).distance();
            Some(values.distances.iter().map(distance).collect::<Vec<_>>())
        };
        // Two replies are two scans, even with the same log time.
        matches!(self.answer, Answer::Values(_))
            && (self.is_played || self.at == reply.at)
            && self.asked.model.is_like(&reply.asked.model)
            && distances(self).is_some_and(|seen| distances(reply) == Some(seen))
    }

    /// Returns true if this is a poll of the stream.
    fn is_of(&self, stream: &Stream) -> bool {
        let points = |window: &Window| (window.cluster_count(), ends(window));
        let is_same = match &self.answer {
            // A message does not tell how many steps its last point has.
            Answer::Values(_) => points(&stream.window) == points(&self.asked.window),
            // In SCIP 2 the driver asks for the window itself, or for a stream of more windows.
            Answer::Reply(reply) if reply.is_streamed() => self.asked.window.holds(&stream.window),
            _ if self.asked.model.0.is_some() => stream.window == self.asked.window,
            _ => stream.window.is_polled_as(self.asked.window),
        };
        is_same && stream.model.is_like(&self.asked.model)
    }
}

/// Finds the polls among the records of a file, and the stream that they belong to.
#[derive(Debug, Default)]
pub(super) struct StreamPolls {
    /// The current stream and those that were described since and have not begun: a stream begins
    /// with its first poll. Without a description, from the first polls.
    streams: VecDeque<Stream>,
    is_described: bool,
    first_described_version: Option<Vec<Vec<u8>>>,
    /// Sensor of the replies in SCIP 2, by the latest description or reply to `PP`.
    told: Option<Model>,
    pub(super) frame_ids: BTreeSet<String>,
    pub(super) is_disconnected: bool,
    left_out: LeftOutCounter,
    /// Stamps of the latest replies to polls, and what they are of.
    stamps: VecDeque<(SystemTime, Stream)>,
    /// Latest replies to polls without a message of the same stamp.
    unpaired: VecDeque<PollReply>,
    /// What the sensor sent for the latest scan in SCIP 2.
    latest: Vec<u8>,
    /// Polls that wait to be returned, and the bytes of their replies.
    waiting: VecDeque<PollReply>,
    waiting_bytes: usize,
}

impl StreamPolls {
    /// The records that follow belong to this stream, once one of its polls follows.
    pub(super) fn describe(&mut self, stream: Option<Stream>) {
        let Some(stream) = stream else { return };
        self.is_described = true;
        if stream.model.0.is_some() {
            self.told = Some(stream.model.clone());
        }
        self.streams.retain(|known| *known != stream);
        if self.streams.len() == MAX_STREAMS {
            self.streams.pop_front();
        }
        self.streams.push_back(stream);
    }

    pub(super) fn add(&mut self, record: Record) {
        let Record { at, stamp, .. } = record;
        let poll = |asked, answer| PollReply {
            at,
            asked,
            window: None,
            stamp,
            scan_time: None,
            is_played: false,
            answer,
        };
        let poll = match record.entry {
            Entry::Reply(reply) => {
                if let Some(parameters) = reply.parameters() {
                    self.told = Some(parameters.into());
                }
                let model = if reply.command.is_some() { None } else { self.model_of(&reply) };
                // Without its sensor, a scan is made of its message.
                let Some(window) = reply.window(model.as_ref()) else { return };
                let model = model.unwrap_or_default();
                let of = Stream { model, window };
                if self.stamps.len() >= MAX_STAMPS {
                    self.stamps.pop_front();
                }
                self.stamps.push_back((stamp, of.clone()));
                self.waiting_bytes += reply.bytes.len();
                let reply = poll(of, Answer::Reply(reply));
                let message = self.waiting.iter_mut().find(|scan| scan.is_made_of(&reply));
                if let Some(message) = message {
                    *message = reply;
                    return;
                }
                if self.unpaired.len() == MAX_UNPAIRED {
                    self.unpaired.pop_front();
                }
                self.unpaired.push_back(reply.clone());
                reply
            }
            Entry::Scan(message) => {
                if self.frame_ids.len() < MAX_SOURCES {
                    self.frame_ids.insert(message.frame_id.clone());
                }
                // The driver delivers the stamp of the reply.
                let reply = self.stamps.iter().rev().find(|(known, _)| *known == stamp);
                if let Some((_, of)) = reply {
                    self.unpaired.retain(|reply| reply.stamp != stamp);
                    poll(of.clone(), Answer::Repeated)
                } else {
                    let known = self.streams.iter().rev().cloned();
                    let Some(scan) = MessageScan::from_message(&message, known) else {
                        let directions = MessageScan::directions(&message);
                        self.left_out.add(LeftOutReason::OtherLaser, directions);
                        return;
                    };
                    let MessageScan { stream, values, stamp: measured, scan_time } = scan;
                    let since = stamp.duration_since(measured);
                    let is_played = since.unwrap_or_else(|error| error.duration()) > PLAYED_AFTER;
                    let scan = poll(stream, Answer::Values(values));
                    let scan = PollReply { stamp: measured, scan_time, is_played, ..scan };
                    let place = self.unpaired.iter().position(|reply| scan.is_made_of(reply));
                    match place.and_then(|place| self.unpaired.remove(place)) {
                        Some(reply) => PollReply { answer: Answer::Repeated, ..reply },
                        None => scan,
                    }
                }
            }
            Entry::Event(Event::Disconnected { .. }) => return self.is_disconnected = true,
            Entry::Event(Event::Reconnected) => return self.is_disconnected = false,
            Entry::Event(_) => return,
        };
        self.waiting.push_back(poll);
    }

    /// Returns the next poll, once the window of the stream is known, or `is_end` is true because no record follows.
    pub(super) fn next(&mut self, is_end: bool) -> Option<PollReply> {
        if self.streams.is_empty() {
            let is_enough = self.waiting.len() >= WINDOW_SEARCH_POLLS
                || self.waiting_bytes >= WINDOW_SEARCH_BYTES;
            if !is_end && !is_enough {
                return None;
            }
            self.find_stream();
        }
        loop {
            if !is_end && self.may_have_reply() {
                return None;
            }
            let mut poll = self.waiting.pop_front()?;
            poll.window = self.stream_of(&poll);
            let reason = match poll.answer {
                _ if self.is_known(&poll) => Some(LeftOutReason::OtherRequest),
                _ if poll.window.is_some() => None,
                Answer::Reply(_) => Some(LeftOutReason::OtherRequest),
                _ => Some(LeftOutReason::OtherWindow),
            };
            if let Some(reason) = reason {
                self.left_out.add(reason, poll.asked.window);
                if poll.window.is_some() {
                    continue;
                }
            }
            if !matches!(poll.answer, Answer::Repeated) {
                return Some(poll);
            }
        }
    }

    /// Returns true if the reply of the next poll, a message, may follow.
    fn may_have_reply(&self) -> bool {
        let Some(poll) = self.waiting.front() else { return false };
        let is_open = self.waiting.back().is_some_and(|last| last.at == poll.at)
            && self.waiting.len() < WINDOW_SEARCH_POLLS;
        let is_near = poll.is_played && self.waiting.len() < MAX_UNPAIRED;
        matches!(poll.answer, Answer::Values(_)) && (is_open || is_near)
    }

    /// Returns the sensor of a reply in SCIP 2: the one whose stream asks for it, or else the latest.
    fn model_of(&self, reply: &RecordedReply) -> Option<Model> {
        let models = self.streams.iter().rev().filter(|stream| {
            let asked = reply.window(Some(&stream.model).filter(|model| model.0.is_some()));
            asked.is_some_and(|asked| asked == stream.window)
        });
        models.map(|stream| stream.model.clone()).next().or_else(|| self.told.clone())
    }

    /// Returns true for a scan of a stream that the line has delivered twice.
    fn is_known(&mut self, poll: &PollReply) -> bool {
        let Answer::Reply(reply) = &poll.answer else { return false };
        if poll.window.is_none() || !reply.is_streamed() {
            return false;
        }
        let sent = reply.after_echo().unwrap_or_default().to_vec();
        let is_known = self.latest == sent;
        self.latest = sent;
        is_known
    }

    /// Returns the window of the stream that a poll belongs to. The latest description of its sensor counts.
    fn stream_of(&mut self, poll: &PollReply) -> Option<Window> {
        match self.streams.iter().rposition(|stream| poll.is_of(stream)) {
            Some(place) => {
                let window = self.streams.get(place).map(|stream| stream.window);
                let mut places = 0..;
                self.streams.retain(|stream| {
                    places.next() >= Some(place) || !stream.model.is_like(&poll.asked.model)
                });
                window
            }
            // Of messages alone all belong together.
            None if self.is_described => None,
            None => Some(poll.asked.window).filter(|_| matches!(poll.answer, Answer::Values(_))),
        }
    }

    /// Finds the stream to which the first poll belongs. The first polls may be widened ones, because a part
    /// of a recording begins anywhere. The driver does not widen one of four.
    fn find_stream(&mut self) {
        let Some(first) = self.waiting.front() else { return };
        let is_like = |poll: &&PollReply| poll.asked.model.is_like(&first.asked.model);
        // In SCIP 2 none is wider.
        let count = if first.asked.model.0.is_some() { 1 } else { self.waiting.len() };
        let same = self.waiting.iter().take(count).filter(is_like);
        let stream = same.map(|poll| &poll.asked).filter(|asked| first.is_of(asked));
        let stream = stream.min_by_key(|asked| asked.window.steps()).cloned();
        self.streams.extend(stream);
    }
}

/// Polls of a recording, in the order of the file.
pub(super) struct Polls {
    pub(super) recording: Recording,
    pub(super) stream: StreamPolls,
    /// First successful reply to `V` or `VV`.
    pub(super) version: Option<RecordedReply>,
    /// Time of one revolution, from the sensor's latest reply to `V`, or else from the metadata.
    pub(super) revolution: Option<Duration>,
    pub(super) failed_polls: u64,
    pub(super) serial_numbers: BTreeSet<String>,
    is_over: bool,
}

impl Polls {
    pub(super) fn new(recording: Recording) -> Self {
        let version = parse_version(&version_lines(recording.metadata()));
        let revolution = version.as_ref().and_then(revolution);
        let left_out = recording.left_out.clone();
        let stream = StreamPolls { left_out, ..StreamPolls::default() };
        let (version, failed_polls, serial_numbers, is_over) = (None, 0, BTreeSet::new(), false);
        Self { recording, stream, version, revolution, failed_polls, serial_numbers, is_over }
    }

    fn add_serial_number(&mut self, number: String) {
        if self.serial_numbers.len() < MAX_SOURCES && !number.is_empty() {
            self.serial_numbers.insert(number);
        }
    }

    /// Lines of the reply to `V`: the first one that was read, or else what the metadata have of it.
    pub(super) fn version_lines(&self) -> Vec<Vec<u8>> {
        let replied = self.version.as_ref().and_then(RecordedReply::version_lines);
        let known = replied.or_else(|| self.stream.first_described_version.clone());
        known.unwrap_or_else(|| version_lines(self.recording.metadata()))
    }

    fn add(&mut self, record: Record) {
        let described = Some(self.recording.metadata()).filter(|metadata| !metadata.is_empty());
        let version = &mut self.stream.first_described_version;
        *version = version.take().or_else(|| described.map(version_lines));
        self.failed_polls += u64::from(matches!(record.entry, Entry::Event(Event::Error { .. })));
        if let Entry::Reply(reply) = &record.entry
            && reply.kind() == ReplyKind::Version
            && let Some(version) = reply.version_lines().and_then(|lines| parse_version(&lines))
        {
            self.revolution = revolution(&version).or(self.revolution);
            self.add_serial_number(version.serial_number.to_string());
            self.version.get_or_insert_with(|| reply.clone());
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
                Some(Ok(Item::Description(stream))) => {
                    let number = self.recording.metadata().get("serial_number").cloned();
                    self.add_serial_number(number.unwrap_or_default());
                    self.stream.describe(stream);
                }
                Some(Ok(Item::Unread(_))) => {}
                Some(Err(error)) => return Some(Err(error)),
                None if self.is_over => return None,
                None => self.is_over = true,
            }
        }
    }
}

fn revolution(version: &Version) -> Option<Duration> {
    let rpm = version.specification.as_ref()?.motor_speed?;
    Some(Duration::from_secs(60) / u32::from(rpm.max(1)))
}
