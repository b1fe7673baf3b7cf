//! [`Recording`]: reads a file record by record, from its beginning to wherever
//! it ends, or a part of it. Only the records that a recording needs are parsed.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::ops::RangeBounds;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use super::mcap::{Fields, Input, MessageHeader, Records, kind, nanos, parse_metadata};
use super::range::{RecordPlace, TimeRange};
use super::record::{Entry, Record, Reply, parse_command};
use super::topics::Topic;
use super::{METADATA, RecordingError};
use crate::ros::{self, since_1970};
use crate::{Event, Rate, Window};

/// The metadata is searched in so many records, and no further than in the section that
/// reaches this place: it stands near the beginning, and what is read before it is kept.
const METADATA_SEARCH_RECORDS: usize = 256;
const METADATA_SEARCH_BYTES: u64 = 1 << 20;
/// The reason of damage that no checksum covers.
const MALFORMED: &str = "a message or channel is not of its form";

/// A recording as an iterator over its records, in the order in which they were
/// written.
///
/// A missing end, after a kill or a full disk, is no error: all that was recorded
/// before is read, and then [`is_truncated`](Self::is_truncated) returns true. A
/// damaged part is an item, [`RecordingError::Damaged`], and the records behind
/// it follow; after any other error there are none. Reading blocks the thread.
///
/// Memory is bounded by the file's longest chunk, at most 64 MiB, whatever the
/// file claims.
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
    /// The topic of each channel; `None` if it is none of a recording.
    channels: HashMap<u16, Option<Topic>>,
    metadata: BTreeMap<String, String>,
    /// Records read in advance.
    ahead: VecDeque<Result<Record, RecordingError>>,
    /// The part that is read.
    range: TimeRange,
    is_over: bool,
}

impl Recording {
    /// Opens a recording and reads up to its metadata, at most its first 256
    /// messages and the chunk in which its first MiB ends.
    ///
    /// # Errors
    ///
    /// Fails with [`RecordingError::Open`] if the file cannot be opened,
    /// [`RecordingError::NotMcap`] and [`RecordingError::Compressed`] if it is no
    /// recording of this crate, and [`RecordingError::Read`] if reading fails. A
    /// damaged beginning is an item of the iterator.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, RecordingError> {
        let path = path.as_ref();
        let file = File::open(path).map_err(|error| RecordingError::Open {
            path: path.to_owned(),
            source: Arc::new(error),
        })?;
        Self::of(Input::File(file))
    }

    /// Reads a recording from any reader; otherwise the same as
    /// [`open`](Self::open).
    ///
    /// # Errors
    ///
    /// Fails as [`open`](Self::open) does.
    pub fn read(input: impl Read + Send + 'static) -> Result<Self, RecordingError> {
        Self::of(Input::Stream(Box::new(input)))
    }

    fn of(input: Input) -> Result<Self, RecordingError> {
        let mut recording = Self {
            records: Records::new(input),
            channels: HashMap::new(),
            metadata: BTreeMap::new(),
            ahead: VecDeque::new(),
            range: TimeRange::new(&..),
            is_over: false,
        };
        while recording.metadata.is_empty()
            && recording.ahead.len() < METADATA_SEARCH_RECORDS
            && recording.records.offset() < METADATA_SEARCH_BYTES
        {
            match recording.step() {
                Ok(Step::Record(record)) => recording.ahead.push_back(Ok(record)),
                Ok(Step::Other) => {}
                Ok(Step::End) => break,
                Err(error @ RecordingError::Damaged { .. }) => {
                    recording.ahead.push_back(Err(error));
                }
                Err(error) => return Err(error),
            }
        }
        Ok(recording)
    }

    /// Restricts the recording to a part: to the records whose time since the first
    /// scan is in `range`, and the first reply to `V`, with which a replay begins.
    ///
    /// Nothing behind the part is read. Of a complete file that was opened by
    /// [`open`](Self::open) the chunks before the part are not read either, except the
    /// first ones, up to the metadata, a reply to `V` and a scan: its index, at most
    /// 16 MiB of memory, has their places, and a checksum that proves it. Any other file
    /// is read from its beginning.
    ///
    /// An [`Entry::Scan`] that its consumer recorded late stands behind later replies, and
    /// may be missing at the end of a part. [`scans`](Self::scans) has it, from its reply.
    ///
    /// ```no_run
    /// use std::time::Duration;
    /// use tokio_scip::recording::Recording;
    ///
    /// let (from, to) = (Duration::from_secs(90), Duration::from_secs(120));
    /// for scan in Recording::open("run.mcap")?.range(from..to).scans() {
    ///     println!("{:?}", scan?.stamp());
    /// }
    /// # Ok::<(), tokio_scip::recording::RecordingError>(())
    /// ```
    #[must_use]
    pub fn range(mut self, range: impl RangeBounds<Duration>) -> Self {
        self.range = TimeRange::new(&range);
        self
    }

    /// Returns what [`Recorder::describe`](super::Recorder::describe) recorded of
    /// the sensor: `vendor`, `product`, `firmware`, `protocol`, `serial_number`,
    /// `status`, `baud_rate` (`none` on USB), `start`, `end`, `cluster`, `rate`.
    /// Empty if it was not called.
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.metadata
    }

    /// Returns the window of the recorded stream, or `None` if it is not in the
    /// metadata.
    pub fn window(&self) -> Option<Window> {
        let number = |key| self.metadata.get(key)?.parse().ok();
        let window = Window::new(number("start")?..=number("end")?).ok()?;
        window.with_cluster_count(number("cluster")?.try_into().ok()?).ok()
    }

    /// Returns the rate of the recorded stream, or `None` if it is not in the
    /// metadata.
    pub fn rate(&self) -> Option<Rate> {
        self.metadata.get("rate")?.parse().ok()
    }

    /// Returns true if all of the file was read and its end is missing: the
    /// recorder was killed, the disk was full, or it is still recording.
    /// [`repair`](super::repair) makes a complete file of it.
    pub fn is_truncated(&self) -> bool {
        self.records.is_truncated()
    }

    /// Returns the time of a record since the first scan.
    pub(super) fn since_first_scan(&self, at: SystemTime) -> Duration {
        self.range.since_first_scan(at)
    }

    /// Leaves out what is before `begin`, as far as the file's index has it.
    fn leave_out_before(&mut self, begin: SystemTime) -> Result<(), RecordingError> {
        let index = self.records.leave_out_before(nanos(since_1970(begin)))?;
        // Others' writers define a channel only once, in its first chunk.
        for (id, topic) in index.channels().filter_map(channel) {
            self.channels.entry(id).or_insert(topic);
        }
        Ok(())
    }

    /// Returns the next record of a recording. Only an error that is
    /// [`RecordingError::Damaged`] is followed by more.
    fn advance(&mut self) -> Option<Result<Record, RecordingError>> {
        loop {
            return match self.step() {
                Ok(Step::Record(record)) => Some(Ok(record)),
                Ok(Step::Other) => continue,
                Ok(Step::End) => None,
                Err(error) => Some(Err(error)),
            };
        }
    }

    fn step(&mut self) -> Result<Step, RecordingError> {
        if self.is_over {
            return Ok(Step::End);
        }
        let outcome = self.next_step();
        let goes_on = matches!(
            outcome,
            Ok(Step::Record(_) | Step::Other) | Err(RecordingError::Damaged { .. })
        );
        self.is_over = !goes_on;
        outcome
    }

    fn next_step(&mut self) -> Result<Step, RecordingError> {
        let Some((kind, content)) = self.records.next()? else { return Ok(Step::End) };
        let parsed = match kind {
            kind::CHANNEL => channel(content).map(|(id, topic)| {
                self.channels.insert(id, topic);
                Step::Other
            }),
            kind::METADATA => parse_metadata(content).map(|(name, pairs)| {
                if name == METADATA {
                    let owned = |(key, value): (&str, &str)| (key.to_owned(), value.to_owned());
                    self.metadata = pairs.into_iter().map(owned).collect();
                }
                Step::Other
            }),
            kind::MESSAGE => message(content, &mut self.channels),
            _ => Some(Step::Other),
        };
        parsed.ok_or_else(|| {
            let (offset, reason) = (self.records.offset(), MALFORMED);
            RecordingError::Damaged { offset, reason }
        })
    }
}

