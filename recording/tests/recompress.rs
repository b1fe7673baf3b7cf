//! Compression of chunks by the crates alone: rewrites a file's chunks, and corrects its index.

use std::collections::BTreeMap;
use std::io::{Read, Write};

use lz4_flex::frame::{BlockSize, FrameDecoder, FrameEncoder, FrameInfo};
use ruzstd::decoding::StreamingDecoder;
use ruzstd::encoding::{CompressionLevel, compress_to_vec};

use super::raw::{MAGIC, of_kind, text};

pub(super) fn compress(compression: &str, bytes: &[u8]) -> Vec<u8> {
    match compression {
        "" => bytes.to_vec(),
        "zstd" => compress_to_vec(bytes, CompressionLevel::Fastest),
        _ => {
            let mut encoder = FrameEncoder::with_frame_info(
                FrameInfo::new().block_size(BlockSize::Max64KB),
                vec![],
            );
            encoder.write_all(bytes).unwrap();
            encoder.finish().unwrap()
        }
    }
}

pub(super) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap())
}

pub(super) fn decompress(compression: &str, bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    match compression {
        "" => out.extend_from_slice(bytes),
        "zstd" => drop(StreamingDecoder::new(bytes).unwrap().read_to_end(&mut out).unwrap()),
        _ => drop(FrameDecoder::new(bytes).read_to_end(&mut out).unwrap()),
    }
    out
}

/// Chunk as its record has it: the name of its compression, and its records.
pub(super) fn chunk(content: &[u8]) -> (&str, &[u8]) {
    let name = u32::from_le_bytes(content[28..32].try_into().unwrap()) as usize;
    // Fields of a later version may follow.
    let records = &content[40 + name..][..u64_at(content, 32 + name) as usize];
    (std::str::from_utf8(&content[32..32 + name]).unwrap(), records)
}

/// Names of the compressions of a complete file's chunks.
pub(super) fn compressions(file: &[u8]) -> Vec<&str> {
    let (mut at, mut names) = (MAGIC.len(), Vec::new());
    while at + MAGIC.len() < file.len() {
        let content = &file[at + 9..][..u64_at(file, at + 1) as usize];
        names.extend((file[at] == 0x06).then(|| chunk(content).0));
        at += 9 + content.len();
    }
    names
}

/// Compresses the chunks of a complete file anew, and corrects its index, which must be right.
pub(super) fn compressed(file: &[u8], compression: &str) -> Vec<u8> {
    let mut out = MAGIC.to_vec();
    // Where each record was, and where it is now.
    let mut places = BTreeMap::from([(0, 0)]);
    // Compression of each chunk, and the lengths of its records with and without it.
    let mut sizes = BTreeMap::new();
    let mut at = MAGIC.len();
    while at + MAGIC.len() < file.len() {
        places.insert(at as u64, out.len() as u64);
        let place = |old: u64| places[&old].to_le_bytes();
        let kind = file[at];
        let content = &file[at + 9..][..u64_at(file, at + 1) as usize];
        let new = match kind {
            0x06 => {
                let (name, records) = chunk(content);
                let plain = decompress(name, records);
                assert_eq!(plain.len() as u64, u64_at(content, 16));
                sizes.insert(at as u64, (name, records.len() as u64, plain.len() as u64));
                let records = compress(compression, &plain);
                let length = (records.len() as u64).to_le_bytes();
                [&content[..28], &text(compression), &length, &records].concat()
            }
            // Index of a chunk: times, start, length, lists, length of the lists, compression
            // and two sizes.
            0x08 => {
                let (start, length) = (u64_at(content, 16), u64_at(content, 24));
                let length = places[&(start + length)] - places[&start];
                let (name, stored, plain) = sizes[&start];
                let (lists, rest) =
                    content[36..].split_at(content.len() - 36 - 8 - 4 - 16 - name.len());
                let sizes = [stored.to_le_bytes(), plain.to_le_bytes()].concat();
                assert_eq!(&rest[8..], [text(name), sizes].concat());
                let moved = lists
                    .chunks(10)
                    .flat_map(|list| [&list[..2], &place(u64_at(list, 2))[..]].concat());
                let head = 9 + 28 + 4 + compression.len() as u64 + 8;
                [
                    &content[..16],
                    &place(start),
                    &length.to_le_bytes(),
                    &content[32..36],
                    &moved.collect::<Vec<u8>>(),
                    &rest[..8],
                    &text(compression),
                    &(length - head).to_le_bytes(),
                    &plain.to_le_bytes(),
                ]
                .concat()
            }
            0x0d => [&place(u64_at(content, 0)), &content[8..]].concat(),
            0x0e => {
                let (start, length) = (u64_at(content, 1), u64_at(content, 9));
                let length = places[&(start + length)] - places[&start];
                [&content[..1], &place(start), &length.to_le_bytes()].concat()
            }
            0x02 if content != [0; 20] => {
                let positions = [place(u64_at(content, 0)), place(u64_at(content, 8))].concat();
                let summary = places[&u64_at(content, 0)] as usize;
                let checked = [&out[summary..], &of_kind(0x02, &[0; 20])[..9], &positions].concat();
                [&positions[..], &crc32fast::hash(&checked).to_le_bytes()].concat()
            }
            _ => content.to_vec(),
        };
        out.extend(of_kind(kind, &new));
        at += 9 + content.len();
    }
    out.extend(MAGIC);
    out
}
