//! [`Records`]: the records of a file one by one, including those in chunks.

use std::collections::HashSet;
use std::ops::{Range, RangeInclusive};

use super::form::{After, Unmeasured, begins, is_known, is_well_formed, measure, next_start};
use super::input::FileIndex;
use super::read::{Section, Sections};
use super::{ChunkBytes, Fields, Input, RECORD_HEAD, kind};
use crate::RecordingError;

/// Reads the well-formed records of a file, including those in chunks.
#[derive(Default)]
pub(in super::super) struct Records {
    sections: Sections,
    /// Records of the current chunk that were not returned yet.
    rest: Range<usize>,
    is_cut: bool,
    /// True if a checksum proves the chunk.
    is_proved: bool,
    /// Channels defined so far.
    channels: HashSet<u16>,
    /// Index of the file, once its definitions are needed.
    index: Option<FileIndex>,
    /// Position of the last reported damage.
    damaged_at: Option<u64>,
}

impl Records {
    pub(in super::super) fn new(input: Input) -> Self {
        Self { sections: Sections::new(input), ..Self::default() }
    }

    /// Returns true if the whole file was read and its end is missing.
    pub(in super::super) fn is_truncated(&self) -> bool {
        self.sections.is_truncated
    }

    /// Bytes of the chunks so far.
    pub(in super::super) fn chunk_bytes(&self) -> &ChunkBytes {
        &self.sections.chunk_bytes
    }

    /// Leaves out chunks without a message at these times, if the file's index lists them.
    /// Returns its definitions next: the chunks may have them.
    pub(in super::super) fn leave_out_others(
        &mut self,
        times: &RangeInclusive<u64>,
    ) -> Result<(), RecordingError> {
        let index = self.sections.index()?;
        self.sections.unwanted = index.parts_outside(times).into();
        self.index = Some(index);
        Ok(())
    }

    /// Reports the latest record as damaged. Returns the position of its section, once: however many
    /// of its records are damaged.
    pub(in super::super) fn report_damage(&mut self) -> Option<u64> {
        let offset = self.sections.offset();
        self.is_news(offset).then_some(offset)
    }

    fn is_news(&mut self, damaged_at: u64) -> bool {
        self.damaged_at.replace(damaged_at) != Some(damaged_at)
    }

    /// Reads the kind and content of the next record, or returns `None` at the end of the
    /// data. A message is of a channel before it. After the first damage, which may have hit
    /// definitions, the definitions in the file's index follow. After an error other than
    /// [`RecordingError::Damaged`], no records follow.
    pub(in super::super) fn next(&mut self) -> Result<Option<(u8, &[u8])>, RecordingError> {
        if let Some((kind, place)) = self.index.as_mut().and_then(FileIndex::next_definition) {
            let content = self.index.as_ref().map(|index| index.bytes(place)).unwrap_or_default();
            if kind == kind::CHANNEL {
                self.channels.extend(Fields(content).u16());
            }
            return Ok(Some((kind, content)));
        }
        loop {
            match self.next_place() {
                Ok(place) => {
                    return Ok(place.map(|(kind, content)| (kind, self.sections.bytes(content))));
                }
                Err(RecordingError::Damaged { offset, .. }) if !self.is_news(offset) => {}
                Err(error) => {
                    if matches!(error, RecordingError::Damaged { .. }) && self.index.is_none() {
                        self.index = Some(self.sections.index()?);
                    }
                    return Err(error);
                }
            }
        }
    }

    /// Finds the next record among the bytes of the section.
    fn next_place(&mut self) -> Result<Option<(u8, Range<usize>)>, RecordingError> {
        loop {
            if self.rest.is_empty() {
                match self.sections.next()? {
                    None => return Ok(None),
                    Some(Section::Record { kind, content }) => {
                        return self.check(kind, &content).map(|()| Some((kind, content)));
                    }
                    Some(Section::Chunk { records, is_cut, is_proved }) => {
                        (self.rest, self.is_cut, self.is_proved) = (records, is_cut, is_proved);
                    }
                }
                continue;
            }
            let rest = std::mem::take(&mut self.rest);
            let bytes = self.sections.bytes(rest.clone());
            let known = bytes.len() as u64;
            let after = if self.is_cut { After::EndOfFile } else { After::EndOfChunk };
            let extent = measure(bytes, after);
            let begins = |at, kinds| begins(bytes, after, at, kinds);
            let next = match &extent {
                Ok(extent) if self.is_proved => extent.end,
                Ok(extent) => {
                    let kinds = |at| if at == extent.end { |_| true } else { is_known };
                    next_start(extent, known, |at| begins(at, kinds(at))).unwrap_or(known)
                }
                Err(Unmeasured::Needs(_)) if self.is_cut => continue,
                Err(_) => {
                    let is_here = |at: &u64| begins(*at, is_known).unwrap_or_default();
                    (1..known).find(is_here).unwrap_or(known)
                }
            };
            let start = usize::try_from(next).unwrap_or(usize::MAX).saturating_add(rest.start);
            self.rest = start.min(rest.end)..rest.end;
            match extent {
                Ok(extent) if next == extent.end && next <= known => {
                    let content = rest.start + RECORD_HEAD..rest.start + extent.fields as usize;
                    return self
                        .check(extent.kind, &content)
                        .map(|()| Some((extent.kind, content)));
                }
                Ok(extent) if next == extent.end && self.is_cut => {}
                _ => return Err(self.sections.damaged("a record in a chunk has a wrong length")),
            }
        }
    }

    /// Checks what no checksum covers.
    fn check(&mut self, kind: u8, content: &Range<usize>) -> Result<(), RecordingError> {
        let content = self.sections.bytes(content.clone());
        if !is_well_formed(kind, content) {
            return Err(self.sections.damaged("a record is malformed"));
        }
        let number = Fields(content).u16().unwrap_or_default();
        if kind == kind::MESSAGE && !self.channels.contains(&number) {
            return Err(self.sections.damaged("the channel of a message is not defined"));
        }
        if kind == kind::CHANNEL {
            self.channels.insert(number);
        }
        Ok(())
    }
}
