//! [`Records`]: the records of a file one by one, including those in chunks.

use std::ops::{Range, RangeInclusive};

use super::Input;
use super::form::{is_well_formed, split_record};
use super::input::FileIndex;
use super::read::{FileError, Section, Sections};

/// Reason for damage that no checksum covers.
const MALFORMED: &str = "a record is malformed";

/// Reads the records of a file, including those in chunks.
pub(in super::super) struct Records {
    sections: Sections,
    /// Records of the current chunk that were not returned yet.
    rest: Range<usize>,
    is_cut: bool,
    /// Index of the file, once its definitions are needed.
    index: Option<FileIndex>,
}

impl Records {
    pub(in super::super) fn new(input: Input) -> Self {
        Self { sections: Sections::new(input), rest: 0..0, is_cut: false, index: None }
    }

    /// Returns true if the whole file was read and its end is missing.
    pub(in super::super) fn is_truncated(&self) -> bool {
        self.sections.is_truncated()
    }

    /// Position in the file of the latest record's section.
    pub(in super::super) fn offset(&self) -> u64 {
        self.sections.offset()
    }

    /// Leaves out chunks without a message at these times, if the file's index lists them.
    /// Returns its definitions next: the chunks may have them.
    pub(in super::super) fn leave_out_others(
        &mut self,
        times: &RangeInclusive<u64>,
    ) -> Result<(), FileError> {
        self.index = Some(self.sections.leave_out_others(times)?);
        Ok(())
    }

    /// Reads the kind and content of the next record, or returns `None` at the end of the
    /// data. After the first damage, which may have hit definitions, those of the file's index
    /// follow. After an error other than [`FileError::Damaged`], no records follow.
    pub(in super::super) fn next(&mut self) -> Result<Option<(u8, &[u8])>, FileError> {
        if let Some((kind, content)) = self.index.as_mut().and_then(FileIndex::next_definition) {
            let content = self.index.as_ref().map(|index| index.bytes(content));
            return Ok(Some((kind, content.unwrap_or_default())));
        }
        match self.next_place() {
            Ok(place) => Ok(place.map(|(kind, content)| (kind, self.sections.bytes(content)))),
            Err(error) => {
                if matches!(error, FileError::Damaged { .. }) && self.index.is_none() {
                    self.index = Some(self.sections.index()?);
                }
                Err(error)
            }
        }
    }

    /// Finds the next record among the bytes of the section.
    fn next_place(&mut self) -> Result<Option<(u8, Range<usize>)>, FileError> {
        loop {
            if !self.rest.is_empty() {
                let rest = self.rest.clone();
                let Some((kind, content, after)) = split_record(self.sections.bytes(rest.clone()))
                else {
                    self.rest = 0..0;
                    if std::mem::take(&mut self.is_cut) {
                        continue;
                    }
                    return Err(self.sections.damaged("a chunk ends in the middle of a record"));
                };
                let is_right = is_well_formed(kind, content);
                let content = rest.end - after.len() - content.len()..rest.end - after.len();
                self.rest = content.end..rest.end;
                if !is_right {
                    return Err(self.sections.damaged(MALFORMED));
                }
                return Ok(Some((kind, content)));
            }
            match self.sections.next()? {
                None => return Ok(None),
                Some(Section::Record { kind, content }) => {
                    if !is_well_formed(kind, self.sections.bytes(content.clone())) {
                        return Err(self.sections.damaged(MALFORMED));
                    }
                    return Ok(Some((kind, content)));
                }
                Some(Section::Chunk { records }) => (self.rest, self.is_cut) = (records, false),
                Some(Section::CutChunk { records }) => (self.rest, self.is_cut) = (records, true),
            }
        }
    }
}
