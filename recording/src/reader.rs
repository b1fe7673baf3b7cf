//! [`Recording`]: reads a file record by record, or a part of it, from its beginning to
//! wherever it ends. Parses only the records that a recording needs.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::ops::{RangeBounds, RangeInclusive};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use super::folder::recording_files;
use super::left_out::{LeftOutCounter, LeftOutReason};
use super::mcap::{ChunkBytes, Records, kind, parse_metadata};
use super::messages::{self, Unread};
use super::range::TimeRange;
use super::record::{Entry, Record, Topic};
use super::stream::Stream;
use super::{METADATA, RecordingError};
use tokio_scip::{Rate, Window};

/// Number of messages to search for the metadata, which are near the beginning. The messages before
/// them stay in memory, so the search also stops after this many bytes of records.
const METADATA_SEARCH_RECORDS: usize = 256;
const METADATA_SEARCH_BYTES: usize = 1 << 20;
/// Number of other topics to name, of each kind.
const MAX_OTHER_TOPICS: usize = 16;

/// Iterates over the records of a recording, in file order.
///
/// A missing end is no error: after a crash or on a full disk you get what was recorded before, and then
/// [`is_truncated`](Self::is_truncated) returns true. A damaged part is an item, [`RecordingError::Damaged`],
/// and the records after it follow. Any other error is the last item. Reading blocks the thread.
///
/// The file's longest chunk, at most 64 MiB, bounds the memory, whatever the file claims. One more of
/// its messages may be in memory, too, and up to 64 MiB of definitions of message types. With feature
/// `compression` the limit also applies to a chunk's decompressed bytes. After damage in a file without
/// chunks, or of its end, up to 64 MiB of it are in memory.
///
/// ```no_run
/// use urg_recording::{Entry, Recording};
///
/// for record in Recording::open("run.mcap")? {
///     if let Entry::Scan(scan) = record?.entry {
///         println!("{:?} {:?}", scan.stamp, scan.ranges);
///     }
/// }
/// # Ok::<(), urg_recording::RecordingError>(())
/// ```
pub struct Recording {
    records: Records,
    further: VecDeque<PathBuf>,
    metadata: BTreeMap<String, String>,
    /// Bytes of records read so far, without compression.
    read_bytes: usize,
    /// Items read in advance.
    ahead: VecDeque<Result<Item, RecordingError>>,
    pub(super) range: TimeRange,
    /// Latest log time of a message that was read, on any topic.
    pub(super) latest: SystemTime,
    /// Log times of the part, once they are known.
    times: Option<RangeInclusive<u64>>,
    /// Topic to read instead of `/scan`.
    topic: Option<Arc<str>>,
    /// Other topics with laser scans, and types of those with other messages.
    other_topics: BTreeSet<Arc<str>>,
    other_types: BTreeMap<Arc<str>, String>,
    pub(super) left_out: LeftOutCounter,
}

