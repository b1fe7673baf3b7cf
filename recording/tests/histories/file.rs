//! Files of the histories: what an independent reader finds in them, and what damage costs.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use mcap::records::Record;

use super::foreign::letters;
use crate::raw::MAGIC;

/// Message, with all that names its topic and type.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Message {
    pub(super) log_time: u64,
    pub(super) topic: String,
    pub(super) publish_time: u64,
    pub(super) sequence: u32,
    pub(super) data: Vec<u8>,
}

impl Message {
    fn new(message: mcap::Message<'_>) -> Self {
        Self {
            log_time: message.log_time,
            topic: topic(&message.channel),
            publish_time: message.publish_time,
            sequence: message.sequence,
            data: message.data.into_owned(),
        }
    }

    /// Returns true for the sensor's version, which each file of a split recording repeats.
    pub(super) fn is_version(&self) -> bool {
        self.label() == Some(b"V\0")
    }

    /// Topic and frames of a message that a part begins with if it lies before the part.
    pub(super) fn latched(&self) -> Vec<(String, String)> {
        let is_latched = ["durability: 1\\n", "durability: transient_local"];
        if !is_latched.iter().any(|text| self.topic.contains(text)) {
            return Vec::new();
        }
        let has_frames = self.topic.contains(" tf2_msgs/msg/TFMessage ");
        let frames = if has_frames { letters(&self.data) } else { vec![String::new()] };
        let name = self.topic.split(' ').next().unwrap();
        frames.into_iter().map(|frame| (format!("{name} {has_frames}"), frame)).collect()
    }

    /// Returns true if the time of a part counts from here.
    pub(super) fn is_scan(&self) -> bool {
        let is_poll =
            self.label().is_some_and(|label| label.starts_with(b"G") && label.len() == 10);
        is_poll || self.is_laser_scan() && super::foreign::is_readable(&self.data)
    }

    /// A topic whose type was lost with a damaged part is taken for what its name says.
    pub(super) fn is_laser_scan(&self) -> bool {
        let is_of_type = self.topic.contains("sensor_msgs/msg/LaserScan") || self.has_lost_type();
        self.topic.starts_with("/scan cdr ") && is_of_type
    }

    pub(super) fn has_lost_type(&self) -> bool {
        self.topic.ends_with(' ')
    }

    pub(super) fn is_on_topic_of(&self, other: &Self) -> bool {
        let name = |message: &Self| message.topic.split(' ').next().map(str::to_owned);
        name(self) == name(other)
    }

    /// Returns the command that a reply of a sensor answers, with its NUL.
    fn label(&self) -> Option<&[u8]> {
        let data = Some(&self.data).filter(|_| self.topic.starts_with("/scip/replies cdr "))?;
        let length = u32::from_le_bytes(data.get(8..12)?.try_into().ok()?) as usize;
        data.get(12..12 + length)
    }
}

/// All that names a topic and its type.
fn topic(channel: &mcap::Channel<'_>) -> String {
    let schema = channel.schema.as_deref().map(schema).unwrap_or_default();
    let (encoding, metadata) = (&channel.message_encoding, &channel.metadata);
    format!("{} {encoding} {metadata:?} {schema}", channel.topic)
}

fn schema(schema: &mcap::Schema<'_>) -> String {
    format!("{} {} {}", schema.name, schema.encoding, crc32fast::hash(&schema.data))
}

/// Topics and types of a complete file, with and without messages.
pub(super) fn topics(file: &[u8]) -> BTreeSet<String> {
    let summary = mcap::Summary::read(file).unwrap().unwrap();
    let topics = summary.channels.values().map(|channel| topic(channel));
    topics.chain(summary.schemas.values().map(|known| schema(known))).collect()
}

