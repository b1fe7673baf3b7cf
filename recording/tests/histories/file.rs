//! Files of the histories: what an independent reader finds in them, and what damage costs.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use mcap::records::{Metadata, Record};
use urg_recording::Compression;

use super::foreign::letters;
use crate::raw::MAGIC;

/// Length of the head of a chunk without compression.
pub(super) const CHUNK_HEAD: usize = 9 + 40;

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
        let label = self.label().and_then(|label| label.split(|byte| b";\0".contains(byte)).next());
        [Some(&b"V"[..]), Some(b"VV"), Some(b"PP")].contains(&label)
    }

    /// Topic and frames of a message that a part begins with if it lies before the part.
    pub(super) fn latched(&self) -> Vec<(String, String)> {
        let is_latched = ["durability: 1\\n", "durability: transient_local"];
        let has_profiles = self.topic.contains("\"offered_qos_profiles\": ");
        if !has_profiles || !is_latched.iter().any(|text| self.topic.contains(text)) {
            return Vec::new();
        }
        let has_frames = self.topic.contains(" tf2_msgs/msg/TFMessage ");
        let frames = if has_frames { letters(&self.data) } else { vec![String::new()] };
        let name = self.topic.split(' ').next().unwrap();
        frames.into_iter().map(|frame| (format!("{name} {has_frames}"), frame)).collect()
    }

    /// Returns true for the reply that tells what a sensor of SCIP 2 measures.
    pub(super) fn tells_sensor(&self) -> bool {
        self.label().is_some_and(|label| label.starts_with(b"PP"))
    }

    /// Returns true for a scan of SCIP 2 that only its sensor explains.
    pub(super) fn needs_sensor(&self) -> bool {
        self.is_scan() && self.label().is_some_and(|label| label.len() > 10)
    }

    /// Returns true if the other message differs in nothing but its type.
    pub(super) fn is_but_for_type(&self, other: &Self) -> bool {
        let content = |message: &Self| (message.log_time, message.publish_time, message.sequence);
        content(self) == content(other) && self.data == other.data && self.is_on_topic_of(other)
    }

    /// Returns true if the time of a part counts from here.
    pub(super) fn is_scan(&self) -> bool {
        // With its NUL, and in SCIP 2 with a label of eight characters.
        let is_request = self.label().is_some_and(|label| match label.first() {
            Some(b'G') => matches!(label.len(), 10 | 22),
            Some(b'M') => label.len() == 25,
            _ => false,
        });
        // The laser is off, or the scans of a stream follow. With a damaged echo it is a malformed scan.
        let echo = self.label().and_then(|label| label.strip_suffix(b"\0")).unwrap_or_default();
        let is_status = [b"\n10Q\n\n", b"\n00P\n\n"]
            .iter()
            .any(|status| self.data.ends_with(&[echo, &status[..]].concat()));
        is_request && !is_status || self.is_laser_scan() && super::foreign::is_readable(&self.data)
    }

    /// A topic whose type was lost with a damaged part is taken for what its name says.
    pub(super) fn is_laser_scan(&self) -> bool {
        let is_of_type = self.topic.contains("sensor_msgs/msg/LaserScan") || self.has_lost_type();
        self.topic.starts_with("/scan cdr ") && is_of_type
    }

    /// Returns true for a scan of this number of points, with or without intensities.
    pub(super) fn has_points(&self, points: usize) -> bool {
        [points, 2 * points].iter().any(|values| {
            let ranges = self.data.len().checked_sub(4 * values + 8);
            let length = ranges.and_then(|at| self.data.get(at..at + 4));
            length == Some(&(points as u32).to_le_bytes()[..])
        })
    }

    pub(super) fn has_lost_type(&self) -> bool {
        self.topic.ends_with(' ')
    }

    pub(super) fn is_on_topic_of(&self, other: &Self) -> bool {
        let name = |message: &Self| message.topic.split(' ').next().map(str::to_owned);
        name(self) == name(other)
    }

    /// Returns the command that a reply of a sensor answers, with its NUL. Damage may have changed its
    /// type: then it is no reply.
    fn label(&self) -> Option<&[u8]> {
        let is_of_type =
            self.topic.contains(" std_msgs/msg/UInt8MultiArray ") || self.has_lost_type();
        let is_reply = is_of_type && self.topic.starts_with("/scip/replies cdr ");
        let data = Some(&self.data).filter(|_| is_reply)?;
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

/// Returns a complete file without compression, which the other reader does not know. Its index must be
/// right.
#[cfg(feature = "compression")]
pub(super) fn plain(file: &[u8]) -> Cow<'_, [u8]> {
    use crate::recompress::{compressed, compressions};

    match compressions(file).iter().all(|name| name.is_empty()) {
        true => file.into(),
        false => compressed(file, "").into(),
    }
}