impl Recording {
    /// Opens a recording and reads up to its metadata and its first message: at most 256 messages, and
    /// at most one message beyond the first MiB of records. `path` may be a folder as `ros2 bag record` makes it:
    /// its [files](recording_files) are read one after the other.
    ///
    /// # Errors
    ///
    /// Fails as [`recording_files`] does, with [`RecordingError::Open`] if a file cannot be opened,
    /// [`RecordingError::NotMcap`] if it is no recording, [`RecordingError::Compressed`] if
    /// this build does not read its compression, and [`RecordingError::Read`] if reading
    /// fails. A damaged beginning is an item of the iterator.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, RecordingError> {
        let mut further = VecDeque::from(recording_files(&path)?);
        let first = further.pop_front().unwrap_or_else(|| path.as_ref().to_owned());
        Self::from_input(open(first)?, further)
    }

    /// Reads a recording from any reader; otherwise the same as [`open`](Self::open).
    ///
    /// # Errors
    ///
    /// The same as for [`open`](Self::open).
    pub fn read(input: impl Read + Send + 'static) -> Result<Self, RecordingError> {
        Self::from_input(input, VecDeque::new())
    }

    fn from_input(
        input: impl Read + Send + 'static,
        further: VecDeque<PathBuf>,
    ) -> Result<Self, RecordingError> {
        let mut recording = Self {
            records: Records::new(input),
            further,
            metadata: BTreeMap::new(),
            read_bytes: 0,
            ahead: VecDeque::new(),
            range: TimeRange::new(&..),
            latest: SystemTime::UNIX_EPOCH,
            times: None,
            topic: None,
            other_topics: BTreeSet::new(),
            other_types: BTreeMap::new(),
            left_out: LeftOutCounter::default(),
        };
        let (mut messages, mut damaged) = (0, 0);
        // The first message shows that this build reads the compression.
        while (recording.metadata.is_empty() || messages == 0)
            && messages + damaged < METADATA_SEARCH_RECORDS
            && recording.read_bytes < METADATA_SEARCH_BYTES
        {
            match recording.advance() {
                None => break,
                Some(Ok(item)) => {
                    messages += usize::from(!matches!(item, None | Some(Item::Description(_))));
                    recording.ahead.extend(item.map(Ok));
                }
                Some(Err(error @ RecordingError::Damaged { .. })) => {
                    damaged += 1;
                    recording.ahead.push_back(Err(error));
                }
                Some(Err(error)) => return Err(error),
            }
        }
        Ok(recording)
    }

    /// Restricts the recording to a part: the records whose time since the first scan is
    /// in `range`, and the first reply to `V`, which begins a replay.
    ///
    /// If you [`open`](Self::open) a complete file, only the chunks of the part are read, and the first ones, up to
    /// the metadata, a reply to `V` and a scan. To do so it reads the file's index, which takes at most 16 MiB of
    /// memory, is proved by a checksum, and must repeat the definitions of all topics. Any other file is read from
    /// its beginning to its end, because messages may be in any order.
    #[must_use]
    pub fn range(mut self, range: impl RangeBounds<Duration>) -> Self {
        self.range = TimeRange::new(&range);
        self
    }

    /// Reads the laser scans of this topic, and nothing else: those of another program, for example
    /// of several sensors, such as `/front/scan`.
    #[must_use]
    pub fn topic(mut self, topic: &str) -> Self {
        self.topic = (topic != Topic::Scans.name()).then(|| topic.into());
        self
    }

    /// Metadata of the sensor, as recorded by [`Recorder::describe`](super::Recorder::describe): `vendor`,
    /// `product`, `firmware`, `protocol`, `serial_number`, `status`, `baud_rate` (`none` on USB), `start`,
    /// `end`, `cluster`, `rate`; in SCIP 2 also the lines of the reply to `PP`, such as `MODL`. Empty if you
    /// did not call it.
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.metadata
    }

    /// Window of the recorded stream, or `None` if the metadata does not have it, or you chose
    /// another [topic](Self::topic).
    pub fn window(&self) -> Option<Window> {
        Some(Stream::from_metadata(&self.metadata).filter(|_| self.topic.is_none())?.window)
    }

    /// Rate of the recorded stream, or `None` if the metadata does not have it.
    pub fn rate(&self) -> Option<Rate> {
        self.metadata.get("rate")?.parse().ok()
    }

    /// Returns true if the whole file was read and its end is missing or damaged: the recorder died, the disk
    /// was full, or it is still recording. Other readers need the end, an index, to find the messages. Use
    /// [`repair`](super::repair) to make a complete file.
    pub fn is_truncated(&self) -> bool {
        self.records.is_truncated
    }

    /// Bytes of the chunks read so far, and their compressions.
    pub fn chunk_bytes(&self) -> ChunkBytes {
        self.records.chunk_bytes.clone()
    }

    /// Continues in the next file. Returns false after the last one.
    fn open_next(&mut self) -> Result<bool, RecordingError> {
        let Some(path) = self.further.pop_front() else { return Ok(false) };
        self.records.continue_in(open(path)?);
        self.times.iter().try_for_each(|times| self.records.leave_out_others(times))?;
        Ok(true)
    }

    /// Counter of the messages that are read and left out: by this iterator, those that cannot be
    /// read; by [`scans`](Self::scans) and [`replay`](Self::replay) also those that are no scan of
    /// the stream. Messages outside of the [range](Self::range) are not counted.
    ///
    /// ```no_run
    /// let recording = urg_recording::Recording::open("run.mcap")?;
    /// let left_out = recording.left_out();
    /// recording.scans().for_each(drop);
    /// for count in left_out.counts() {
    ///     println!("{count}"); // 3 messages cut short or malformed (the first: /scan, 12 bytes)
    /// }
    /// # Ok::<(), urg_recording::RecordingError>(())
    /// ```
    pub fn left_out(&self) -> LeftOutCounter {
        self.left_out.clone()
    }

    /// Reports that there was no scan, and what there is instead.
    pub(super) fn no_scans(&self) -> RecordingError {
        let topics = self.other_topics.iter().map(|topic| topic.to_string()).collect();
        let types = self.other_types.iter();
        let others = types.map(|(topic, name)| format!("{topic} ({name})")).collect();
        let mut left_out = self.left_out.counts();
        // The topics are named.
        left_out.retain(|count| count.reason != LeftOutReason::OtherTopic);
        let topic = self.topic.as_deref().unwrap_or(Topic::Scans.name()).to_owned();
        RecordingError::NoScans { topic, left_out, topics, others }
    }

    /// Counts a scan on another topic.
    fn count_other_topic(&mut self, topic: Arc<str>, at: SystemTime) {
        if self.range.contains(at) {
            self.left_out.add(LeftOutReason::OtherTopic, &topic);
        }
        if self.other_topics.len() < MAX_OTHER_TOPICS {
            self.other_topics.insert(topic);
        }
    }

    fn count_unread(&mut self, unread: Unread) {
        let Unread { at, topic, name, reason, details } = unread;
        self.latest = self.latest.max(at);
        if topic == self.topic {
            if self.range.contains(at) {
                let separator = if details.is_empty() { "" } else { ", " };
                self.left_out.add(reason, format_args!("{name}{separator}{details}"));
            }
        } else if reason == LeftOutReason::OtherType {
            if self.other_types.len() < MAX_OTHER_TOPICS {
                self.other_types.insert(name, details);
            }
        } else if topic.is_some() || *name == *Topic::Scans.name() {
            self.count_other_topic(name, at);
        }
    }

    /// Reads one record of the file, `Ok(None)` if it is no item of a recording. After an error other
    /// than [`RecordingError::Damaged`], no records follow.
    fn advance(&mut self) -> Option<Result<Option<Item>, RecordingError>> {
        let (kind, content, definitions) = match self.records.next() {
            Ok(Some(record)) => record,
            Ok(None) => {
                let opened = self.open_next().inspect_err(|_| self.further.clear());
                return opened.map(|is_opened| is_opened.then_some(None)).transpose();
            }
            Err(error) => {
                self.further.retain(|_| matches!(error, RecordingError::Damaged { .. }));
                return Some(Err(error));
            }
        };
        self.read_bytes = self.read_bytes.saturating_add(content.len());
        Some(Ok(match kind {
            kind::MESSAGE => messages::parse(content, definitions).map(|parsed| match parsed {
                Ok(record) => Item::Record(record),
                Err(unread) => Item::Unread(unread),
            }),
            kind::METADATA => parse_sensor_metadata(content).map(|metadata| {
                self.metadata = metadata;
                Item::Description(Stream::from_metadata(&self.metadata))
            }),
            _ => None,
        }))
    }

    pub(super) fn next_item(&mut self) -> Option<Result<Item, RecordingError>> {
        loop {
            let item = match self.ahead.pop_front() {
                None => self.advance()?.transpose(),
                item => item,
            };
            let Some(item) = item else { continue };
            let record = match item {
                Ok(Item::Record(record)) => record,
                Ok(Item::Description(_)) if self.topic.is_some() => continue,
                Ok(Item::Unread(unread)) => {
                    self.count_unread(unread);
                    continue;
                }
                _ => return Some(item),
            };
            self.latest = self.latest.max(record.at);
            if record.topic != self.topic {
                // The replies and events of a recording are no scans.
                if matches!(record.entry, Entry::Scan(_)) {
                    let name = record.topic.unwrap_or_else(|| Topic::Scans.name().into());
                    self.count_other_topic(name, record.at);
                }
                continue;
            }
            let is_version = self.range.see(&record);
            let is_inside = is_version || self.range.contains(record.at);
            if self.times.is_none()
                && let Some(times) = self.range.times()
            {
                let times = self.times.insert(times);
                if let Err(error) = self.records.leave_out_others(times) {
                    self.further.clear();
                    return Some(Err(error));
                }
            }
            if is_inside {
                return Some(Ok(Item::Record(record)));
            }
        }
    }
}

