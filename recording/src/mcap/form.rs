//! Form of a record: how far it reaches, whether one begins at a position, and its fields.
//!
//! Trusts no length alone. The format allows fields of later versions at the end of a record, and
//! kinds of records that this version does not have, so the length in a record's head is proved by
//! the lengths in its fields, or by what follows the record.

use std::collections::BTreeMap;
use std::ops::Range;

use super::{
    CHUNK_HEAD, Compression, Fields, MAX_CHUNK_BYTES, MAX_RECORD_BYTES, MessageHeader, RECORD_HEAD,
    kind,
};

/// Longest name of a compression.
const MAX_COMPRESSION_NAME: usize = 16;
/// Length of a chunk's record up to its records, compressed or not.
const MAX_CHUNK_HEAD: usize = CHUNK_HEAD + MAX_COMPRESSION_NAME;
/// Most records of a chunk without its lengths, which mcap 0.26.0 (Rust) writes once the chunk is complete.
const MAX_OPEN_BYTES: u64 = MAX_CHUNK_BYTES - MAX_CHUNK_HEAD as u64;
/// Longest record that is not read: no disk holds more.
const MAX_SKIPPED_BYTES: u64 = 1 << 48;
/// Length of a message without data.
const MESSAGE_BYTES: u64 = RECORD_HEAD as u64 + 22;
/// Number of records that must follow one whose lengths do not show that it begins there. Data with
/// many zeros look like one record, but not like three.
const FOLLOWERS: u8 = 2;

/// Extent of a record, from its first byte.
#[derive(Debug, Clone, Copy)]
pub(super) struct Extent {
    pub(super) kind: u8,
    /// End of the fields that this version of the format has.
    pub(super) fields: u64,
    pub(super) end: u64,
    /// True if one of its lengths is not 0, and its name begins with a printable character. A chunk must have
    /// records, too. Zeros look like a record without lengths, and small numbers like an unprintable name.
    counts: bool,
    /// True for a chunk whose lengths agree: it begins here, even with more fields after its records.
    pub(super) is_chunk: bool,
}

impl Extent {
    /// Returns the extent of a record whose lengths are cut off.
    fn endless(kind: u8) -> Self {
        Self { kind, fields: u64::MAX, end: u64::MAX, counts: false, is_chunk: false }
    }

    /// Returns true for a record whose lengths are cut off.
    pub(super) fn is_endless(&self) -> bool {
        self.fields == u64::MAX
    }

    /// Returns true if the lengths in the record prove its end.
    pub(super) fn is_proved(&self) -> bool {
        has_lengths(self.kind) && self.fields == self.end && self.end < u64::MAX
    }
}

/// Head of a chunk whose lengths agree with each other.
#[derive(Debug)]
pub(super) struct ChunkHead {
    /// Length of the records without compression.
    pub(super) size: u64,
    pub(super) crc: u32,
    /// Name of the compression, or empty.
    pub(super) compression: String,
    /// From the beginning of the chunk's record.
    pub(super) records: Range<usize>,
}

pub(super) fn record_head(bytes: &[u8]) -> Option<(u8, u64)> {
    let (&kind, rest) = bytes.split_first()?;
    Some((kind, Fields(rest).u64()?))
}

/// What follows some bytes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum After {
    /// More bytes.
    More,
    /// Nothing: a file, which may have been cut off, or a chunk, which may have lost or gained bytes.
    End,
    /// Nothing, and a record that does not end here is none.
    Nothing,
    /// Nothing: a file that ends with the magic bytes, so no record ends here.
    Magic,
    /// The same, and a record that reaches beyond them is none.
    MagicOnly,
}

