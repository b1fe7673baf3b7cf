//! [`repair`]: makes a complete file from a damaged or cut-off one, without a replay.

use std::io::{self, Read, Write};
use std::ops::AddAssign;

use super::RecordingError;
use super::mcap::{
    Fields, FileError, Input, McapWriter, MessageHeader, Section, Sections, header, is_well_formed,
    kind, split_record,
};
use super::messages::{Messages, parse_channel};
use super::record::Entry;

/// Outcome of [`repair`].
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Repaired {
    /// True if the end of the file was missing or damaged. Other readers need the end, an index, to
    /// find the messages.
    pub was_truncated: bool,
    /// Number of messages copied.
    pub messages: u64,
    /// Number of scans among them.
    pub scans: u64,
    /// Number of damaged parts left out. Each is a chunk, about a second of a recording, or the
    /// malformed records of a chunk without a checksum.
    pub damaged_parts: u64,
    /// Positions of the first damaged parts in the file, at most 16.
    pub damaged_at: Vec<u64>,
}

/// Number of positions of damage to keep.
const MAX_PLACES: usize = 16;

impl Repaired {
    fn add_damage(&mut self, offset: u64) {
        self.damaged_parts += 1;
        if self.damaged_at.len() < MAX_PLACES {
            self.damaged_at.push(offset);
        }
    }
}

/// Copies a damaged or cut-off recording to `output` as a complete file, which other readers can
/// open.
///
/// Copies all messages that [`Recording`](super::Recording) reads, of all topics, byte for byte and
/// with their times. Builds a new index. Leaves out damaged parts, attachments and non-standard
/// records. Also copies a complete file. Compressed chunks become plain ones. The copy has at most
/// eight times the bytes of the input without compression, plus 8 KiB: a hostile file makes the most
/// of small records.
///
/// Blocks the thread. Needs memory for the longest chunk, plus 100 bytes for each chunk.
///
/// # Errors
///
/// Fails with [`RecordingError::NotMcap`] if the input is no recording,
/// [`RecordingError::Compressed`] if this build does not read its compression,
/// [`RecordingError::Read`] if reading it fails, and
/// [`RecordingError::Write`] if writing the output fails. The output is then incomplete.
///
/// ```no_run
/// use std::fs::File;
///
/// let repaired = urg_recording::repair(File::open("cut.mcap")?, File::create_new("whole.mcap")?)?;
/// println!("{} damaged parts left out", repaired.damaged_parts);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn repair(
    input: impl Read + Send + 'static,
    output: impl Write,
) -> Result<Repaired, RecordingError> {
    let mut sections = Sections::new(Input::Stream(Box::new(input)));
    let mut repaired = Repaired::default();
    // The header comes first. Write nothing before the input is known to be a recording.
    let mut next = next_section(&mut sections, &mut repaired)?;
    let header = match &next {
        Some(Section::Record { kind: kind::HEADER, content }) => {
            sections.bytes(content.clone()).to_vec()
        }
        _ => header("ros2", ""),
    };
    let writer = McapWriter::start_copy(output, &header).map_err(RecordingError::write)?;
    let mut copy = Copy { writer, messages: Messages::default(), count: Count::default() };
    while let Some(section) = next {
        if !copy.section(&sections, section).map_err(RecordingError::write)? {
            repaired.add_damage(sections.offset());
        }
        next = next_section(&mut sections, &mut repaired)?;
    }
    copy.writer.finish().map_err(RecordingError::write)?;
    repaired.was_truncated = sections.is_truncated();
    repaired.messages = copy.count.messages;
    repaired.scans = copy.count.scans;
    Ok(repaired)
}

/// Reads the next undamaged section.
fn next_section(
    sections: &mut Sections,
    repaired: &mut Repaired,
) -> Result<Option<Section>, RecordingError> {
    loop {
        match sections.next() {
            Err(FileError::Damaged { offset, .. }) => {
                repaired.add_damage(offset);
            }
            outcome => return outcome.map_err(RecordingError::from),
        }
    }
}

/// Copy in progress. Each method returns false if it left out something malformed.
struct Copy<W> {
    writer: McapWriter<W>,
    messages: Messages,
    /// What was copied.
    count: Count,
}