fn open(path: PathBuf) -> Result<File, RecordingError> {
    File::open(&path).map_err(RecordingError::open(path))
}

/// Part of a file that is read one by one.
pub(super) enum Item {
    Record(Record),
    /// Message that cannot be read. [`Recording::next_item`] counts it.
    Unread(Unread),
    /// Metadata of a sensor, with its stream.
    Description(Option<Stream>),
}

/// Parses the metadata of a recorded sensor, or returns `None` for other metadata.
pub(super) fn parse_sensor_metadata(content: &[u8]) -> Option<BTreeMap<String, String>> {
    let (_, pairs) = parse_metadata(content).filter(|(name, _)| *name == METADATA)?;
    let owned = |(key, value): (&str, &str)| (key.to_owned(), value.to_owned());
    Some(pairs.into_iter().map(owned).collect())
}

impl Iterator for Recording {
    type Item = Result<Record, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        std::iter::from_fn(|| self.next_item()).find_map(|item| match item {
            Ok(Item::Record(record)) => Some(Ok(record)),
            Ok(Item::Description(_) | Item::Unread(_)) => None,
            Err(error) => Some(Err(error)),
        })
    }
}

impl fmt::Debug for Recording {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Recording").field("metadata", &self.metadata).finish_non_exhaustive()
    }
}
