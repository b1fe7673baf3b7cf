//! [`McapWriter`]: appends records to a file and never changes written ones. So whatever
//! ends the program, the file is complete up to its last chunk.

use std::collections::BTreeMap;
use std::io::{self, Write};

use super::form::records_of;
use super::index::{ChunkMessages, Index};
use super::{
    CHUNK_HEAD, Compression, FOOTER_BYTES, MAGIC, MAX_INDEX_BYTES, MessageHeader, RECORD_HEAD,
    kind, put_bytes, put_numbers, put_record,
};

/// A chunk is written before a message makes it longer than this. Until then it waits for a flush.
const CHUNK_BYTES: usize = 768 << 10;

/// Writes an MCAP file.
pub(crate) struct McapWriter<W> {
    pub(super) out: W,
    /// Number of bytes written.
    pub(crate) offset: u64,
    chunk: OpenChunk,
    /// Of the next chunks.
    pub(crate) compression: Compression,
    /// Record of the latest compressed chunk.
    compressed: Vec<u8>,
    pub(crate) index: Index,
    /// Bytes of messages since a chunk began with all channels, in a copy. A recording repeats
    /// them in each chunk, so that losing one chunk does not affect the others.
    since_channels: Option<usize>,
}

/// Chunk that grows in memory.
#[derive(Default)]
struct OpenChunk {
    /// Record of the chunk from its beginning. Its head is filled in at the end.
    record: Vec<u8>,
    messages: ChunkMessages,
}

impl<W: Write> McapWriter<W> {
    /// Starts a file. `header` is the content of its header record, from [`header`]. A
    /// file with an index longer than [`MAX_INDEX_BYTES`] ends without one.
    pub(crate) fn start(mut out: W, header: &[u8], compression: Compression) -> io::Result<Self> {
        let mut head = MAGIC.to_vec();
        put_record(&mut head, kind::HEADER, |out| out.extend_from_slice(header));
        out.write_all(&head)?;
        Ok(Self {
            out,
            offset: head.len() as u64,
            chunk: OpenChunk::default(),
            compression,
            compressed: Vec::new(),
            index: Index::default(),
            since_channels: None,
        })
    }

    /// Starts a copy of other files, and repeats its channels only if they are shorter than the
    /// messages before: a hostile file has many long ones, and chunks of one message.
    pub(crate) fn start_copy(out: W, header: &[u8], compression: Compression) -> io::Result<Self> {
        let writer = Self::start(out, header, compression)?;
        Ok(Self { since_channels: Some(0), ..writer })
    }

    /// Length of the file so far, including the open chunk without compression, or the definitions in
    /// it while it has no message.
    pub(crate) fn len(&self) -> u64 {
        let head = self.chunk.messages.span.map_or(CHUNK_HEAD, |_| 0);
        self.offset + self.chunk.record.len().saturating_sub(head) as u64
    }

    /// Returns true while there is room for twice as many chunks in the index.
    pub(crate) fn has_short_index(&self) -> bool {
        self.index.len() < MAX_INDEX_BYTES / 2
    }

    /// Writes a schema or channel, unless it was written before. `content` follows its number. Returns
    /// the number, which is the wanted one if it is free, or `None` if the file has no room for it.
    pub(crate) fn declare(&mut self, kind: u8, wanted: u16, content: &[u8]) -> Option<u16> {
        let known = self.index.number(kind, content);
        known.or_else(|| {
            // First, because a chunk begins with the channels known before it.
            self.begin_chunk();
            let (number, record) = self.index.declare(kind, wanted, content)?;
            self.chunk.record.extend_from_slice(record);
            Some(number)
        })
    }

    /// Adds a message to the open chunk.
    pub(crate) fn message(&mut self, header: MessageHeader, data: &[u8]) -> io::Result<()> {
        if self.chunk.record.len() + data.len() > CHUNK_BYTES {
            self.end_chunk()?;
        }
        self.begin_chunk();
        self.since_channels = self.since_channels.map(|bytes| bytes.saturating_add(data.len()));
        self.chunk.messages.add(header, self.chunk.record.len() - CHUNK_HEAD);
        put_record(&mut self.chunk.record, kind::MESSAGE, |out| {
            out.extend_from_slice(&header.channel.to_le_bytes());
            out.extend_from_slice(&header.sequence.to_le_bytes());
            put_numbers(out, &[header.log_time, header.publish_time]);
            out.extend_from_slice(data);
        });
        Ok(())
    }

    /// Writes a metadata record of this content.
    pub(crate) fn metadata(&mut self, name: &str, content: &[u8]) -> io::Result<()> {
        self.end_chunk()?;
        let mut record = Vec::new();
        put_record(&mut record, kind::METADATA, |out| out.extend_from_slice(content));
        self.index.add_metadata(self.offset, record.len() as u64, name);
        self.write(&record)
    }

    /// Ends the open chunk and hands it to the system: from now on it survives the death of the process.
    pub(crate) fn flush(&mut self) -> io::Result<()> {
        self.end_chunk()?;
        self.out.flush()
    }

    /// Writes the index and the end of the file, or only its end if it may not grow by the index (EFBIG).
    /// Write nothing after it.
    pub(crate) fn end(&mut self) -> io::Result<()> {
        self.end_chunk()?;
        match self.write_end() {
            Err(error) if error.kind() == io::ErrorKind::FileTooLarge => {
                self.index.leave_out();
                self.write_end()
            }
            ended => ended,
        }
    }

