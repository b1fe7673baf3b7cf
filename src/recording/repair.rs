//! [`repair`]: makes a complete file of one that is cut off or damaged, without
//! replaying it.

use std::io::{Read, Write};

use super::RecordingError;
use super::mcap::{
    Fields, FileError, Input, McapWriter, MessageHeader, Section, Sections, header, is_well_formed,
    kind, split_record,
};

/// The outcome of [`repair`].
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Repaired {
    /// True if the end of the file was missing.
    pub was_truncated: bool,
    /// The number of damaged parts that were left out. Each is a chunk, about a
    /// second of a recording, or the malformed records of a chunk without a checksum.
    pub damaged_parts: u64,
    /// The places of the first of them in the file, at most 16.
    pub damaged_at: Vec<u64>,
}

/// The number of places of damage that are kept.
const MAX_PLACES: usize = 16;

impl Repaired {
    fn add_damage(&mut self, offset: u64) {
        self.damaged_parts += 1;
        if self.damaged_at.len() < MAX_PLACES {
            self.damaged_at.push(offset);
        }
    }
}

/// Copies a recording that is cut off or damaged to `output` as a complete file,
/// which other readers open.
///
/// All messages that [`Recording`](super::Recording) reads are copied byte for
/// byte, with their times, also those of other topics. The index is made anew.
/// Damaged parts, attachments and records of no standard kind are left out. A
/// file that is whole is copied, too.
///
/// Blocks the thread. Memory is that of the longest chunk and 100 bytes for each
/// chunk.
///
/// # Errors
///
/// Fails with [`RecordingError::NotMcap`] and [`RecordingError::Compressed`] if
/// the input is no recording of this crate, [`RecordingError::Read`] if reading
/// it fails, and [`RecordingError::Write`] if writing the output fails, which is
/// incomplete then.
///
/// ```no_run
/// use std::fs::File;
///
/// let repaired = tokio_scip::recording::repair(File::open("cut.mcap")?, File::create_new("whole.mcap")?)?;
/// println!("{} damaged parts left out", repaired.damaged_parts);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn repair(
    input: impl Read + Send + 'static,
    output: impl Write,
) -> Result<Repaired, RecordingError> {
    let mut sections = Sections::new(Input::Stream(Box::new(input)));
    let mut repaired = Repaired::default();
    // The header comes first, and nothing is written before the input is known to
    // be a recording.
    let mut next = next_section(&mut sections, &mut repaired)?;
    let header = match &next {
        Some(Section::Record { kind: kind::HEADER, content }) => {
            sections.bytes(content.clone()).to_vec()
        }
        _ => header("ros2", ""),
    };
    let mut writer =
        McapWriter::start(output, &header, usize::MAX).map_err(RecordingError::write)?;
    while let Some(section) = next {
        if !copy(&sections, section, &mut writer).map_err(RecordingError::write)? {
            repaired.add_damage(sections.offset());
        }
        next = next_section(&mut sections, &mut repaired)?;
    }
    writer.finish().map_err(RecordingError::write)?;
    repaired.was_truncated = sections.is_truncated();
    Ok(repaired)
}

/// Returns the next section that is not damaged.
fn next_section(
    sections: &mut Sections,
    repaired: &mut Repaired,
) -> Result<Option<Section>, RecordingError> {
    loop {
        match sections.next() {
            Err(FileError::Damaged { offset, .. }) => {
                repaired.add_damage(offset);
            }
            outcome => return outcome.map_err(RecordingError::from),
        }
    }
}

/// Copies what is well-formed of a section. Returns false if a part of it is not.
fn copy<W: Write>(
    sections: &Sections,
    section: Section,
    writer: &mut McapWriter<W>,
) -> std::io::Result<bool> {
    match section {
        Section::Chunk { record, records } if is_copied_whole(sections.bytes(records.clone())) => {
            writer.copy_chunk(sections.bytes(record), sections.bytes(records))?;
            Ok(true)
        }
        // The records of a chunk without a checksum may not add up.
        Section::Chunk { records, .. } => {
            let (is_right, rest) = copy_records(sections.bytes(records), writer)?;
            Ok(is_right && rest.is_empty())
        }
        // That the last record is cut off is no damage.
        Section::CutChunk { records } => {
            copy_records(sections.bytes(records), writer).map(|(is_right, _)| is_right)
        }
        Section::Record { kind, content } => copy_record(kind, sections.bytes(content), writer),
    }
}

/// Checks that a chunk consists of whole, well-formed records that may stand in it.
fn is_copied_whole(mut records: &[u8]) -> bool {
    while let Some((kind, content, behind)) = split_record(records) {
        if kind == kind::METADATA || !is_well_formed(kind, content) {
            return false;
        }
        records = behind;
    }
    records.is_empty()
}

/// Returns false if a record was left out, and the bytes behind the last whole one.
fn copy_records<'a, W: Write>(
    mut records: &'a [u8],
    writer: &mut McapWriter<W>,
) -> std::io::Result<(bool, &'a [u8])> {
    let mut is_right = true;
    while let Some((kind, content, behind)) = split_record(records) {
        is_right &= copy_record(kind, content, writer)?;
        records = behind;
    }
    Ok((is_right, records))
}

/// Returns false if the record is malformed, and left out.
fn copy_record<W: Write>(
    kind: u8,
    content: &[u8],
    writer: &mut McapWriter<W>,
) -> std::io::Result<bool> {
    if !is_well_formed(kind, content) {
        return Ok(false);
    }
    match kind {
        kind::SCHEMA | kind::CHANNEL => writer.declare(kind, content),
        kind::METADATA => {
            if let Some(name) = Fields(content).string() {
                writer.copy_metadata(name, content)?;
            }
        }
        kind::MESSAGE => {
            if let Some((header, data)) = MessageHeader::parse(content) {
                writer.message(header, data)?;
            }
        }
        _ => {}
    }
    Ok(true)
}
