//! Rewrites a file in another form that the format allows, as another writer or a later version of the
//! format may write it.

use super::file::{CHUNK_HEAD, split};
use crate::common::random::Random;
use crate::raw::{MAGIC, of_kind, text};
#[cfg(feature = "compression")]
use crate::recompress::compress;

#[cfg(feature = "compression")]
const COMPRESSIONS: [&str; 3] = ["", "lz4", "zstd"];
#[cfg(not(feature = "compression"))]
const COMPRESSIONS: [&str; 1] = [""];

#[cfg(not(feature = "compression"))]
fn compress(_compression: &str, records: &[u8]) -> Vec<u8> {
    records.to_vec()
}

/// Writes a complete file without compression anew. Leaves out the index, whose places would be
/// wrong, but for the definitions. If `is_mixed`, records of a chunk may stand outside.
pub(super) fn rewritten(random: &mut Random, file: &[u8], is_mixed: bool) -> Vec<u8> {
    let mut form = Form {
        is_later: random.once_in(2),
        is_mixed,
        repeats: random.once_in(3),
        has_checksums: !random.once_in(3),
        compressions: if random.once_in(2) { &COMPRESSIONS } else { &COMPRESSIONS[..1] },
        random,
        out: MAGIC.to_vec(),
        definitions: Vec::new(),
    };
    let has_lists = form.random.once_in(2);
    let mut rest = &file[MAGIC.len()..];
    loop {
        let (kind, content) = split(rest);
        rest = &rest[9 + content.len()..];
        match kind {
            // Its positions are mostly wrong.
            0x07 if !has_lists || form.random.once_in(4) => {}
            0x06 => form.chunk(content),
            0x0f => {
                let is_told = content != [0; 4] && form.compressions.len() == 1;
                let crc = if is_told { crc32fast::hash(&form.out) } else { 0 };
                form.out.extend(of_kind(kind, &crc.to_le_bytes()));
                form.end();
                return form.out;
            }
            _ => {
                let record = form.record(kind, content);
                form.out.extend(record);
                form.beside();
            }
        }
    }
}

/// What a file has.
struct Form<'a> {
    random: &'a mut Random,
    /// More fields at the ends of records, and records of kinds that do not exist yet.
    is_later: bool,
    is_mixed: bool,
    /// Schemas and channels again and again.
    repeats: bool,
    has_checksums: bool,
    compressions: &'a [&'static str],
    out: Vec<u8>,
    /// Schemas and channels so far.
    definitions: Vec<Vec<u8>>,
}

impl Form<'_> {
    /// Writes the records of a chunk, mostly as one.
    fn chunk(&mut self, content: &[u8]) {
        let (head, mut records) = content.split_at(CHUNK_HEAD - 9);
        let mut inner = Vec::new();
        while !records.is_empty() {
            let (kind, content) = split(records);
            records = &records[9 + content.len()..];
            let record = self.record(kind, content);
            if self.is_mixed && self.random.once_in(4) {
                self.end_chunk(head, &mut inner);
                self.out.extend(record);
            } else {
                inner.extend(record);
            }
        }
        self.end_chunk(head, &mut inner);
    }

    /// Writes an end with definitions, or without: no statistics, no places of chunks and no offsets.
    fn end(&mut self) {
        let (start, place) = (self.out.len(), self.out.len() as u64);
        let place = if self.random.once_in(2) { place } else { 0 };
        if place > 0 {
            self.out.extend(self.definitions.concat());
        }
        let head = &of_kind(0x02, &[0; 20])[..9];
        self.out.extend([head, &place.to_le_bytes(), &[0; 8]].concat());
        let crc = if self.has_checksums { crc32fast::hash(&self.out[start..]) } else { 0 };
        self.out.extend([&crc.to_le_bytes(), MAGIC].concat());
    }

    /// Writes what has no message: a list without entries, or an attachment.
    fn beside(&mut self) {
        let record = match self.random.below(40) {
            0 => return self.end_chunk(&[0; 28], &mut Vec::new()),
            1 => of_kind(0x07, &[0; 6]),
            2 => {
                let data = vec![*self.random.pick(&[0, 1, 6]); self.random.below(99) as usize];
                let texts = [&[0; 16][..], &text("map.yaml"), &text("text/yaml")].concat();
                let length = (data.len() as u64).to_le_bytes();
                of_kind(0x09, &[&texts, &length[..], &data, &[0; 4]].concat())
            }
            _ => return,
        };
        self.out.extend(record);
    }

    fn end_chunk(&mut self, head: &[u8], records: &mut Vec<u8>) {
        let name = *self.random.pick(self.compressions);
        let has_checksum = self.has_checksums && head[24..28] != [0; 4];
        let crc = if has_checksum { crc32fast::hash(records) } else { 0 };
        let (size, records) = (records.len() as u64, compress(name, &std::mem::take(records)));
        let head = [&head[..16], &size.to_le_bytes(), &crc.to_le_bytes(), &text(name)].concat();
        let chunk = [&head[..], &(records.len() as u64).to_le_bytes(), &records].concat();
        let record = self.record(0x06, &chunk);
        self.out.extend(record);
    }

    /// Returns a record, and perhaps others beside it.
    fn record(&mut self, kind: u8, content: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        if self.repeats && kind == 0x05 && self.random.once_in(4) {
            out.extend(self.random.pick(&self.definitions).clone());
        }
        // The format promises that messages stay as they are.
        let more = if kind == 0x05 { Vec::new() } else { self.more(12) };
        let record = of_kind(kind, &[content, &more].concat());
        if matches!(kind, 0x03 | 0x04) {
            self.definitions.push(record.clone());
        }
        out.extend(record);
        if let Some((kind, content)) = self.more(60).split_first() {
            out.extend(of_kind((*kind).max(0x10), content));
        }
        out
    }

    /// Returns mostly nothing, or up to `most` bytes of a later version.
    fn more(&mut self, most: u64) -> Vec<u8> {
        let length = match self.is_later && self.random.once_in(3) {
            true => 1 + self.random.below(most),
            false => 0,
        };
        (0..length).map(|_| self.random.next() as u8).collect()
    }
}
