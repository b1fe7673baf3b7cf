//! [`Records`]: the records of a file one by one, those in chunks included, and the
//! form that a record of each kind must have.

use std::io::Read;
use std::ops::Range;

use super::read::{FileError, Section, Sections};
use super::{Fields, MessageHeader, RECORD_HEAD, kind};

/// The reason of damage that no checksum covers.
const MALFORMED: &str = "a record is not of its form";

/// The kind of a record and the length of its content.
pub(super) fn record_head(bytes: &[u8]) -> Option<(u8, u64)> {
    let (&kind, rest) = bytes.split_first()?;
    Some((kind, Fields(rest).u64()?))
}

/// Returns how long the fields of a record are, or `None` if they are longer than
/// `content`. Without such a check a damaged length skips the chunks behind.
pub(super) fn fields_length(kind: u8, content: &[u8]) -> Option<usize> {
    let (numbers, texts) = match kind {
        kind::HEADER | kind::METADATA => (0, 2),
        kind::SCHEMA => (1, 3),
        kind::CHANNEL => (2, 3),
        // Messages are as long as they are; the others are not read.
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

/// Checks that a record has the fields of its kind, and nothing behind them. A
/// repaired file has no others, and the reader returns no others, so that both have
/// the same.
pub(in super::super) fn is_well_formed(kind: u8, content: &[u8]) -> bool {
    match kind {
        kind::MESSAGE => MessageHeader::parse(content).is_some(),
        kind::METADATA => parse_metadata(content).is_some(),
        _ => fields_length(kind, content) == Some(content.len()),
    }
}

/// Splits metadata into its name and its pairs.
pub(in super::super) fn parse_metadata(content: &[u8]) -> Option<(&str, Vec<(&str, &str)>)> {
    let mut fields = Fields(content);
    let (name, mut rest) = (fields.string()?, Fields(fields.bytes()?));
    let mut pairs = Vec::new();
    while !rest.0.is_empty() {
        pairs.push((rest.string()?, rest.string()?));
    }
    fields.0.is_empty().then_some((name, pairs))
}

/// Splits off the first record of a chunk: its kind, its content, and the rest.
pub(in super::super) fn split_record(records: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (kind, length) = record_head(records)?;
    let rest = records.get(RECORD_HEAD..)?;
    let (content, rest) = rest.split_at_checked(usize::try_from(length).ok()?)?;
    Some((kind, content, rest))
}

/// Reads the records of a file, those in chunks included.
pub(in super::super) struct Records {
    sections: Sections,
    /// The records of the current chunk that were not returned yet.
    rest: Range<usize>,
    is_cut: bool,
}

impl Records {
    pub(in super::super) fn new(input: impl Read + Send + 'static) -> Self {
        Self { sections: Sections::new(input), rest: 0..0, is_cut: false }
    }

    /// Returns true if the file was read and its end is missing.
    pub(in super::super) fn is_truncated(&self) -> bool {
        self.sections.is_truncated()
    }

    /// Returns the place of the latest record's section in the file.
    pub(in super::super) fn offset(&self) -> u64 {
        self.sections.offset()
    }

    /// Returns the kind and content of the next record, or `None` at the end of
    /// the data. Only [`FileError::Damaged`] is followed by more.
    pub(in super::super) fn next(&mut self) -> Result<Option<(u8, &[u8])>, FileError> {
        loop {
            if !self.rest.is_empty() {
                let rest = self.rest.clone();
                let Some((kind, content, behind)) = split_record(self.sections.bytes(rest.clone()))
                else {
                    self.rest = 0..0;
                    if std::mem::take(&mut self.is_cut) {
                        continue;
                    }
                    return Err(self.sections.damaged("a chunk ends in the middle of a record"));
                };
                let is_right = is_well_formed(kind, content);
                let content = rest.end - behind.len() - content.len()..rest.end - behind.len();
                self.rest = content.end..rest.end;
                if !is_right {
                    return Err(self.sections.damaged(MALFORMED));
                }
                return Ok(Some((kind, self.sections.bytes(content))));
            }
            match self.sections.next()? {
                None => return Ok(None),
                Some(Section::Record { kind, content }) => {
                    if !is_well_formed(kind, self.sections.bytes(content.clone())) {
                        return Err(self.sections.damaged(MALFORMED));
                    }
                    return Ok(Some((kind, self.sections.bytes(content))));
                }
                Some(Section::Chunk { records, .. }) => {
                    (self.rest, self.is_cut) = (records, false);
                }
                Some(Section::CutChunk { records }) => {
                    (self.rest, self.is_cut) = (records, true);
                }
            }
        }
    }
}