/// Reads all messages of a complete file, in their order. Fails unless the index leads to the
/// same ones, and the times and counts of the index are right.
pub(super) fn read(file: &[u8]) -> Result<Vec<Message>, String> {
    let told = |error: mcap::McapError| format!("the other reader: {error}");
    let messages = mcap::MessageStream::new(file).map_err(told)?;
    let messages = messages.map(|message| message.map(Message::new).map_err(told));
    let messages: Vec<Message> = messages.collect::<Result<_, _>>()?;
    let summary = mcap::Summary::read(file).map_err(told)?.ok_or("no summary")?;
    let mut indexed = Vec::new();
    let chunks = summary.chunk_indexes.iter();
    // A chunk of definitions only has no index of messages.
    for chunk in chunks.filter(|chunk| !chunk.message_index_offsets.is_empty()) {
        let span = chunk.message_start_time..=chunk.message_end_time;
        let entries = summary.read_message_indexes(file, chunk).map_err(told)?;
        for entry in entries.values().flatten() {
            let message = summary.seek_message(file, chunk, entry).map_err(told)?;
            if !span.contains(&message.log_time) {
                return Err("a chunk has other times than its index says".to_owned());
            }
            indexed.push(Message::new(message));
        }
    }
    let count = summary.stats.ok_or("no statistics")?.message_count;
    if count != messages.len() as u64 {
        return Err(format!("the index counts {count} messages of {}", messages.len()));
    }
    let mut sorted = messages.clone();
    sorted.sort();
    indexed.sort();
    // A file without chunks has no index of its messages.
    if !summary.chunk_indexes.is_empty() && indexed != sorted {
        return Err("the index leads to other messages".to_owned());
    }
    Ok(messages)
}

/// Chunk of a file: its place, its messages, and its definitions of schemas and channels.
struct Chunk {
    place: Range<usize>,
    messages: Vec<(u16, Message)>,
    /// Kind and number of each.
    definitions: Vec<(u8, u16)>,
}

/// Layout of a complete file with chunks.
pub(super) struct Layout {
    chunks: Vec<Chunk>,
    /// Schema of each channel.
    schemas: BTreeMap<u16, u16>,
    summary: Range<usize>,
}

impl Layout {
    /// `messages` are the file's, in their order.
    pub(super) fn new(file: &[u8], messages: &[Message]) -> Self {
        let (mut at, mut chunks, mut schemas) = (MAGIC.len(), Vec::new(), BTreeMap::new());
        let mut messages = messages.iter();
        let mut summary = file.len();
        while at < file.len() - MAGIC.len() {
            let (kind, content) = split(&file[at..]);
            let place = at..at + 9 + content.len();
            at = place.end;
            if kind == 0x0f {
                summary = place.start;
            }
            let Record::Chunk { data, .. } = mcap::parse_record(kind, content).unwrap() else {
                continue;
            };
            let mut chunk = Chunk { place, messages: Vec::new(), definitions: Vec::new() };
            let mut rest = &data[..];
            while !rest.is_empty() {
                let (kind, content) = split(rest);
                match mcap::parse_record(kind, content).unwrap() {
                    Record::Schema { header, .. } => chunk.definitions.push((kind, header.id)),
                    Record::Channel(channel) => {
                        chunk.definitions.push((kind, channel.id));
                        schemas.insert(channel.id, channel.schema_id);
                    }
                    Record::Message { header, .. } => {
                        let message = messages.next().unwrap().clone();
                        chunk.messages.push((header.channel_id, message));
                    }
                    _ => {}
                }
                rest = &rest[9 + content.len()..];
            }
            chunks.push(chunk);
        }
        Self { chunks, schemas, summary: summary..file.len() }
    }

    /// Messages that must survive: in chunks without a changed byte, and with a definition in
    /// such a chunk before them, or in the index if `has_index`.
    pub(super) fn survivors(
        &self,
        is_hit: impl Fn(&Range<usize>) -> bool,
        has_index: bool,
    ) -> Vec<Message> {
        let has_index = has_index && !is_hit(&self.summary);
        let mut known: Vec<(u8, u16)> = Vec::new();
        let mut survivors = Vec::new();
        for chunk in self.chunks.iter().filter(|chunk| !is_hit(&chunk.place)) {
            known.extend(&chunk.definitions);
            let is_known = |channel: &u16| {
                let schema = self.schemas[channel];
                let has_schema = schema == 0 || known.contains(&(0x03, schema));
                has_index || known.contains(&(0x04, *channel)) && has_schema
            };
            let messages = chunk.messages.iter().filter(|(channel, _)| is_known(channel));
            survivors.extend(messages.map(|(_, message)| message.clone()));
        }
        survivors
    }
}

/// Returns the length of a complete file up to the end of its last chunk: without its index.
pub(super) fn chunks_end(file: &[u8]) -> usize {
    let (mut at, mut end) = (MAGIC.len(), 0);
    while at < file.len() - MAGIC.len() {
        let (kind, content) = split(&file[at..]);
        at += 9 + content.len();
        end = if kind == 0x06 { at } else { end };
    }
    end
}

/// Splits off a record: its kind and content.
fn split(bytes: &[u8]) -> (u8, &[u8]) {
    let length = u64::from_le_bytes(bytes[1..9].try_into().unwrap()) as usize;
    (bytes[0], &bytes[9..9 + length])
}