    fn write_end(&mut self) -> io::Result<()> {
        // What no message uses.
        let mut end = self.chunk.record.split_off(CHUNK_HEAD.min(self.chunk.record.len()));
        // CRC 0 means that it was not computed.
        put_record(&mut end, kind::DATA_END, |out| out.extend_from_slice(&[0; 4]));
        let summary_at = end.len();
        let index = std::mem::take(&mut self.index);
        let [start, offsets_start] = index.put_summary(&mut end, self.offset);
        end.push(kind::FOOTER);
        put_numbers(&mut end, &[FOOTER_BYTES as u64, start, offsets_start]);
        // Covers the summary and the footer up to here.
        let crc = crc32fast::hash(end.get(summary_at..).unwrap_or_default());
        end.extend_from_slice(&crc.to_le_bytes());
        end.extend_from_slice(&MAGIC);
        self.write(&end)?;
        self.out.flush()
    }

    /// Takes the records of the open chunk, which the file has no room for.
    pub(crate) fn take_records(&mut self) -> Vec<u8> {
        let mut chunk = std::mem::take(&mut self.chunk);
        chunk.record.split_off(CHUNK_HEAD.min(chunk.record.len()))
    }

    /// Adds the messages among the records of a chunk of another file that has the same channels.
    pub(crate) fn add_messages(&mut self, records: &[u8]) -> io::Result<()> {
        records_of(records)
            .filter(|(kind, _)| *kind == kind::MESSAGE)
            .filter_map(|(_, content)| MessageHeader::parse(content))
            .try_for_each(|(header, data)| self.message(header, data))
    }

    /// Makes room for the head of the open chunk, unless it has begun.
    fn begin_chunk(&mut self) {
        let record = &mut self.chunk.record;
        if record.is_empty() {
            record.resize(CHUNK_HEAD, 0);
            let Index { channels, channel_bytes, .. } = &self.index;
            if self.since_channels.is_none_or(|bytes| *channel_bytes <= bytes) {
                self.since_channels = self.since_channels.map(|_| 0);
                channels.values().for_each(|channel| record.extend_from_slice(channel));
            }
        }
    }

    /// Writes the open chunk, followed by the positions of its messages, all at once. If that fails, the
    /// chunk stays open. It also does without messages: such a chunk would have the time 0, and viewers
    /// begin a file with its earliest chunk.
    fn end_chunk(&mut self) -> io::Result<()> {
        let Some((start, end)) = self.chunk.messages.span else { return Ok(()) };
        let mut chunk = std::mem::take(&mut self.chunk);
        let records = chunk.record.get(CHUNK_HEAD..).unwrap_or_default();
        let (size, crc) = (records.len(), crc32fast::hash(records));
        let name = self.compression.name();
        self.compressed.clear();
        self.compressed.resize(CHUNK_HEAD + name.len(), 0);
        let is_compressed = self.compression.compress(records, &mut self.compressed);
        let (record, compression) = match is_compressed {
            true => (&mut self.compressed, name),
            false => (&mut chunk.record, ""),
        };
        let head_bytes = CHUNK_HEAD + compression.len();
        let mut head = vec![kind::CHUNK];
        let length = (record.len() - RECORD_HEAD) as u64;
        put_numbers(&mut head, &[length, start, end, size as u64]);
        head.extend_from_slice(&crc.to_le_bytes());
        put_bytes(&mut head, compression.as_bytes());
        put_numbers(&mut head, &[(record.len() - head_bytes) as u64]);
        if let Some(place) = record.get_mut(..head_bytes) {
            place.copy_from_slice(&head);
        }
        let length = record.len();
        let (lists, places) = chunk.messages.indexes(self.offset + length as u64);
        let mut entry = Vec::new();
        put_numbers(&mut entry, &[start, end, self.offset, length as u64]);
        put_bytes(&mut entry, &places);
        put_numbers(&mut entry, &[lists.len() as u64]);
        put_bytes(&mut entry, compression.as_bytes());
        put_numbers(&mut entry, &[(length - head_bytes) as u64, size as u64]);
        record.extend_from_slice(&lists);
        let written = self.out.write_all(record);
        if let Err(error) = written {
            record.truncate(length);
            self.chunk = chunk;
            return Err(error);
        }
        self.offset += record.len() as u64;
        self.index.add_chunk(&chunk.messages, &entry);
        // The next chunk reuses the memory.
        chunk.record.clear();
        self.chunk.record = chunk.record;
        Ok(())
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.out.write_all(bytes)?;
        self.offset += bytes.len() as u64;
        Ok(())
    }
}

/// Encodes the content of a header record.
pub(crate) fn header(profile: &str, library: &str) -> Vec<u8> {
    texts([profile, library])
}

/// Encodes the content of metadata.
pub(crate) fn metadata(name: &str, map: &BTreeMap<String, String>) -> Vec<u8> {
    let mut content = texts([name]);
    put_bytes(&mut content, &texts(map.iter().flat_map(|(key, value)| [&**key, value])));
    content
}

/// Encodes the content of a channel of ROS 2 without metadata, after its number.
pub(crate) fn channel(schema: u16, topic: &str) -> Vec<u8> {
    [&schema.to_le_bytes(), &*texts([topic, "cdr", ""])].concat()
}

/// Encodes the content of a schema of ROS 2, after its number.
pub(crate) fn schema(message: &str, definition: &str) -> Vec<u8> {
    texts([message, "ros2msg", definition])
}

fn texts<'a>(texts: impl IntoIterator<Item = &'a str>) -> Vec<u8> {
    let mut out = Vec::new();
    texts.into_iter().for_each(|text| put_bytes(&mut out, text.as_bytes()));
    out
}