/// Measures the record at the beginning of `bytes`. Returns `None` if no record has this kind and these
/// lengths. Fails with the number of bytes that are needed to tell.
pub(super) fn measure(bytes: &[u8], after: After) -> Result<Option<Extent>, usize> {
    let cut_off = |count| match after {
        After::More => Err(count),
        _ => Ok(Some(Extent::endless(bytes.first().copied().unwrap_or_default()))),
    };
    let Some((kind, length)) = record_head(bytes) else { return cut_off(RECORD_HEAD) };
    // Length of the numbers at the beginning, number of texts, and length after long data.
    let (numbers, texts, after_data, most) = match kind {
        0 => return Ok(None),
        kind::HEADER | kind::METADATA => (0, 2, None, MAX_RECORD_BYTES),
        kind::SCHEMA => (2, 3, None, MAX_RECORD_BYTES),
        kind::CHANNEL => (4, 3, None, MAX_RECORD_BYTES),
        kind::MESSAGE => (22, 0, None, MAX_CHUNK_BYTES),
        kind::CHUNK => (28, 1, Some(0), MAX_CHUNK_BYTES),
        kind::MESSAGE_INDEX => (2, 1, None, MAX_CHUNK_BYTES),
        kind::ATTACHMENT => (16, 2, Some(4), MAX_SKIPPED_BYTES),
        kind::DATA_END => (4, 0, None, MAX_RECORD_BYTES),
        kind::FOOTER => (20, 0, None, 20),
        // Of a later version, or private to other programs.
        _ => (0, 0, None, MAX_SKIPPED_BYTES),
    };
    let length = if kind == kind::CHUNK && length == u64::MAX { most } else { length };
    if length > most {
        return Ok(None);
    }
    let end = RECORD_HEAD as u64 + length;
    let (mut fields, mut counts) = ((RECORD_HEAD + numbers) as u64, false);
    let lengths = std::iter::repeat_n((4, 0), texts).chain(after_data.map(|after| (8, after)));
    for (width, after) in lengths {
        // A length has to be near the beginning: only what it counts may be long.
        if fields > MAX_RECORD_BYTES || fields + width as u64 > end {
            return Ok(None);
        }
        let (at, mut number) = (fields as usize, [0; 8]);
        let Some(bytes) = bytes.get(at..at + width) else { return cut_off(at + width) };
        number.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
        counts |= number != [0; 8];
        fields = (fields + width as u64 + after).saturating_add(or_open(number));
    }
    let name = Fields(bytes.get(RECORD_HEAD + numbers..).unwrap_or_default()).bytes();
    let first = name.and_then(<[u8]>::first);
    counts &= texts < 2 || first.is_some_and(|byte| !byte.is_ascii_control());
    let is_chunk = kind == kind::CHUNK;
    let needed = end.min(MAX_CHUNK_HEAD as u64) as usize;
    if !is_chunk && bytes.len() < needed && after == After::More {
        return Err(needed);
    }
    let chunk = chunk_head(bytes);
    counts &= !is_chunk || chunk.as_ref().is_some_and(|chunk| chunk.size > 0);
    let has_name =
        chunk.as_ref().is_some_and(|chunk| Compression::named(&chunk.compression).is_some());
    let is_wrong = match kind {
        // More fields of an empty chunk may be its messages.
        kind::CHUNK => chunk.is_none() || !counts && end - fields.min(end) >= MESSAGE_BYTES,
        kind::MESSAGE_INDEX => (fields - RECORD_HEAD as u64) % 16 != 6,
        _ => false,
    };
    // The kind of a chunk may be damaged.
    let is_other = !is_chunk
        && chunk.is_some_and(|chunk| {
            let records_end = chunk.records.end as u64;
            // Zeros look like an empty chunk.
            !chunk.records.is_empty()
                && (records_end == end || has_name && !has_lengths(kind) && records_end < end)
        });
    if fields > end || is_wrong || is_other {
        return Ok(None);
    }
    let fields = if has_lengths(kind) { fields } else { end };
    Ok(Some(Extent { kind, fields, end, counts, is_chunk: is_chunk && counts && has_name }))
}

/// Length of data, which may be open.
fn or_open(length: [u8; 8]) -> u64 {
    if length == [0xff; 8] { MAX_OPEN_BYTES } else { u64::from_le_bytes(length) }
}

/// Returns the kind and the content of each of some records that are not damaged.
pub(super) fn records_of(records: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    let mut rest = records;
    std::iter::from_fn(move || {
        let extent = measure(rest, After::End).ok()??;
        let (record, after) = rest.split_at_checked(usize::try_from(extent.end).ok()?)?;
        rest = after;
        Some((extent.kind, record.get(RECORD_HEAD..extent.fields as usize)?))
    })
}

