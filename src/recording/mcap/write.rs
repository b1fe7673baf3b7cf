//! [`McapWriter`]: appends records to a file. Nothing that was written is ever
//! changed, so whatever ends the program, the file is whole up to its last chunk.

use std::collections::BTreeMap;
use std::io::{self, Write};

use super::{Fields, MAGIC, MessageHeader, RECORD_HEAD, kind, put_bytes, put_record};

/// A chunk of about this size is written without waiting for its end.
const CHUNK_BYTES: usize = 768 << 10;
/// A chunk's record up to its records: head, start, end, size, CRC, the empty
/// name of no compression, length.
const CHUNK_HEAD: usize = RECORD_HEAD + 8 + 8 + 8 + 4 + 4 + 8;
/// The index of so many chunks is kept, 100 bytes each: 7 MB. At a chunk each
/// second that is 18 hours.
pub(in super::super) const MAX_CHUNKS: usize = 1 << 16;

/// Writes an MCAP file without compression.
pub(in super::super) struct McapWriter<W> {
    out: W,
    /// The bytes written.
    offset: u64,
    chunk: OpenChunk,
    index: Index,
    /// The summary of more chunks than this is left out: such a file can be read,
    /// though not searched.
    max_chunks: usize,
}

/// The chunk that grows in memory.
#[derive(Default)]
struct OpenChunk {
    /// Its record from its beginning; its head is filled in at the end.
    record: Vec<u8>,
    messages: ChunkMessages,
}

/// The messages of a chunk: their times, and their places among its records.
#[derive(Default)]
struct ChunkMessages {
    span: Option<(u64, u64)>,
    channels: BTreeMap<u16, Vec<(u64, u64)>>,
}

/// The content of the summary.
#[derive(Default)]
struct Index {
    /// The latest schema and channel of each number, as records.
    schemas: BTreeMap<u16, Vec<u8>>,
    channels: BTreeMap<u16, Vec<u8>>,
    /// One record for each chunk.
    chunk_indexes: Vec<u8>,
    metadata_indexes: Vec<u8>,
    chunks: usize,
    metadata: u32,
    span: Option<(u64, u64)>,
    messages: BTreeMap<u16, u64>,
}

impl ChunkMessages {
    fn add(&mut self, header: MessageHeader, place: usize) {
        self.span = Some(extend(self.span, header.log_time, header.log_time));
        self.channels.entry(header.channel).or_default().push((header.log_time, place as u64));
    }
}

fn extend(span: Option<(u64, u64)>, from: u64, to: u64) -> (u64, u64) {
    span.map_or((from, to), |(start, end)| (start.min(from), end.max(to)))
}

impl<W: Write> McapWriter<W> {
    /// Starts a file. `header` is the content of its header record, as
    /// [`header`] makes it.
    pub(in super::super) fn start(
        mut out: W,
        header: &[u8],
        max_chunks: usize,
    ) -> io::Result<Self> {
        let mut head = MAGIC.to_vec();
        put_record(&mut head, kind::HEADER, |out| out.extend_from_slice(header));
        out.write_all(&head)?;
        let (chunk, index) = (OpenChunk::default(), Index::default());
        Ok(Self { out, offset: head.len() as u64, chunk, index, max_chunks })
    }

    /// Returns the bytes of the file up to now, with the open chunk.
    pub(in super::super) fn len(&self) -> u64 {
        self.offset + self.chunk.record.len() as u64
    }

    /// Returns the number of chunks written.
    pub(in super::super) fn chunks(&self) -> usize {
        self.index.chunks
    }

    /// Declares a channel, and its message type.
    pub(in super::super) fn add_channel(
        &mut self,
        id: u16,
        topic: &str,
        message: &str,
        definition: &str,
    ) {
        // 0 is reserved for "no schema".
        let schema = id + 1;
        let mut content = schema.to_le_bytes().to_vec();
        put_bytes(&mut content, message.as_bytes());
        put_bytes(&mut content, b"ros2msg");
        put_bytes(&mut content, definition.as_bytes());
        self.declare(kind::SCHEMA, &content);
        let mut content = id.to_le_bytes().to_vec();
        content.extend_from_slice(&schema.to_le_bytes());
        put_bytes(&mut content, topic.as_bytes());
        put_bytes(&mut content, b"cdr");
        put_bytes(&mut content, b"");
        self.declare(kind::CHANNEL, &content);
    }

