//! [`cut`] and [`repair`]: copy the messages of recordings into one file, byte for byte. Only the
//! numbers of schemas and channels are new, so that no two topics share one.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};
use std::io::{Read, Write};
use std::ops::RangeBounds;
use std::sync::Arc;
use std::time::Duration;

use super::RecordingError;
use super::latched::{Latched, LatchedMessage, LatchedTopic};
use super::mcap::{Compression, McapWriter, MessageHeader, Records, header, kind, parse_metadata};
use super::messages::{lost_schema, parse, time};
use super::polls::StreamPolls;
use super::range::TimeRange;
use super::reader::parse_sensor_metadata;
use super::record::{Entry, Record, Topic};
use super::reply::ReplyKind;
use super::stream::Stream;

/// Time span of a chunk in the copy: about a second of messages, as in a recording.
const CHUNK_SPAN: u64 = 1_000_000_000;
/// Number of positions of damage to keep.
const MAX_PLACES: usize = 16;
/// Metadata to keep in memory until the next message of their file shows where they belong.
const MAX_METADATA_BYTES: usize = 1 << 20;

/// Outcome of [`cut`] and [`repair`].
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Copied {
    /// Number of messages copied.
    pub messages: u64,
    /// Number of scans in the copy, as [`Recording::scans`](super::Recording::scans) returns them.
    pub scans: u64,
    /// Number of damaged parts left out. Each is a chunk, about a second of a recording, the
    /// malformed records of a chunk without a checksum, a record outside of chunks, or stray bytes.
    pub damaged_parts: u64,
    /// Positions of the first damaged parts in their file, at most 16.
    pub damaged_at: Vec<u64>,
    /// True if the end of a file was missing or damaged: the index, which other readers need.
    pub was_truncated: bool,
}

impl Copied {
    /// Counts a damaged part, unless it is known.
    fn add_damage(&mut self, offset: Option<u64>) {
        self.damaged_parts += u64::from(offset.is_some());
        if self.damaged_at.len() < MAX_PLACES {
            self.damaged_at.extend(offset);
        }
    }
}

/// Copies the part of a recording in `range`, counted from the first scan, to `output`. Pass all
/// files of a split recording as `inputs`, in any order: messages are copied in the order of their
/// log times, and those of one file in the order of the file.
///
/// Copies the messages of all topics with their bytes, times and sequence numbers. Gives channels and schemas new
/// numbers, and keeps those without a message. Copies metadata, but no attachments and no private records.
///
/// Three things are copied even if they lie before the part: the metadata and the sensor's version, so that you can
/// replay the copy; and the last message of each topic that ROS 2 latches (durability `transient_local` in the
/// channel's `offered_qos_profiles`), such as a map. Of transforms, it is the last one of each child frame, because
/// `/tf_static` has several publishers. The messages get the log time of the part's first message.
///
/// Only a checksum proves a message: a damaged one outside of chunks, or in a chunk without a checksum,
/// may be copied with its changes. A record whose kind was damaged may look like one of a later version
/// of the format, and is skipped. Fields of later versions are not copied.
///
/// Joined recordings of two sensors of SCIP 2 that ran at once, with the same window of steps, read as one
/// sensor: of the later description. Keep these apart.
///
/// Leaves out damaged parts, and builds a new index. If `compression` is `None`, the copy keeps the compression of
/// the inputs (the strongest that this build [writes](Compression::is_written)). It has at most eight times the
/// bytes of the inputs without compression, plus 8 KiB: a hostile file makes the most of small records.
///
/// Blocks the thread, and reads all inputs to their end. Needs memory for the longest chunk of each
/// input, once more if the copy is compressed, 64 MiB for the index of the copy, up to 64 MiB of latched
/// messages, and the definitions of message types: up to 64 MiB for each input, and twice for the copy.
/// What does not fit counts as damage. A copy whose index would be longer has none: its chunks have about
/// a second of messages, and 768 KiB once the index has 8 MiB.
///
/// Definitions that were lost with a damaged part are taken from the index if the input is a
/// [`File`](std::fs::File). Without it, messages of recordings keep their type, and others have none.
/// Messages whose channel is lost are left out.
///
/// # Errors
///
/// Fails with [`RecordingError::NotMcap`] if an input is no recording,
/// [`RecordingError::Compressed`] if this build does not read its compression,
/// [`RecordingError::NotWritten`] if it does not write `compression`, [`RecordingError::Read`] if reading
/// fails, and [`RecordingError::Write`] if writing does. The output is then incomplete.
///
/// ```no_run
/// use std::{fs::File, time::Duration};
/// use urg_recording::cut;
///
/// let files = [File::open("run.mcap")?, File::open("run_0002.mcap")?];
/// let from = Duration::from_secs(3500);
/// cut(files, from..from + Duration::from_secs(200), None, File::create_new("part.mcap")?)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn cut<R: Read + Send + 'static>(
    inputs: impl IntoIterator<Item = R>,
    range: impl RangeBounds<Duration>,
    compression: Option<Compression>,
    output: impl Write,
) -> Result<Copied, RecordingError> {
    cut_topic(inputs, Topic::Scans.name(), range, compression, output)
}

