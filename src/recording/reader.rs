//! [`Recording`]: a file read from its beginning, as far as it goes.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use mcap::parse_record;
use mcap::records::{MessageHeader, Record as McapRecord};

use super::records::Records;
use super::ros::{self, EVENTS, LaserScan, REPLIES, SCAN};
use super::{METADATA, RecordingError};
use crate::emulator::Emulator;
use crate::protocol::Command;
use crate::recording::replay::{self, ReplayPace};
use crate::{BaudRate, Rate, Window};

/// How many records are read to find the metadata: it stands near the
/// beginning.
const HEAD: usize = 256;

/// One thing that was recorded.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Record {
    /// When it happened: the wall clock when the recording began, and from
    /// there on a clock that is never set.
    pub at: SystemTime,
    /// Its number among those of its kind; for a scan, that of its schedule.
    pub sequence: u32,
    /// What happened.
    pub entry: Entry,
}

/// What a [`Record`] holds.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Entry {
    /// A scan that the stream gave.
    Scan(LaserScan),
    /// What the sensor sent.
    Reply(Reply),
    /// Something else, as the JSON that an [`Event`](super::Event) writes.
    Event(String),
}

/// Bytes that the sensor sent.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Reply {
    /// The command that they answer, well or badly; `None` for the reply to a
    /// fence and for what nobody asked for.
    pub command: Option<Command>,
    /// The bytes, with the two LFs that end a reply.
    pub bytes: Vec<u8>,
    /// The wall clock when the first of them arrived.
    pub stamp: SystemTime,
}

/// A recording, read record by record, in the order in which they were written.
///
/// What is missing at the end, after a kill or a full disk, is no error: what
/// was recorded before is read, and [`is_truncated`](Self::is_truncated) tells.
/// Reading blocks, for as long as a file takes.
///
/// ```no_run
/// use tokio_scip::recording::{Entry, Recording};
///
/// for record in Recording::open("run.mcap")? {
///     if let Entry::Scan(scan) = record?.entry {
///         println!("{:?} {:?}", scan.stamp, scan.ranges);
///     }
/// }
/// # Ok::<(), tokio_scip::recording::RecordingError>(())
/// ```
pub struct Recording {
    records: Records,
    channels: HashMap<u16, Channel>,
    metadata: BTreeMap<String, String>,
    /// Read, and not given out yet.
    ahead: VecDeque<Record>,
    ended: bool,
}

#[derive(Debug, Clone, Copy)]
enum Channel {
    Scans,
    Replies,
    Events,
}

impl Recording {
    /// Opens a recording, and reads its beginning.
    ///
    /// # Errors
    ///
    /// [`RecordingError::Open`] if there is no such file or it may not be read,
    /// [`RecordingError::NotMcap`], [`RecordingError::Read`] and
    /// [`RecordingError::Damaged`] for what is in it.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, RecordingError> {
        let path = path.as_ref();
        let file = File::open(path).map_err(|error| RecordingError::Open {
            path: path.to_owned(),
            source: Arc::new(error),
        })?;
        Self::read(file)
    }

    /// Reads a recording from anything that has its bytes.
    ///
    /// # Errors
    ///
    /// Those of [`open`](Self::open), but for those of opening a file.
    pub fn read(input: impl Read + Send + 'static) -> Result<Self, RecordingError> {
        let mut recording = Self {
            records: Records::new(input),
            channels: HashMap::new(),
            metadata: BTreeMap::new(),
            ahead: VecDeque::new(),
            ended: false,
        };
        while recording.metadata.is_empty() && recording.ahead.len() < HEAD {
            let Some(record) = recording.advance()? else { break };
            recording.ahead.push_back(record);
        }
        Ok(recording)
    }

    /// What was written down of the sensor, by
    /// [`Recorder::describe`](super::Recorder::describe): `vendor`, `product`,
    /// `firmware`, `protocol`, `serial_number`, `status`, `baud_rate` (`none` on
    /// USB), `start`, `end`, `cluster`, `rate`. Empty if nothing was.
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.metadata
    }

    /// The window of the stream that was recorded, if it was written down.
    pub fn window(&self) -> Option<Window> {
        let number = |key| self.metadata.get(key)?.parse().ok();
        let window = Window::new(number("start")?..=number("end")?).ok()?;
        window.with_cluster_count(number("cluster")?.try_into().ok()?).ok()
    }

    /// The rate of the stream that was recorded, if it was written down.
    pub fn rate(&self) -> Option<Rate> {
        self.metadata.get("rate")?.parse().ok()
    }

    /// True once the end was reached and the file's end was missing: the
    /// recorder was killed, the disk full, or it is being recorded still.
    pub fn is_truncated(&self) -> bool {
        self.records.is_truncated()
    }

    /// An emulated sensor that plays the sensor which was recorded: see
    /// [the module](super#replaying).
    ///
    /// # Errors
    ///
    /// [`RecordingError::NoReplies`] if there is nothing to replay, and those of
    /// reading the file up to the first scan.
    pub fn replay(self, pace: ReplayPace) -> Result<Emulator, RecordingError> {
        replay::emulator(self, pace)
    }

    /// The next record of a kind that is known. Nothing comes after an error.
    fn advance(&mut self) -> Result<Option<Record>, RecordingError> {
        if self.ended {
            return Ok(None);
        }
        let outcome = self.next_known();
        self.ended = !matches!(outcome, Ok(Some(_)));
        outcome
    }

    fn next_known(&mut self) -> Result<Option<Record>, RecordingError> {
        while let Some((kind, content)) = self.records.next()? {
            match parse_record(kind, content).map_err(RecordingError::read)? {
                McapRecord::Channel(channel) => {
                    let known = Channel::named(&channel.topic);
                    self.channels.extend(known.map(|known| (channel.id, known)));
                }
                McapRecord::Metadata(metadata) if metadata.name == METADATA => {
                    self.metadata = metadata.metadata;
                }
                McapRecord::Message { header, data } => {
                    let Some(channel) = self.channels.get(&header.channel_id) else { continue };
                    let entry =
                        entry(*channel, &header, &data).ok_or_else(|| RecordingError::Damaged {
                            reason: "a message is not of its type".to_owned(),
                        })?;
                    let (at, sequence) = (time(header.log_time), header.sequence);
                    return Ok(Some(Record { at, sequence, entry }));
                }
                _ => {}
            }
        }
        Ok(None)
    }
}