    /// Writes a schema or a channel, as the content of its record, unless it was
    /// written before.
    pub(in super::super) fn declare(&mut self, kind: u8, content: &[u8]) {
        // Begun first: a chunk begins with the channels known before.
        self.chunk.begin(&self.index);
        if let Some(record) = self.index.declare(kind, content) {
            self.chunk.record.extend_from_slice(record);
        }
    }

    /// Adds a message to the open chunk.
    pub(in super::super) fn message(
        &mut self,
        header: MessageHeader,
        data: &[u8],
    ) -> io::Result<()> {
        if self.chunk.record.len() + data.len() > CHUNK_BYTES {
            self.end_chunk()?;
        }
        self.chunk.begin(&self.index);
        self.chunk.messages.add(header, self.chunk.record.len() - CHUNK_HEAD);
        put_record(&mut self.chunk.record, kind::MESSAGE, |out| {
            out.reserve(MessageHeader::BYTES + data.len());
            out.extend_from_slice(&header.channel.to_le_bytes());
            out.extend_from_slice(&header.sequence.to_le_bytes());
            out.extend_from_slice(&header.log_time.to_le_bytes());
            out.extend_from_slice(&header.publish_time.to_le_bytes());
            out.extend_from_slice(data);
        });
        Ok(())
    }

    /// Writes a metadata record.
    pub(in super::super) fn metadata(
        &mut self,
        name: &str,
        map: &BTreeMap<String, String>,
    ) -> io::Result<()> {
        let mut content = Vec::new();
        put_bytes(&mut content, name.as_bytes());
        let mut pairs = Vec::new();
        for (key, value) in map {
            put_bytes(&mut pairs, key.as_bytes());
            put_bytes(&mut pairs, value.as_bytes());
        }
        put_bytes(&mut content, &pairs);
        self.copy_metadata(name, &content)
    }

    /// Writes a metadata record of this content.
    pub(in super::super) fn copy_metadata(&mut self, name: &str, content: &[u8]) -> io::Result<()> {
        self.end_chunk()?;
        let mut record = Vec::new();
        put_record(&mut record, kind::METADATA, |out| out.extend_from_slice(content));
        put_record(&mut self.index.metadata_indexes, kind::METADATA_INDEX, |out| {
            out.extend_from_slice(&self.offset.to_le_bytes());
            out.extend_from_slice(&(record.len() as u64).to_le_bytes());
            put_bytes(out, name.as_bytes());
        });
        self.index.metadata += 1;
        self.write(&record)
    }

    /// Ends the open chunk and hands it to the system: from here on it survives a
    /// kill.
    pub(in super::super) fn flush(&mut self) -> io::Result<()> {
        self.end_chunk()?;
        self.out.flush()
    }

    /// Copies a whole chunk: `record` with its head, `records` what is in it.
    pub(in super::super) fn copy_chunk(&mut self, record: &[u8], records: &[u8]) -> io::Result<()> {
        self.end_chunk()?;
        let mut messages = ChunkMessages::default();
        let mut rest = records;
        while let Some((kind, content, behind)) = super::read::split_record(rest) {
            match kind {
                kind::SCHEMA | kind::CHANNEL => {
                    self.index.declare(kind, content);
                }
                kind::MESSAGE => {
                    if let Some((header, _)) = MessageHeader::parse(content) {
                        messages.add(header, records.len() - rest.len());
                    }
                }
                _ => {}
            }
            rest = behind;
        }
        self.write_chunk(record, records.len(), messages)
    }

    /// Writes the index and the end of the file, and returns its writer.
    pub(in super::super) fn finish(mut self) -> io::Result<W> {
        self.end_chunk()?;
        let mut end = Vec::new();
        // A CRC of 0: none was computed.
        put_record(&mut end, kind::DATA_END, |out| out.extend_from_slice(&[0; 4]));
        let summary_at = end.len();
        let start = self.offset + summary_at as u64;
        let mut offsets_start = 0;
        if self.index.chunks <= self.max_chunks {
            let offsets = self.index.put_summary(&mut end, self.offset);
            offsets_start = self.offset + end.len() as u64;
            end.extend_from_slice(&offsets);
        }
        let start = if offsets_start == 0 { 0 } else { start };
        end.push(kind::FOOTER);
        for field in [20, start, offsets_start] {
            end.extend_from_slice(&field.to_le_bytes());
        }
        // Covers the summary and the footer up to here.
        let crc = crc32fast::hash(end.get(summary_at..).unwrap_or_default());
        end.extend_from_slice(&crc.to_le_bytes());
        end.extend_from_slice(&MAGIC);
        self.write(&end)?;
        self.out.flush()?;
        Ok(self.out)
    }