/// Does the same as [`cut`], but counts the scans of `topic` and the times since its first one, for a bag
/// of other scanners: see [`Recording::topic`](super::Recording::topic).
///
/// # Errors
///
/// The same as for [`cut`].
pub fn cut_topic<R: Read + Send + 'static>(
    inputs: impl IntoIterator<Item = R>,
    topic: &str,
    range: impl RangeBounds<Duration>,
    compression: Option<Compression>,
    output: impl Write,
) -> Result<Copied, RecordingError> {
    compression.unwrap_or_default().check()?;
    let mut outcome = Copied::default();
    let source = |input| Source { records: Records::new(input), ..Source::default() };
    let mut sources: Vec<Source> = inputs.into_iter().map(source).collect();
    let mut queue = BinaryHeap::new();
    // Before anything is written, each input is known to be a recording.
    for (number, source) in sources.iter_mut().enumerate() {
        source.advance(&mut outcome)?;
        queue.push(Reverse((source.time, number)));
    }
    let first = queue.peek().and_then(|Reverse((_, number))| sources.get_mut(*number));
    let head = first.and_then(|source| source.header.take()).unwrap_or_else(|| header("ros2", ""));
    let known = sources.iter().map(Source::compression).max().unwrap_or_default();
    let mut copy = Copy {
        writer: McapWriter::start_copy(output, &head, compression.unwrap_or(known))
            .map_err(RecordingError::write)?,
        keeps_compression: compression.is_none(),
        range: TimeRange::new(&range),
        topic: (topic != Topic::Scans.name()).then(|| topic.into()),
        identity: BTreeMap::new(),
        latched: Latched::default(),
        metadata: None,
        chunk_began: None,
        polls: StreamPolls::default(),
        outcome,
    };
    while let Some(Reverse((_, number))) = queue.pop() {
        let Some(source) = sources.get_mut(number) else { continue };
        copy.step(number, source).map_err(RecordingError::write)?;
        if source.is_over {
            // The channels and schemas that have no message in the copy.
            if !source.records.definitions.write_rest(lost_schema, &mut copy.writer) {
                copy.outcome.add_damage(source.records.report_damage());
            }
        } else {
            source.advance(&mut copy.outcome)?;
            queue.push(Reverse((source.time, number)));
        }
    }
    copy.count_scans(true);
    // Makes room for the index.
    drop(sources);
    copy.writer.end().map_err(RecordingError::write)?;
    Ok(copy.outcome)
}

/// Copies a damaged or cut-off recording to `output` as a complete file, which other readers can
/// open. Does the same as [`cut`] with one input and without limits.
///
/// # Errors
///
/// The same as for [`cut`].
pub fn repair(
    input: impl Read + Send + 'static,
    output: impl Write,
) -> Result<Copied, RecordingError> {
    cut([input], .., None, output)
}

/// Input of a copy, read up to its next message.
#[derive(Default)]
struct Source {
    records: Records,
    /// Content of the file's header.
    header: Option<Vec<u8>>,
    /// Metadata before the next message.
    metadata: Vec<Vec<u8>>,
    /// Content of the next message.
    message: Option<Vec<u8>>,
    /// Log time of the next message, or of the previous one if metadata come first.
    time: u64,
    is_over: bool,
}