/// Returns true for a kind whose fields prove its length.
fn has_lengths(kind: u8) -> bool {
    matches!(
        kind,
        kind::HEADER
            ..=kind::CHANNEL
                | kind::CHUNK
                | kind::MESSAGE_INDEX
                | kind::ATTACHMENT
                | kind::METADATA
                | kind::DATA_END
    )
}

/// Parses the head of the chunk at the beginning of `bytes`, whatever its kind says, if its lengths agree.
pub(super) fn chunk_head(bytes: &[u8]) -> Option<ChunkHead> {
    let mut fields = Fields(bytes.get(RECORD_HEAD..)?);
    let (_start, _end, size) = (fields.u64()?, fields.u64()?, or_open(fields.u64()?.to_le_bytes()));
    let crc = fields.u32()?;
    let name = fields.bytes()?;
    let records = or_open(fields.u64()?.to_le_bytes());
    let start = CHUNK_HEAD + name.len();
    let agrees = name.len() <= MAX_COMPRESSION_NAME
        && records <= MAX_CHUNK_BYTES
        && (!name.is_empty() || size == records);
    let records = start..usize::try_from(records).ok()?.saturating_add(start);
    agrees.then(|| ChunkHead { size, crc, compression: name.escape_ascii().to_string(), records })
}

/// Kinds of records to find.
pub(super) type Kinds = fn(u8) -> bool;

/// Kinds of records that this version of the format has before a summary. A search finds no others:
/// the last byte of a whole record may look like the kind of the next one, which is lost.
pub(super) fn is_known(kind: u8) -> bool {
    kind == kind::MESSAGE || has_lengths(kind)
}

/// Kinds of records that no chunk has.
pub(super) fn outside_chunks(kind: u8) -> bool {
    has_lengths(kind) && !matches!(kind, kind::HEADER | kind::SCHEMA | kind::CHANNEL)
}

/// Returns true if the lengths in a record show that it begins there.
fn shows(extent: &Extent) -> bool {
    extent.is_chunk || extent.is_proved() && extent.counts
}

/// Returns true if a record of these kinds begins at `at`. Fails with the number of bytes that
/// decide if more than `bytes` are needed.
pub(super) fn begins(bytes: &[u8], after: After, at: u64, kinds: Kinds) -> Result<bool, usize> {
    begins_before(bytes, after, at, kinds, FOLLOWERS)
}

/// Returns true if a record of these kinds begins at `at`, whatever follows. Fails as [`begins`].
pub(super) fn is_shown(bytes: &[u8], after: After, at: u64, kinds: Kinds) -> Result<bool, usize> {
    let at = at as usize;
    let extent = measure(bytes.get(at..).unwrap_or_default(), after).map_err(|count| at + count)?;
    Ok(extent.is_some_and(|extent| shows(&extent) && kinds(extent.kind)))
}

/// The same, with this number of records to follow.
fn begins_before(
    bytes: &[u8],
    after: After,
    at: u64,
    kinds: Kinds,
    followers: u8,
) -> Result<bool, usize> {
    // Limits the memory.
    if at > MAX_CHUNK_BYTES {
        return Ok(followers < FOLLOWERS);
    }
    let at = at as usize;
    if after != After::More && at >= bytes.len() {
        // The record before ends here, or was cut off.
        return Ok(match at > bytes.len() {
            true => followers == 0 && matches!(after, After::End | After::Magic),
            false => matches!(after, After::End | After::Nothing),
        });
    }
    let extent = measure(bytes.get(at..).unwrap_or_default(), after).map_err(|count| at + count)?;
    match extent {
        None => Ok(false),
        // Not at the end of a whole file. Any last byte may look like a kind of a later version.
        Some(extent) if extent.is_endless() && (kind::FOOTER..0x10).contains(&extent.kind) => {
            Ok(after == After::End && followers < FOLLOWERS)
        }
        Some(extent) if !kinds(extent.kind) => Ok(false),
        // Up to two bytes before a chunk, its lengths agree, too.
        Some(extent) if extent.is_chunk && !extent.is_proved() => {
            let is_chunk = |at| is_shown(bytes, after, at, |kind| kind == kind::CHUNK);
            Ok(!is_chunk(at as u64 + 1)? && !is_chunk(at as u64 + 2)?)
        }
        Some(extent) if shows(&extent) => Ok(true),
        Some(extent) if extent.end > MAX_CHUNK_BYTES => Ok(false),
        Some(_) if followers == 0 => Ok(true),
        Some(extent) => {
            let is_end = extent.kind == kind::DATA_END;
            let may_be_cut = is_end || extent.kind == kind::MESSAGE;
            let after = match after {
                After::End if !may_be_cut => After::Nothing,
                After::Magic if !may_be_cut => After::MagicOnly,
                after => after,
            };
            let followers = if is_end && extent.is_proved() { 0 } else { followers - 1 };
            begins_before(bytes, after, at as u64 + extent.end, |_| true, followers)
        }
    }
}

