//! [`Index`] and [`ChunkMessages`]: where a file has what, for readers that search it. A writer keeps only
//! the index of what it has written, so the index decides the memory of a long recording.

use std::collections::{BTreeMap, HashMap};

use super::{
    MAX_DEFINITION_BYTES, MAX_INDEX_BYTES, MessageHeader, kind, put_bytes, put_numbers, put_record,
};

/// Messages of a chunk: their times, and their positions among its records.
#[derive(Default)]
pub(super) struct ChunkMessages {
    /// Log times of the first and the last one.
    pub(super) span: Option<(u64, u64)>,
    channels: BTreeMap<u16, Vec<[u64; 2]>>,
}

/// Contents of a file's summary.
#[derive(Default)]
pub(crate) struct Index {
    /// Number of each definition, by its kind and its content after the number.
    numbers: HashMap<(u8, Vec<u8>), u16>,
    /// Length of the definitions.
    definition_bytes: usize,
    /// Schema and channel of each number, as records.
    schemas: BTreeMap<u16, Vec<u8>>,
    pub(super) channels: BTreeMap<u16, Vec<u8>>,
    /// Length of the channels.
    pub(super) channel_bytes: usize,
    /// One record for each chunk.
    chunk_indexes: Vec<u8>,
    /// One record for each metadata record.
    metadata_indexes: Vec<u8>,
    chunks: usize,
    metadata: usize,
    span: Option<(u64, u64)>,
    /// Number of messages of each channel.
    messages: BTreeMap<u16, u64>,
    /// Set once the index was too long. Such a file gets no summary: it can be read but not searched.
    is_too_long: bool,
}

impl ChunkMessages {
    /// Adds a message that starts at `place` in the chunk's records.
    pub(super) fn add(&mut self, header: MessageHeader, place: usize) {
        self.span = Some(extend(self.span, header.log_time, header.log_time));
        self.channels.entry(header.channel).or_default().push([header.log_time, place as u64]);
    }

    /// Encodes the message indexes of a chunk, which begin at `start` in the file, and the place of
    /// each channel's index.
    pub(super) fn indexes(&self, start: u64) -> (Vec<u8>, Vec<u8>) {
        let (mut records, mut places) = (Vec::new(), Vec::new());
        for (channel, messages) in &self.channels {
            places.extend_from_slice(&channel.to_le_bytes());
            put_numbers(&mut places, &[start + records.len() as u64]);
            put_record(&mut records, kind::MESSAGE_INDEX, |out| {
                out.extend_from_slice(&channel.to_le_bytes());
                out.extend_from_slice(&(messages.len() as u32 * 16).to_le_bytes());
                messages.iter().for_each(|entry| put_numbers(out, entry));
            });
        }
        (records, places)
    }
}

impl Index {
    /// Length of the records for chunks and metadata.
    pub(super) fn len(&self) -> usize {
        self.chunk_indexes.len() + self.metadata_indexes.len()
    }

    /// Number of chunks and metadata records.
    pub(crate) fn entries(&self) -> usize {
        self.chunks + self.metadata
    }

    /// Returns the number of a schema or a channel that was declared.
    pub(super) fn number(&self, kind: u8, content: &[u8]) -> Option<u16> {
        self.numbers.get(&(kind, content.to_vec())).copied()
    }

    /// Keeps a new schema or channel for the summary, with the wanted number if that is free. Returns
    /// the number and the record, or `None` if there is no room for it.
    pub(super) fn declare(
        &mut self,
        kind: u8,
        wanted: u16,
        content: &[u8],
    ) -> Option<(u16, &[u8])> {
        let group = if kind == kind::SCHEMA { &mut self.schemas } else { &mut self.channels };
        let bytes = self.definition_bytes + content.len();
        // Mostly the wanted one, or one that is not used yet.
        let unused = u16::try_from(group.len() + 1).unwrap_or(1);
        let mut numbers = [wanted, unused].into_iter().chain(1..=u16::MAX);
        let number = numbers.find(|number| !group.contains_key(number))?;
        if bytes > MAX_DEFINITION_BYTES {
            return None;
        }
        self.definition_bytes = bytes;
        self.numbers.insert((kind, content.to_vec()), number);
        let record = group.entry(number).or_default();
        put_record(record, kind, |out| {
            out.extend_from_slice(&number.to_le_bytes());
            out.extend_from_slice(content);
        });
        if kind == kind::CHANNEL {
            self.channel_bytes += record.len();
        }
        Some((number, record))
    }