impl Source {
    /// Reads up to the next message.
    fn advance(&mut self, outcome: &mut Copied) -> Result<(), RecordingError> {
        let mut metadata_bytes = 0;
        while metadata_bytes <= MAX_METADATA_BYTES {
            let (kind, content, _) = match self.records.next() {
                Ok(Some(record)) => record,
                Ok(None) => {
                    outcome.was_truncated |= self.records.is_truncated;
                    self.is_over = true;
                    return Ok(());
                }
                Err(RecordingError::Damaged { offset, .. }) => {
                    outcome.add_damage(Some(offset));
                    continue;
                }
                Err(error) => return Err(error),
            };
            match kind {
                kind::HEADER => drop(self.header.get_or_insert_with(|| content.to_vec())),
                kind::METADATA => {
                    metadata_bytes += content.len();
                    self.metadata.push(content.to_vec());
                }
                kind::MESSAGE => {
                    self.time =
                        MessageHeader::parse(content).map_or(0, |(header, _)| header.log_time);
                    self.message = Some(content.to_vec());
                    return Ok(());
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Strongest compression of its chunks so far that this build writes.
    fn compression(&self) -> Compression {
        let mut known = self.records.chunk_bytes.compressions.iter();
        known.rfind(|known| known.is_written()).copied().unwrap_or_default()
    }
}

/// Copy in progress.
struct Copy<W> {
    writer: McapWriter<W>,
    keeps_compression: bool,
    range: TimeRange,
    /// Topic of the scans to count, as in [`Record`].
    topic: Option<Arc<str>>,
    /// Latest successful replies that identify the sensor, and the numbers of their sources.
    identity: BTreeMap<ReplyKind, (usize, MessageHeader, Vec<u8>)>,
    /// Latched messages before the part, until it begins.
    latched: Latched,
    /// Latest metadata of a recording, and its source: each file of a split recording repeats it.
    metadata: Option<(usize, Vec<u8>)>,
    /// Time of the first message in the open chunk, once the part has begun.
    chunk_began: Option<u64>,
    /// Counts the scans as a reader of the copy does.
    polls: StreamPolls,
    outcome: Copied,
}

impl<W: Write> Copy<W> {
    /// Copies the metadata and the message that a source has read, if they belong to the part.
    fn step(&mut self, number: usize, source: &mut Source) -> std::io::Result<()> {
        for content in std::mem::take(&mut source.metadata) {
            let Some((name, _)) = parse_metadata(&content) else { continue };
            if let Some(metadata) = parse_sensor_metadata(&content) {
                let known = self.metadata.as_ref().filter(|(source, _)| *source != number);
                if known.is_some_and(|(_, known)| *known == content) {
                    continue;
                }
                let stream = Stream::from_metadata(&metadata);
                if stream.as_ref().is_some_and(|stream| stream.model.0.is_some()) {
                    // Otherwise it would follow the metadata in the copy, and count as the later one.
                    self.identity.remove(&ReplyKind::Parameters);
                }
                self.polls.describe(stream.filter(|_| self.topic.is_none()));
                // Of the first description, whatever follows.
                self.count_scans(false);
                self.metadata = Some((number, content.clone()));
            }
            self.writer.metadata(name, &content)?;
        }
        let Some(content) = source.message.take() else { return Ok(()) };
        if self.keeps_compression {
            // The first chunk may be one that does not get shorter.
            self.writer.compression = self.writer.compression.max(source.compression());
        }
        let Some((mut header, data)) = MessageHeader::parse(&content) else { return Ok(()) };
        let record = parse(&content, &source.records.definitions).and_then(Result::ok);
        let identity = record.as_ref().and_then(|record| match &record.entry {
            Entry::Reply(reply) => reply.identity(),
            _ => None,
        });
        let record = record.filter(|record| record.topic == self.topic);
        if let Some(record) = &record {
            self.range.see(record);
        }
        let at = time(header.log_time);
        let is_inside = self.range.contains(at);
        let known = identity.and_then(|kind| self.identity.get(&kind));
        // Each file of a split recording begins with them.
        if known.is_some_and(|(source, known, bytes)| {
            *source != number && known.publish_time == header.publish_time && bytes == data
        }) {
            return Ok(());
        }
        let is_early = self.chunk_began.is_none() && self.range.begins_after(at);
        let definitions = &mut source.records.definitions;
        let channel = is_early.then(|| definitions.channel(header.channel)).flatten();
        let latched = channel.as_ref().and_then(LatchedTopic::of_channel);
        if !is_inside && identity.is_none() && latched.is_none() {
            return Ok(());
        }
        let Some(channel) =
            definitions.write_channel(header.channel, lost_schema, &mut self.writer)
        else {
            self.outcome.add_damage(source.records.report_damage());
            return Ok(());
        };
        header.channel = channel;
        if let Some(topic) = latched {
            if !self.latched.keep(&topic, header, data, record) {
                self.outcome.add_damage(source.records.report_damage());
            }
            return Ok(());
        }
        if let Some(kind) = identity {
            self.identity.insert(kind, (number, header, data.to_vec()));
            if !is_inside {
                record.into_iter().for_each(|record| self.polls.add(record));
                return Ok(());
            }
        }
        if self.chunk_began.is_none() {
            let log_time = header.log_time;
            let known = std::mem::take(&mut self.identity);
            for (_, (_, header, data)) in known.iter().filter(|(kind, _)| Some(**kind) != identity)
            {
                self.message(MessageHeader { log_time, ..*header }, data, None)?;
            }
            self.identity = known;
            for latched in std::mem::take(&mut self.latched).into_messages() {
                let LatchedMessage { header, data, record, .. } = latched;
                self.message(MessageHeader { log_time, ..header }, &data, record)?;
            }
        }
        self.message(header, data, record)
    }

    fn message(
        &mut self,
        header: MessageHeader,
        data: &[u8],
        record: Option<Record>,
    ) -> std::io::Result<()> {
        let began = *self.chunk_began.get_or_insert(header.log_time);
        let is_long = header.log_time.saturating_sub(began) >= CHUNK_SPAN;
        if is_long && self.writer.has_short_index() {
            self.writer.flush()?;
            self.chunk_began = Some(header.log_time);
        }
        self.outcome.messages += 1;
        record.into_iter().for_each(|record| self.polls.add(record));
        self.count_scans(false);
        self.writer.message(header, data)
    }

    fn count_scans(&mut self, is_end: bool) {
        while let Some(poll) = self.polls.next(is_end) {
            self.outcome.scans += u64::from(poll.stream_values().is_some());
        }
    }
}