/// The outcome of reading one record of the file.
enum Step {
    Record(Record),
    /// A record that is no item of a recording.
    Other,
    End,
}

impl Iterator for Recording {
    type Item = Result<Record, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let item = self.ahead.pop_front().or_else(|| self.advance())?;
            let Ok(record) = &item else { return Some(item) };
            let place = self.range.place(record);
            if let Some(begin) = self.range.take_begin()
                && let Err(error) = self.leave_out_before(begin)
            {
                self.is_over = true;
                return Some(Err(error));
            }
            match place {
                RecordPlace::Inside => return Some(item),
                RecordPlace::Outside => {}
                RecordPlace::Behind => {
                    self.is_over = true;
                    self.ahead.clear();
                    return None;
                }
            }
        }
    }
}

impl fmt::Debug for Recording {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Recording").field("metadata", &self.metadata).finish_non_exhaustive()
    }
}

/// Parses a channel: its number, and its topic if that is one of a recording.
fn channel(content: &[u8]) -> Option<(u16, Option<Topic>)> {
    let mut fields = Fields(content);
    let (id, _schema, name) = (fields.u16()?, fields.u16()?, fields.string()?);
    Some((id, Topic::ALL.into_iter().find(|topic| topic.name() == name)))
}

/// Parses a message: a record if it is of a topic of a recording. A channel that
/// the file does not define is reported once.
fn message(content: &[u8], channels: &mut HashMap<u16, Option<Topic>>) -> Option<Step> {
    let (header, data) = MessageHeader::parse(content)?;
    let Some(topic) = channels.get(&header.channel) else {
        channels.insert(header.channel, None);
        return None;
    };
    let Some(topic) = topic else { return Some(Step::Other) };
    let entry = match topic {
        Topic::Scans => Entry::Scan(ros::read_scan(data)?),
        Topic::Events => {
            let text = ros::read_text(data)?;
            let unknown = || Event::Unknown { text: text.to_owned() };
            Entry::Event(text.parse().unwrap_or_else(|_| unknown()))
        }
        Topic::Replies => {
            let (command, bytes) = ros::read_labelled_bytes(data)?;
            let (command, bytes) = (parse_command(command), bytes.to_vec());
            Entry::Reply(Reply { command, bytes, stamp: time(header.publish_time) })
        }
    };
    Some(Step::Record(Record { at: time(header.log_time), sequence: header.sequence, entry }))
}

fn time(nanos: u64) -> SystemTime {
    SystemTime::UNIX_EPOCH + Duration::from_nanos(nanos)
}