/// Number of messages, and of the scans among them.
#[derive(Debug, Clone, Copy, Default)]
struct Count {
    messages: u64,
    scans: u64,
}

impl AddAssign for Count {
    fn add_assign(&mut self, other: Self) {
        self.messages += other.messages;
        self.scans += other.scans;
    }
}

impl<W: Write> Copy<W> {
    fn section(&mut self, sections: &Sections, section: Section) -> io::Result<bool> {
        match section {
            Section::Chunk { record, records } => {
                let content = sections.bytes(records);
                match self.count_if_whole(content) {
                    Some(count) => {
                        self.add_lost_types(content);
                        self.writer.copy_chunk(sections.bytes(record), content)?;
                        self.count += count;
                        Ok(true)
                    }
                    // The records of a chunk without a checksum may not add up.
                    None => {
                        let (is_right, rest) = self.records(content)?;
                        Ok(is_right && rest.is_empty())
                    }
                }
            }
            // A cut-off last record is not damage.
            Section::CutChunk { records } => {
                self.records(sections.bytes(records)).map(|(is_right, _)| is_right)
            }
            Section::Record { kind, content } => self.record(kind, sections.bytes(content)),
        }
    }

    /// Counts the messages of a chunk. Returns `None` unless the chunk consists of whole,
    /// well-formed records that are allowed in it.
    fn count_if_whole(&mut self, mut records: &[u8]) -> Option<Count> {
        let mut count = Count::default();
        while let Some((kind, content, after)) = split_record(records) {
            if kind == kind::METADATA {
                return None;
            }
            count += self.count_if_right(kind, content)?;
            records = after;
        }
        records.is_empty().then_some(count)
    }

    /// Judges a record as the reader does, remembers its definitions, and counts it if it is a
    /// message. Returns `None` if it is malformed.
    fn count_if_right(&mut self, kind: u8, content: &[u8]) -> Option<Count> {
        if !is_well_formed(kind, content) {
            return None;
        }
        self.messages.define(kind, content);
        if kind != kind::MESSAGE {
            return Some(Count::default());
        }
        let record = self.messages.parse(content).ok()?;
        let is_scan = record.is_some_and(|record| matches!(record.entry, Entry::Scan(_)));
        Some(Count { messages: 1, scans: is_scan.into() })
    }

    /// Writes the message types that were lost with a damaged part: other readers need them for the
    /// channels of a recording.
    fn add_lost_types(&mut self, mut records: &[u8]) {
        while let Some((kind, content, after)) = split_record(records) {
            if kind == kind::CHANNEL {
                self.add_lost_type(content);
            }
            records = after;
        }
    }

    fn add_lost_type(&mut self, channel: &[u8]) {
        let Some((_, schema, Some(topic))) = parse_channel(channel) else { return };
        if schema == topic.schema() && self.messages.add_type(schema, topic) {
            let message = topic.message_type();
            self.writer.add_schema(schema, message.name(), message.definition());
        }
    }

    /// Copies records. Also returns the bytes after the last whole one.
    fn records<'a>(&mut self, mut records: &'a [u8]) -> io::Result<(bool, &'a [u8])> {
        let mut is_right = true;
        while let Some((kind, content, after)) = split_record(records) {
            is_right &= self.record(kind, content)?;
            records = after;
        }
        Ok((is_right, records))
    }

    fn record(&mut self, kind: u8, content: &[u8]) -> io::Result<bool> {
        let Some(count) = self.count_if_right(kind, content) else { return Ok(false) };
        match kind {
            kind::SCHEMA => self.writer.declare(kind, content),
            kind::CHANNEL => {
                self.add_lost_type(content);
                self.writer.declare(kind, content);
            }
            kind::METADATA => {
                if let Some(name) = Fields(content).string() {
                    self.writer.copy_metadata(name, content)?;
                }
            }
            kind::MESSAGE => {
                if let Some((header, data)) = MessageHeader::parse(content) {
                    self.writer.message(header, data)?;
                    self.count += count;
                }
            }
            _ => {}
        }
        Ok(true)
    }
}