/// Returns where the record after this one begins, whose lengths do not prove its end. If that is not
/// at its end, its length is wrong, or its first byte is a stray one. Searches as far as `known`.
pub(super) fn next_start<E>(
    extent: &Extent,
    known: u64,
    mut begins: impl FnMut(u64) -> Result<bool, E>,
) -> Result<u64, E> {
    // More fields may be records, if they are long enough: then the length is wrong.
    let shortest = if extent.counts { MESSAGE_BYTES } else { RECORD_HEAD as u64 };
    let more = match extent.end - extent.fields {
        more if more < shortest => extent.end,
        // Its fields are records.
        _ if extent.is_chunk => extent.fields,
        _ => 1,
    };
    // A chunk begins here, whatever follows. The end of another record is right if that is found.
    let right = if extent.is_chunk { extent.end } else { 0 };
    let ends = (more..extent.end.min(known)).chain([right]);
    // A chunk that is cut off has no record of the file in it: its messages may look like some. One
    // without its lengths ends somewhere.
    let is_cut_off = extent.is_chunk && (known + 1..=MAX_CHUNK_BYTES).contains(&extent.end);
    let searched = if is_cut_off { 1 } else { extent.end.min(known) };
    for at in std::iter::once(1).chain(ends).chain(1..searched) {
        if (at < known || at == right) && begins(at)? {
            return Ok(if at == 0 { extent.end } else { at });
        }
    }
    Ok(extent.end)
}

/// Returns true for the content of a message index, which looks like a message if its kind is damaged:
/// the length of its entries as the number, and an offset in its chunk as the publish time.
pub(super) fn is_message_index(content: &[u8]) -> bool {
    MessageHeader::parse(content).is_some_and(|(header, _)| {
        let is_length = header.sequence > 0 && header.sequence % 16 == 0;
        is_length && header.publish_time < MAX_CHUNK_BYTES
    })
}

/// Returns true if a record has what its kind must have. Other readers refuse a text that is not UTF-8.
pub(super) fn is_well_formed(kind: u8, content: &[u8]) -> bool {
    let mut fields = Fields(content);
    match kind {
        kind::HEADER => fields.string().and(fields.string()).is_some(),
        kind::SCHEMA => {
            let number = fields.u16().filter(|number| *number > 0);
            number.and(fields.string()).and(fields.string()).and(fields.bytes()).is_some()
        }
        kind::CHANNEL => {
            let numbers = fields.u16().and(fields.u16());
            numbers.and(fields.string()).and(fields.string()).and(map(&mut fields)).is_some()
        }
        kind::METADATA => parse_metadata(content).is_some(),
        kind::MESSAGE => MessageHeader::parse(content).is_some(),
        _ => true,
    }
}

pub(crate) fn parse_metadata(content: &[u8]) -> Option<(&str, BTreeMap<&str, &str>)> {
    let mut fields = Fields(content);
    Some((fields.string()?, map(&mut fields)?))
}

/// Returns `None` for a key that is there twice, as in zeros: other readers refuse it, too.
pub(super) fn map<'a>(fields: &mut Fields<'a>) -> Option<BTreeMap<&'a str, &'a str>> {
    let mut rest = Fields(fields.bytes()?);
    let mut pairs = BTreeMap::new();
    while !rest.0.is_empty() {
        let before = pairs.insert(rest.string()?, rest.string()?);
        before.is_none().then_some(())?;
    }
    Some(pairs)
}