#[cfg(not(feature = "compression"))]
pub(super) fn plain(file: &[u8]) -> Cow<'_, [u8]> {
    file.into()
}

/// Returns a complete file without compression as one that has it.
#[cfg(feature = "compression")]
pub(super) fn compressed(file: &[u8], compression: Compression) -> Vec<u8> {
    match compression {
        Compression::Plain => file.to_vec(),
        _ => crate::recompress::compressed(file, &compression.to_string()),
    }
}

#[cfg(not(feature = "compression"))]
pub(super) fn compressed(file: &[u8], _compression: Compression) -> Vec<u8> {
    file.to_vec()
}

/// Records of a chunk without its compression.
#[cfg(feature = "compression")]
fn records(content: &[u8]) -> Vec<u8> {
    let (name, records) = crate::recompress::chunk(content);
    crate::recompress::decompress(name, records)
}

#[cfg(not(feature = "compression"))]
fn records(_content: &[u8]) -> Vec<u8> {
    unreachable!("a compressed chunk")
}

/// Topics and types of a complete file, with and without messages.
pub(super) fn topics(file: &[u8]) -> BTreeSet<String> {
    let summary = mcap::Summary::read(&plain(file)).unwrap().unwrap();
    let topics = summary.channels.values().map(|channel| topic(channel));
    topics.chain(summary.schemas.values().map(|known| schema(known))).collect()
}

/// Metadata of a complete file, in their order.
pub(super) fn metadata(file: &[u8]) -> Vec<Metadata> {
    let (mut rest, mut found) = (&file[MAGIC.len()..], Vec::new());
    loop {
        let (kind, content) = split(rest);
        rest = &rest[9 + content.len()..];
        match kind {
            0x0c => found.extend(metadata_of(content)),
            0x0f => return found,
            _ => {}
        }
    }
}

fn metadata_of(content: &[u8]) -> Option<Metadata> {
    match mcap::parse_record(0x0c, content).unwrap() {
        Record::Metadata(metadata) => Some(metadata),
        _ => None,
    }
}

fn told(error: mcap::McapError) -> String {
    format!("the other reader: {error}")
}

/// Reads all messages of a file with a complete end, in their order.
pub(super) fn messages(file: &[u8]) -> Result<Vec<Message>, String> {
    let file = plain(file);
    let messages = mcap::MessageStream::new(&file).map_err(told)?;
    messages.map(|message| message.map(Message::new).map_err(told)).collect()
}