impl Iterator for Recording {
    type Item = Result<Record, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.ahead.pop_front().map(Ok).or_else(|| self.advance().transpose())
    }
}

impl fmt::Debug for Recording {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Recording").field("metadata", &self.metadata).finish_non_exhaustive()
    }
}

impl Channel {
    fn named(topic: &str) -> Option<Self> {
        let known =
            [(SCAN.name, Self::Scans), (REPLIES.name, Self::Replies), (EVENTS.name, Self::Events)];
        known.into_iter().find(|(name, _)| *name == topic).map(|(_, channel)| channel)
    }
}

fn entry(channel: Channel, header: &MessageHeader, message: &[u8]) -> Option<Entry> {
    match channel {
        Channel::Scans => ros::read_scan(message).map(Entry::Scan),
        Channel::Events => ros::read_text(message).map(Entry::Event),
        Channel::Replies => {
            let (command, bytes) = ros::read_reply(message)?;
            let command = command_named(&command);
            Some(Entry::Reply(Reply { command, bytes, stamp: time(header.publish_time) }))
        }
    }
}

/// The command with this text.
pub(super) fn command_named(text: &str) -> Option<Command> {
    let digits = text.strip_prefix('G').unwrap_or_default();
    if digits.len() == 8 && digits.bytes().all(|byte| byte.is_ascii_digit()) {
        let number = |range: Range<usize>| digits.get(range)?.parse::<u16>().ok();
        let window = Window::new(number(0..3)?..=number(3..6)?).ok()?;
        let cluster = number(6..8)?.try_into().ok()?;
        return window.with_cluster_count(cluster).ok().map(Command::Distances);
    }
    let fixed = [Command::Version, Command::LaserOn, Command::LaserOff];
    let speeds = BaudRate::ALL.into_iter().map(Command::BaudRate);
    fixed.into_iter().chain(speeds).find(|command| command.to_string() == text)
}

fn time(nanos: u64) -> SystemTime {
    SystemTime::UNIX_EPOCH + Duration::from_nanos(nanos)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_is_known_by_its_text() {
        let window = Window::new(3..=768).and_then(|window| window.with_cluster_count(99)).unwrap();
        let commands = [Command::Version, Command::LaserOn, Command::LaserOff]
            .into_iter()
            .chain(BaudRate::ALL.into_iter().map(Command::BaudRate))
            .chain([Command::Distances(window), Command::Distances(Window::FULL)]);
        for command in commands {
            assert_eq!(command_named(&command.to_string()), Some(command));
        }
        for text in [
            "",
            "G",
            "G00076800",
            "G76800001",
            "G+0076801",
            "Gx0076801",
            "G\u{e9}\u{e9}\u{e9}\u{e9}",
            "X",
        ] {
            assert_eq!(command_named(text), None, "{text}");
        }
    }
}