    fn end_chunk(&mut self) -> io::Result<()> {
        let mut chunk = std::mem::take(&mut self.chunk);
        if chunk.record.is_empty() {
            return Ok(());
        }
        let size = chunk.record.len() - CHUNK_HEAD;
        let records = chunk.record.get(CHUNK_HEAD..).unwrap_or_default();
        let (start, end) = chunk.messages.span.unwrap_or_default();
        let mut head = vec![kind::CHUNK];
        head.extend_from_slice(&((chunk.record.len() - RECORD_HEAD) as u64).to_le_bytes());
        head.extend_from_slice(&start.to_le_bytes());
        head.extend_from_slice(&end.to_le_bytes());
        head.extend_from_slice(&(size as u64).to_le_bytes());
        head.extend_from_slice(&crc32fast::hash(records).to_le_bytes());
        put_bytes(&mut head, b"");
        head.extend_from_slice(&(size as u64).to_le_bytes());
        if let Some(place) = chunk.record.get_mut(..CHUNK_HEAD) {
            place.copy_from_slice(&head);
        }
        self.write_chunk(&chunk.record, size, chunk.messages)?;
        // The next chunk takes the same memory.
        chunk.record.clear();
        self.chunk.record = chunk.record;
        Ok(())
    }

    /// Writes a chunk, and behind it where its messages are.
    fn write_chunk(
        &mut self,
        record: &[u8],
        size: usize,
        messages: ChunkMessages,
    ) -> io::Result<()> {
        let chunk_start = self.offset;
        self.write(record)?;
        let index_start = self.offset;
        let (mut indexes, mut places) = (Vec::new(), Vec::new());
        for (channel, messages) in &messages.channels {
            places.extend_from_slice(&channel.to_le_bytes());
            places.extend_from_slice(&(index_start + indexes.len() as u64).to_le_bytes());
            put_record(&mut indexes, kind::MESSAGE_INDEX, |out| {
                out.extend_from_slice(&channel.to_le_bytes());
                out.extend_from_slice(&(messages.len() as u32 * 16).to_le_bytes());
                for (time, place) in messages {
                    out.extend_from_slice(&time.to_le_bytes());
                    out.extend_from_slice(&place.to_le_bytes());
                }
            });
            *self.index.messages.entry(*channel).or_default() += messages.len() as u64;
        }
        self.write(&indexes)?;
        self.index.chunks += 1;
        let (start, end) = messages.span.unwrap_or_default();
        if messages.span.is_some() {
            self.index.span = Some(extend(self.index.span, start, end));
        }
        if self.index.chunks > self.max_chunks {
            self.index.chunk_indexes = Vec::new();
            return Ok(());
        }
        put_record(&mut self.index.chunk_indexes, kind::CHUNK_INDEX, |out| {
            for field in [start, end, chunk_start, record.len() as u64] {
                out.extend_from_slice(&field.to_le_bytes());
            }
            put_bytes(out, &places);
            out.extend_from_slice(&(indexes.len() as u64).to_le_bytes());
            put_bytes(out, b"");
            for field in [size as u64; 2] {
                out.extend_from_slice(&field.to_le_bytes());
            }
        });
        Ok(())
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.out.write_all(bytes)?;
        self.offset += bytes.len() as u64;
        Ok(())
    }
}

/// Returns the content of a header record.
pub(in super::super) fn header(profile: &str, library: &str) -> Vec<u8> {
    let mut content = Vec::new();
    put_bytes(&mut content, profile.as_bytes());
    put_bytes(&mut content, library.as_bytes());
    content
}

impl OpenChunk {
    /// Makes room for the head. Each chunk repeats the channels, so that the loss
    /// of one chunk costs nothing of the others.
    fn begin(&mut self, index: &Index) {
        if self.record.is_empty() {
            self.record.resize(CHUNK_HEAD, 0);
            index.channels.values().for_each(|channel| self.record.extend_from_slice(channel));
        }
    }
}