/// Reads all messages of a complete file, in their order. Fails unless the index leads to the
/// same ones, and the times and counts of the index are right.
pub(super) fn read(file: &[u8]) -> Result<Vec<Message>, String> {
    let file = &plain(file);
    let messages = messages(file)?;
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

/// Definition or message of a file.
struct Part {
    /// Places in the file: it is lost if one of them is hit.
    places: Vec<Range<usize>>,
    content: Content,
}

enum Content {
    Schema(u16),
    /// Its number, and the number of its schema.
    Channel(u16, u16),
    Message(u16, Message),
}

/// Layout of a file with a complete end.
pub(super) struct Layout {
    parts: Vec<Part>,
    /// Metadata and their places.
    metadata: Vec<(Range<usize>, Metadata)>,
    /// Where records begin and end, in order.
    pub(super) boundaries: Vec<usize>,
    /// Where records of known kinds begin: a search finds no others.
    known: Vec<usize>,
    /// Places that no checksum covers and whose damage may change a message.
    unproved: Vec<Range<usize>>,
    /// Message indexes.
    indexes: Vec<Range<usize>>,
    /// Chunks, and where their records end.
    pub(super) chunks: Vec<(Range<usize>, usize)>,
    /// Heads of the chunks, with the names of their compressions.
    heads: Vec<Range<usize>>,
    pub(super) summary: Range<usize>,
    /// End of the first record of the summary.
    summary_begun: usize,
    /// True if a checksum of a file without chunks covers all bytes before the summary.
    pub(super) has_sum: bool,
}

impl Layout {
    /// `messages` are the file's, in their order.
    pub(super) fn new(file: &[u8], messages: &[Message]) -> Self {
        let mut layout = Self {
            parts: Vec::new(),
            metadata: Vec::new(),
            boundaries: vec![MAGIC.len()],
            known: Vec::new(),
            unproved: Vec::new(),
            indexes: Vec::new(),
            chunks: Vec::new(),
            heads: Vec::new(),
            summary: file.len()..file.len(),
            summary_begun: 0,
            has_sum: false,
        };
        let (mut at, mut messages) = (MAGIC.len(), messages.iter());
        while at < layout.summary.start {
            let (kind, content) = split(&file[at..]);
            let place = at..at + 9 + content.len();
            at = place.end;
            layout.boundaries.push(at);
            layout.known.extend((kind < 0x10).then_some(place.start));
            match mcap::parse_record(kind, content).unwrap() {
                Record::DataEnd(end) => {
                    layout.summary.start = place.start;
                    // One damaged byte makes a message of it.
                    layout.unproved.push(place.start..place.start + 1);
                    layout.has_sum = end.data_section_crc != 0 && layout.chunks.is_empty();
                }
                Record::Chunk { header, data } => {
                    let head_bytes = CHUNK_HEAD + header.compression.len();
                    let records = place.start + head_bytes + data.len();
                    layout.chunks.push((place.clone(), records));
                    let head = place.start..place.start + head_bytes;
                    layout.heads.push(head.clone());
                    let (mut inner, mut rest) = (head.end, &data[..]);
                    let is_proved = header.uncompressed_crc != 0;
                    if !is_proved {
                        layout.unproved.push(place.clone());
                    }
                    if !header.compression.is_empty() {
                        // Its records have no places of their own.
                        let records = self::records(content);
                        let mut rest = &records[..];
                        while !rest.is_empty() {
                            let (kind, content) = split(rest);
                            rest = &rest[9 + content.len()..];
                            layout.add(kind, content, vec![place.clone()], &mut messages);
                        }
                        continue;
                    }
                    while !rest.is_empty() {
                        let (kind, content) = split(rest);
                        let own = inner..inner + 9 + content.len();
                        inner = own.end;
                        layout.boundaries.push(inner);
                        layout.known.extend((kind < 0x10).then_some(own.start));
                        rest = &rest[9 + content.len()..];
                        let places =
                            if is_proved { vec![place.clone()] } else { vec![head.clone(), own] };
                        layout.add(kind, content, places, &mut messages);
                    }
                }
                Record::Metadata(metadata) => layout.metadata.push((place, metadata)),
                _ => {
                    // A message index with more fields looks like a message if its kind is damaged.
                    let is_grown_index =
                        || kind == 0x07 && content.len() != 6 + usize::from(content[2]);
                    if matches!(kind, 0x03..=0x05 | 0x10..) || is_grown_index() {
                        layout.unproved.push(place.clone());
                    }
                    if kind == 0x07 {
                        layout.indexes.push(place.clone());
                    }
                    layout.add(kind, content, vec![place], &mut messages);
                }
            }
        }
        layout.summary_begun = at + 9 + split(&file[at..]).1.len();
        layout.boundaries.sort_unstable();
        layout.known.sort_unstable();
        layout
    }

    fn add<'a>(
        &mut self,
        kind: u8,
        content: &[u8],
        places: Vec<Range<usize>>,
        messages: &mut impl Iterator<Item = &'a Message>,
    ) {
        let content = match mcap::parse_record(kind, content).unwrap() {
            Record::Schema { header, .. } => Content::Schema(header.id),
            Record::Channel(channel) => Content::Channel(channel.id, channel.schema_id),
            Record::Message { header, .. } => {
                Content::Message(header.channel_id, messages.next().unwrap().clone())
            }
            _ => return,
        };
        self.parts.push(Part { places, content });
    }

    /// Returns true if damage there may change messages without a trace.
    pub(super) fn is_unproved(&self, is_hit: impl Fn(&Range<usize>) -> bool) -> bool {
        self.unproved.iter().any(is_hit)
    }

    /// Returns what is lost with a record whose head is damaged at `at`, or has moved from there: all
    /// records that it reaches over if nothing in it shows its length.
    pub(super) fn swallowed(
        &self,
        whole: &[u8],
        damaged: &[u8],
        at: usize,
    ) -> Option<Range<usize>> {
        let start = *self.boundaries.iter().rev().find(|edge| **edge <= at)?;
        let (head, before) = (damaged.get(start..start + 9)?, whole.get(start..start + 9)?);
        let length = usize::try_from(u64::from_le_bytes(head[1..].try_into().unwrap())).ok()?;
        let end = length.checked_add(start + 9)?;
        let shift = whole.len() as isize - damaged.len() as isize;
        let ends = [end, end.saturating_add_signed(shift)];
        // Only a whole record may end where the file does, unless the magic bytes are there.
        let is_end = end == damaged.len() && !damaged.ends_with(MAGIC)
            || ends.iter().any(|end| self.begins(whole, *end));
        // Kinds of a summary, too, in the wrong place.
        let shows_no_length = matches!(head[0], 0x05 | 0x08 | 0x0a | 0x0b | 0x0d | 0x0e | 0x10..);
        (head != before && shows_no_length && is_end).then_some(start..end)
    }

    /// Returns true if a record begins here, also one of the summary of this file.
    fn begins(&self, file: &[u8], place: usize) -> bool {
        let mut at = self.summary.start;
        while at < place && at + MAGIC.len() < file.len() {
            at += 9 + split(&file[at..]).1.len();
        }
        at == place || self.boundaries.contains(&place)
    }

    /// Returns true if nothing shows that there is a chunk: damage has struck its head twice, or its head
    /// and the record before it. Before the first chunk, any record may become a message, of a file
    /// without chunks. A message index may become one, too, if it is struck twice: its kind, and the
    /// fields that show what it was.
    pub(super) fn hides_kind(&self, struck: &[Range<usize>]) -> bool {
        let count = |place: Range<usize>| {
            struck.iter().filter(|hit| hit.start < place.end && place.start < hit.end).count()
        };
        let is_hidden = |index: &Range<usize>| {
            count(index.start..index.start + 1) > 0 && count(index.clone()) > 1
        };
        self.indexes.iter().any(is_hidden)
            || self.heads.iter().enumerate().any(|(number, head)| {
                let before = self.boundaries.iter().rev().find(|edge| **edge < head.start);
                let before = before.filter(|_| number > 0).map_or(0, |edge| *edge);
                count(head.clone()) > 0 && count(before..head.end) > 1
            })
    }

    /// Metadata that must survive.
    pub(super) fn metadata(&self, is_hit: impl Fn(&Range<usize>) -> bool) -> Vec<Metadata> {
        let left = self.metadata.iter().filter(|(place, metadata)| {
            let pairs = metadata.metadata.iter().map(|(key, value)| 8 + key.len() + value.len());
            let has_more = place.len() > 9 + 8 + metadata.name.len() + pairs.sum::<usize>();
            !(is_hit(place) || has_more && self.is_between(place, &is_hit))
        });
        left.map(|(_, metadata)| metadata.clone()).collect()
    }

    /// Returns true for one or two records between two damaged ones: only other records after one show
    /// that it begins there if its lengths do not.
    fn is_between(&self, own: &Range<usize>, is_hit: impl Fn(&Range<usize>) -> bool) -> bool {
        let edge = |edges: &[usize], start: usize, by: isize| {
            let at = edges.partition_point(|edge| *edge < start) as isize + by;
            edges[at.clamp(0, edges.len() as isize - 1) as usize]
        };
        // With the bytes that are inserted between records.
        let before =
            |count: isize| is_hit(&(edge(&self.known, own.start, -count) - 1..own.start + 1));
        let edges = [&self.boundaries[..], &[self.summary_begun]].concat();
        let after = |count: isize| is_hit(&(own.end - 1..edge(&edges, own.end, count) + 1));
        before(1) && after(2) || before(2) && after(1)
    }

    /// Messages that must survive: not hit, and with a definition that is not hit before them, or
    /// in the index if `has_index`.
    pub(super) fn survivors(
        &self,
        is_hit: impl Fn(&Range<usize>) -> bool,
        has_index: bool,
    ) -> Vec<Message> {
        // Without a checksum, a damaged definition may look like another one.
        let is_loose = self.is_unproved(&is_hit);
        let has_index = has_index && !is_hit(&self.summary) && !is_loose;
        let (mut schemas, mut channels) = (Vec::new(), BTreeMap::new());
        let mut survivors = Vec::new();
        for part in &self.parts {
            let unproved = part.places.last().filter(|own| {
                self.unproved.iter().any(|place| place.start <= own.start && own.end <= place.end)
            });
            let is_lost = part.places.iter().any(&is_hit)
                || unproved.is_some_and(|own| self.is_between(own, &is_hit));
            match &part.content {
                Content::Schema(schema) if !is_lost => schemas.push(*schema),
                Content::Channel(channel, schema) if !is_lost => {
                    channels.insert(*channel, *schema);
                }
                // What it became may define any number again.
                Content::Schema(_) if is_loose => schemas.clear(),
                Content::Channel(..) if is_loose => channels.clear(),
                Content::Message(channel, message) if !is_lost => {
                    let schema = channels.get(channel);
                    let is_known = |schema: &u16| *schema == 0 || schemas.contains(schema);
                    if has_index || schema.is_some_and(is_known) {
                        survivors.push(message.clone());
                    }
                }
                _ => {}
            }
        }
        survivors
    }
}

/// Returns the length of a complete file up to the end of its last chunk, or without a chunk of its
/// definitions: without its index.
pub(super) fn chunks_end(file: &[u8]) -> usize {
    let (mut at, mut end) = (MAGIC.len(), 0);
    while at < file.len() - MAGIC.len() {
        let (kind, content) = split(&file[at..]);
        at += 9 + content.len();
        match kind {
            0x01 | 0x03 | 0x04 | 0x06 => end = at,
            0x0f => break,
            _ => {}
        }
    }
    end
}

/// Splits off a record: its kind and content.
pub(super) fn split(bytes: &[u8]) -> (u8, &[u8]) {
    let length = u64::from_le_bytes(bytes[1..9].try_into().unwrap()) as usize;
    (bytes[0], &bytes[9..9 + length])
}
