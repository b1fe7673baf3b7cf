//! [`Polls`]: the recorded replies to polls. A replay sends them and
//! [`Recording::scans`] decodes them, so that both have the same scans.

use std::collections::VecDeque;
use std::time::{Duration, SystemTime};

use super::record::{Entry, Reply};
use super::{Recording, RecordingError};
use crate::Window;
use crate::protocol::{Command, Reply as ParsedReply, Version};

/// The window of a stream is searched in so many polls. One of each four of a stream is
/// not widened by the driver; polls of other streams may be between them.
const WINDOW_SEARCH_POLLS: usize = 8;

/// The replies to `G`, in the order in which they came.
pub(super) struct Polls {
    recording: Recording,
    /// The window of the stream: that of the metadata, else that of the first polls.
    window: Option<Window>,
    /// The time of a revolution, from the sensor's latest reply to `V`.
    revolution: Option<Duration>,
    /// Polls read in advance.
    ahead: VecDeque<Result<PollReply, RecordingError>>,
}

/// A reply to `G`.
pub(super) struct PollReply {
    /// The log time at which it was received.
    pub(super) at: SystemTime,
    /// The window that was asked for.
    pub(super) asked: Window,
    pub(super) reply: Reply,
}

impl Polls {
    pub(super) fn new(recording: Recording) -> Self {
        let window = recording.window();
        Self { recording, window, revolution: None, ahead: VecDeque::new() }
    }

    /// Returns the window of the stream, or `None` before the first poll if it is
    /// not in the metadata.
    pub(super) fn window(&self) -> Option<Window> {
        self.window
    }

    /// Returns the time of a revolution, if the sensor's firmware line has it.
    pub(super) fn revolution(&self) -> Option<Duration> {
        self.revolution
    }

    /// Returns the time of a reply since the first scan of the file.
    pub(super) fn since_first_scan(&self, poll: &PollReply) -> Duration {
        self.recording.since_first_scan(poll.at)
    }

    pub(super) fn is_truncated(&self) -> bool {
        self.recording.is_truncated()
    }

    /// Returns true if `asked` is the stream's window, or that widened by the driver.
    pub(super) fn is_of_stream(&self, asked: Window) -> bool {
        self.window.is_some_and(|window| is_widened(window, asked))
    }

    /// Finds the window of the stream to which the first poll belongs. That poll may be a
    /// widened one: a part of a recording begins anywhere.
    fn find_window(&mut self) {
        self.ahead = std::iter::from_fn(|| self.read()).take(WINDOW_SEARCH_POLLS).collect();
        let mut asked = self.ahead.iter().flatten().map(|poll| poll.asked);
        let Some(first) = asked.next() else { return };
        let narrower = asked.filter(|asked| is_widened(*asked, first));
        self.window = narrower.chain([first]).min_by_key(Window::steps);
    }

    fn read(&mut self) -> Option<Result<PollReply, RecordingError>> {
        loop {
            let record = match self.recording.next()? {
                Ok(record) => record,
                Err(error) => return Some(Err(error)),
            };
            let Entry::Reply(reply) = record.entry else { continue };
            match reply.command {
                Some(Command::Distances(asked)) => {
                    return Some(Ok(PollReply { at: record.at, asked, reply }));
                }
                Some(Command::Version) => {
                    let version = reply.parse().map(|reply| Version::from_reply(&reply));
                    let rpm = version.and_then(|version| version.specification?.motor_speed);
                    let revolution = |rpm: u16| Duration::from_secs(60) / u32::from(rpm.max(1));
                    self.revolution = rpm.map(revolution).or(self.revolution);
                }
                _ => {}
            }
        }
    }
}

/// Returns true if the driver may request `asked` in order to get `window`.
fn is_widened(window: Window, asked: Window) -> bool {
    let widened = |extra| window.widened(extra);
    (0..=Window::MAX_EXTRA_POINTS).filter_map(widened).any(|(widened, _)| widened == asked)
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

impl Reply {
    /// Parses it as a reply to its command, if it is successful.
    pub(super) fn parse(&self) -> Option<ParsedReply<'_>> {
        let frame = self.bytes.strip_suffix(b"\n\n")?;
        let reply = ParsedReply::parse(self.command.as_ref()?, frame).ok()?;
        reply.status().is_ok().then_some(reply)
    }

    /// Returns the values of a successful reply to `G`.
    pub(super) fn values(&self) -> Option<Vec<u16>> {
        let Some(Command::Distances(_)) = self.command else { return None };
        let mut values = Vec::new();
        self.parse()?.values_into(&mut values);
        Some(values)
    }
}
