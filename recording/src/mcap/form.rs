//! Form of a record: its head, its fields, and which fields each kind must have.

use super::{Fields, MAX_RECORD_BYTES, MessageHeader, RECORD_HEAD, kind};

/// Kind of a record and length of its content.
pub(super) fn record_head(bytes: &[u8]) -> Option<(u8, u64)> {
    let (&kind, rest) = bytes.split_first()?;
    Some((kind, Fields(rest).u64()?))
}

/// Length of a record's fields, or `None` if they are longer than `content`. Without this
/// check, a damaged length would skip the chunks after it.
pub(super) fn fields_length(kind: u8, content: &[u8]) -> Option<usize> {
    let (numbers, texts) = match kind {
        kind::HEADER | kind::METADATA => (0, 2),
        kind::SCHEMA => (1, 3),
        kind::CHANNEL => (2, 3),
        // Messages may have any length. The other kinds are not read.
        _ => return Some(content.len()),
    };
    let mut fields = Fields(content);
    for _ in 0..numbers {
        fields.u16()?;
    }
    for _ in 0..texts {
        fields.bytes()?;
    }
    Some(content.len() - fields.0.len())
}

/// Checks that a record has the fields of its kind and nothing else. Other readers refuse a text
/// that is not UTF-8.
pub(super) fn is_well_formed(kind: u8, content: &[u8]) -> bool {
    let mut fields = Fields(content);
    let is_right = match kind {
        kind::HEADER => fields.string().and(fields.string()).is_some(),
        kind::SCHEMA => {
            let number = fields.u16().filter(|number| *number > 0);
            number.and(fields.string()).and(fields.string()).and(fields.bytes()).is_some()
        }
        kind::CHANNEL => {
            let numbers = fields.u16().and(fields.u16());
            numbers.and(fields.string()).and(fields.string()).is_some()
                && map(&mut fields).is_some()
        }
        kind::METADATA => fields.string().is_some() && map(&mut fields).is_some(),
        kind::MESSAGE => return MessageHeader::parse(content).is_some(),
        _ => return true,
    };
    is_right && fields.0.is_empty() && content.len() as u64 <= MAX_RECORD_BYTES
}

/// Splits metadata into its name and its pairs.
pub(in super::super) fn parse_metadata(content: &[u8]) -> Option<(&str, Vec<(&str, &str)>)> {
    let mut fields = Fields(content);
    let (name, pairs) = (fields.string()?, map(&mut fields)?);
    fields.0.is_empty().then_some((name, pairs))
}

pub(super) fn map<'a>(fields: &mut Fields<'a>) -> Option<Vec<(&'a str, &'a str)>> {
    let mut rest = Fields(fields.bytes()?);
    let mut pairs = Vec::new();
    while !rest.0.is_empty() {
        pairs.push((rest.string()?, rest.string()?));
    }
    Some(pairs)
}

/// Splits off the first record of a chunk: its kind, its content, and the rest.
pub(super) fn split_record(records: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (kind, length) = record_head(records)?;
    let rest = records.get(RECORD_HEAD..)?;
    let (content, rest) = rest.split_at_checked(usize::try_from(length).ok()?)?;
    Some((kind, content, rest))
}
