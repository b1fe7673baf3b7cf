//! [`Polls`]: the recorded replies to polls, or the `/scan` messages of a recording without
//! replies. A replay sends them and [`Recording::scans`] decodes them, so both have the same scans.

use std::collections::VecDeque;
use std::time::{Duration, SystemTime};

use super::from_ros::MessageScan;
use super::identity::{parse_version, version_frame};
use super::record::{Entry, RecordedReply};
use super::{Recording, RecordingError};
use tokio_scip::protocol::{Command, Reply};
use tokio_scip::{Version, Window};

/// Number of polls to search for the window of a stream. The driver does not widen one of
/// four polls of a stream, and polls of other streams may be between them.
const WINDOW_SEARCH_POLLS: usize = 8;

/// Replies to `G`, in the order of their arrival.
pub(super) struct Polls {
    recording: Recording,
    /// Window of the stream, from the metadata or else from the first polls.
    window: Option<Window>,
    /// First successful reply to `V`.
    version: Option<RecordedReply>,
    /// Time of one revolution, from the sensor's latest reply to `V`, or else from the metadata.
    revolution: Option<Duration>,
    /// Set once a reply to any command was read: the replies have all scans then, and each comes
    /// before the message that was made of it.
    has_replies: bool,
    /// Polls read in advance.
    ahead: VecDeque<Result<PollReply, RecordingError>>,
}

/// Answer to a poll.
pub(super) struct PollReply {
    /// Log time of its receipt.
    pub(super) at: SystemTime,
    /// Requested window.
    pub(super) asked: Window,
    /// Wall clock when the first byte arrived.
    pub(super) stamp: SystemTime,
    /// Time of one revolution, if the answer has it.
    pub(super) scan_time: Option<Duration>,
    pub(super) answer: Answer,
}

/// What a recording has of an answer.
pub(super) enum Answer {
    Reply(RecordedReply),
    /// Values of a `/scan` message.
    Values(Vec<u16>),
}

impl Answer {
    /// Values of a successful answer.
    pub(super) fn values(&self) -> Option<Vec<u16>> {
        match self {
            Self::Reply(reply) => reply.values(),
            Self::Values(values) => Some(values.clone()),
        }
    }
}

impl Polls {
    pub(super) fn new(recording: Recording) -> Self {
        let window = recording.window();
        let version = parse_version(&version_frame(recording.metadata()));
        let revolution = version.as_ref().and_then(revolution);
        let (ahead, has_replies) = (VecDeque::new(), false);
        Self { recording, window, version: None, revolution, has_replies, ahead }
    }

    /// Window of the stream, or `None` before the first poll if the metadata does not
    /// have it.
    pub(super) fn window(&self) -> Option<Window> {
        self.window
    }

    /// Reply to `V` without its terminator: the first one that was read, or else what the metadata
    /// have of it.
    pub(super) fn version_frame(&self) -> Vec<u8> {
        let frame = self.version.as_ref().and_then(|reply| reply.bytes.strip_suffix(b"\n\n"));
        frame.map_or_else(|| version_frame(self.recording.metadata()), <[u8]>::to_vec)
    }

    /// Wall clock of the first reply to `V` that was read.
    pub(super) fn version_stamp(&self) -> Option<SystemTime> {
        self.version.as_ref().map(|reply| reply.stamp)
    }

    /// Time of one revolution, if the sensor's firmware line has it.
    pub(super) fn revolution(&self) -> Option<Duration> {
        self.revolution
    }

    /// Time from the first scan of the file to a reply.
    pub(super) fn since_first_scan(&self, poll: &PollReply) -> Duration {
        self.recording.since_first_scan(poll.at)
    }

    pub(super) fn is_truncated(&self) -> bool {
        self.recording.is_truncated()
    }

    /// Returns true if `asked` is the stream's window, possibly widened by the driver.
    pub(super) fn is_of_stream(&self, asked: Window) -> bool {
        self.window.is_some_and(|window| window.is_polled_as(asked))
    }

    /// Finds the window of the stream to which the first poll belongs. The first poll may
    /// be a widened one, because a part of a recording begins anywhere.
    fn find_window(&mut self) {
        self.ahead = std::iter::from_fn(|| self.read()).take(WINDOW_SEARCH_POLLS).collect();
        let mut asked = self.ahead.iter().flatten().map(|poll| poll.asked);
        let Some(first) = asked.next() else { return };
        let narrower = asked.filter(|asked| asked.is_polled_as(first));
        self.window = narrower.chain([first]).min_by_key(Window::steps);
    }

    fn read(&mut self) -> Option<Result<PollReply, RecordingError>> {
        loop {
            let record = match self.recording.next()? {
                Ok(record) => record,
                Err(error) => return Some(Err(error)),
            };
            let reply = match record.entry {
                Entry::Reply(reply) => reply,
                Entry::Scan(message) if !self.has_replies => {
                    let scan = MessageScan::from_message(&message, self.window);
                    let Some(scan) = scan else { continue };
                    return Some(Ok(PollReply {
                        at: record.at,
                        asked: scan.window,
                        stamp: scan.stamp,
                        scan_time: scan.scan_time,
                        answer: Answer::Values(scan.values),
                    }));
                }
                _ => continue,
            };
            self.has_replies = true;
            match reply.command {
                Some(Command::Distances(asked)) => {
                    let (at, stamp, scan_time) = (record.at, reply.stamp, None);
                    let answer = Answer::Reply(reply);
                    return Some(Ok(PollReply { at, asked, stamp, scan_time, answer }));
                }
                Some(Command::Version) => {
                    let version = reply.parse().map(|reply| Version::from_reply(&reply));
                    self.revolution = version.as_ref().and_then(revolution).or(self.revolution);
                    if version.is_some() {
                        self.version.get_or_insert(reply);
                    }
                }
                _ => {}
            }
        }
    }
}

/// Nominal time of one revolution.
fn revolution(version: &Version) -> Option<Duration> {
    let rpm = version.specification.as_ref()?.motor_speed?;
    Some(Duration::from_secs(60) / u32::from(rpm.max(1)))
}

impl Iterator for Polls {
    type Item = Result<PollReply, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.window.is_none() && self.ahead.is_empty() {
            self.find_window();
        }
        self.ahead.pop_front().or_else(|| self.read())
    }
}

impl RecordedReply {
    /// Parses a successful reply to its command.
    pub(super) fn parse(&self) -> Option<Reply> {
        let frame = self.bytes.strip_suffix(b"\n\n")?;
        let reply = Reply::parse(self.command.as_ref()?, frame).ok()?;
        reply.status().is_ok().then_some(reply)
    }

    /// Values of a successful reply to `G`.
    pub(super) fn values(&self) -> Option<Vec<u16>> {
        let Some(Command::Distances(_)) = self.command else { return None };
        Some(self.parse()?.values().to_vec())
    }
}