    /// Adds a metadata record of this name, `length` bytes long, at `start`.
    pub(super) fn add_metadata(&mut self, start: u64, length: u64, name: &str) {
        self.metadata += 1;
        put_record(&mut self.metadata_indexes, kind::METADATA_INDEX, |out| {
            put_numbers(out, &[start, length]);
            put_bytes(out, name.as_bytes());
        });
        self.limit_length();
    }

    /// Adds a chunk with these messages. `content` is the content of its index.
    pub(super) fn add_chunk(&mut self, messages: &ChunkMessages, content: &[u8]) {
        self.chunks += 1;
        if let Some((first, last)) = messages.span {
            self.span = Some(extend(self.span, first, last));
        }
        for (channel, messages) in &messages.channels {
            *self.messages.entry(*channel).or_default() += messages.len() as u64;
        }
        put_record(&mut self.chunk_indexes, kind::CHUNK_INDEX, |out| {
            out.extend_from_slice(content);
        });
        self.limit_length();
    }

    fn limit_length(&mut self) {
        if self.is_too_long || self.len() > MAX_INDEX_BYTES {
            self.leave_out();
        }
    }

    /// Frees the memory of an index that is too long: the file gets none.
    pub(super) fn leave_out(&mut self) {
        self.is_too_long = true;
        (self.chunk_indexes, self.metadata_indexes) = (Vec::new(), Vec::new());
    }

    /// Appends the summary to `out`, which starts at `base` in the file. Returns the positions in the file of
    /// the summary and of the offsets at its end, or 0 for both if the index was too long.
    pub(super) fn put_summary(mut self, out: &mut Vec<u8>, base: u64) -> [u64; 2] {
        if self.is_too_long {
            return [0, 0];
        }
        self.numbers = HashMap::new();
        let start = base + out.len() as u64;
        let statistics = self.statistics();
        let mut offsets: Vec<u8> = Vec::new();
        let mut put_group = |kind, group: Vec<Vec<u8>>| {
            let from = out.len();
            // Frees each record before the next one is copied.
            group.into_iter().for_each(|records| out.extend_from_slice(&records));
            if out.len() == from {
                return;
            }
            put_record(&mut offsets, kind::SUMMARY_OFFSET, |offset| {
                offset.push(kind);
                put_numbers(offset, &[base + from as u64, (out.len() - from) as u64]);
            });
        };
        put_group(kind::SCHEMA, self.schemas.into_values().collect());
        put_group(kind::CHANNEL, self.channels.into_values().collect());
        put_group(kind::STATISTICS, vec![statistics]);
        put_group(kind::CHUNK_INDEX, vec![self.chunk_indexes]);
        put_group(kind::METADATA_INDEX, vec![self.metadata_indexes]);
        let offsets_start = base + out.len() as u64;
        out.extend_from_slice(&offsets);
        [start, offsets_start]
    }

    fn statistics(&self) -> Vec<u8> {
        let mut record = Vec::new();
        put_record(&mut record, kind::STATISTICS, |out| {
            let (start, end) = self.span.unwrap_or_default();
            put_numbers(out, &[self.messages.values().sum()]);
            out.extend_from_slice(&(self.schemas.len() as u16).to_le_bytes());
            out.extend_from_slice(&(self.channels.len() as u32).to_le_bytes());
            out.extend_from_slice(&[0; 4]); // attachments
            out.extend_from_slice(&(self.metadata as u32).to_le_bytes());
            out.extend_from_slice(&(self.chunks as u32).to_le_bytes());
            put_numbers(out, &[start, end]);
            out.extend_from_slice(&(self.messages.len() as u32 * 10).to_le_bytes());
            for (channel, count) in &self.messages {
                out.extend_from_slice(&channel.to_le_bytes());
                put_numbers(out, &[*count]);
            }
        });
        record
    }
}

fn extend(span: Option<(u64, u64)>, from: u64, to: u64) -> (u64, u64) {
    span.map_or((from, to), |(start, end)| (start.min(from), end.max(to)))
}