impl Index {
    /// Keeps a schema or a channel for the summary. Returns its record if that is
    /// new.
    fn declare(&mut self, kind: u8, content: &[u8]) -> Option<&[u8]> {
        let id = Fields(content).u16()?;
        let group = if kind == kind::SCHEMA { &mut self.schemas } else { &mut self.channels };
        let mut record = Vec::new();
        put_record(&mut record, kind, |out| out.extend_from_slice(content));
        if group.get(&id) == Some(&record) {
            return None;
        }
        let kept = group.entry(id).or_default();
        *kept = record;
        Some(kept)
    }

    /// Appends the summary to `out`, which stands at `base` in the file, and returns
    /// the offsets of its groups.
    fn put_summary(&mut self, out: &mut Vec<u8>, base: u64) -> Vec<u8> {
        let mut statistics = Vec::new();
        put_record(&mut statistics, kind::STATISTICS, |out| {
            let (start, end) = self.span.unwrap_or_default();
            out.extend_from_slice(&self.messages.values().sum::<u64>().to_le_bytes());
            out.extend_from_slice(&(self.schemas.len() as u16).to_le_bytes());
            out.extend_from_slice(&(self.channels.len() as u32).to_le_bytes());
            out.extend_from_slice(&[0; 4]); // attachments
            out.extend_from_slice(&self.metadata.to_le_bytes());
            out.extend_from_slice(&(self.chunks as u32).to_le_bytes());
            out.extend_from_slice(&start.to_le_bytes());
            out.extend_from_slice(&end.to_le_bytes());
            out.extend_from_slice(&(self.messages.len() as u32 * 10).to_le_bytes());
            for (channel, count) in &self.messages {
                out.extend_from_slice(&channel.to_le_bytes());
                out.extend_from_slice(&count.to_le_bytes());
            }
        });
        let groups = [
            (kind::SCHEMA, self.schemas.values().flatten().copied().collect()),
            (kind::CHANNEL, self.channels.values().flatten().copied().collect()),
            (kind::STATISTICS, statistics),
            (kind::CHUNK_INDEX, std::mem::take(&mut self.chunk_indexes)),
            (kind::METADATA_INDEX, std::mem::take(&mut self.metadata_indexes)),
        ];
        let mut offsets = Vec::new();
        for (kind, group) in groups {
            if group.is_empty() {
                continue;
            }
            put_record(&mut offsets, kind::SUMMARY_OFFSET, |offset| {
                offset.push(kind);
                offset.extend_from_slice(&(base + out.len() as u64).to_le_bytes());
                offset.extend_from_slice(&(group.len() as u64).to_le_bytes());
            });
            out.extend_from_slice(&group);
        }
        offsets
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Writes so many chunks of one message.
    fn chunks(count: usize, max_chunks: usize) -> McapWriter<Vec<u8>> {
        let mut writer = McapWriter::start(Vec::new(), &header("", ""), max_chunks).unwrap();
        writer.add_channel(0, "/scan", "std_msgs/msg/String", "string data");
        for sequence in 0..count as u32 {
            let time = u64::from(sequence);
            let header = MessageHeader { channel: 0, sequence, log_time: time, publish_time: time };
            writer.message(header, &[0; 4]).unwrap();
            writer.flush().unwrap();
        }
        writer
    }

    #[test]
    fn the_index_of_the_longest_file_takes_a_hundred_bytes_a_chunk() {
        let writer = chunks(1000, 1000);
        assert_eq!(writer.chunks(), 1000);
        // A recording has three channels, of 10 bytes each here.
        assert!(writer.index.chunk_indexes.len() <= 1000 * (106 - 20));
        let file = writer.finish().unwrap();
        let summary = ::mcap::Summary::read(&file).unwrap().unwrap();
        assert_eq!(summary.chunk_indexes.len(), 1000);
    }

    #[test]
    fn a_file_of_more_chunks_keeps_no_index_and_ends_without_a_summary() {
        let writer = chunks(1001, 1000);
        assert_eq!(writer.index.chunk_indexes.capacity(), 0);
        let file = writer.finish().unwrap();
        assert!(::mcap::Summary::read(&file).unwrap().is_none());
        assert_eq!(::mcap::MessageStream::new(&file).unwrap().count(), 1001);
    }
}
