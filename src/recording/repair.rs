//! [`repair`]: makes a complete file of one that is cut off or damaged, without
//! replaying it.

use std::io::{Read, Write};

use super::RecordingError;
use super::mcap::{
    Fields, FileError, McapWriter, MessageHeader, Section, Sections, header, kind, split_record,
};

/// The outcome of [`repair`].
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Repaired {
    /// True if the end of the file was missing.
    pub was_truncated: bool,
    /// The number of damaged parts that were left out. Each is a chunk, about a
    /// second of a recording.
    pub damaged_parts: u64,
    /// The places of the first of them in the file, at most 16.
    pub damaged_at: Vec<u64>,
}

/// The number of places of damage that are kept.
const MAX_PLACES: usize = 16;

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
    let mut sections = Sections::new(input);
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
        copy(&sections, section, &mut writer).map_err(RecordingError::write)?;
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
                repaired.damaged_parts += 1;
                if repaired.damaged_at.len() < MAX_PLACES {
                    repaired.damaged_at.push(offset);
                }
            }
            outcome => return outcome.map_err(RecordingError::from),
        }
    }
}

fn copy<W: Write>(
    sections: &Sections,
    section: Section,
    writer: &mut McapWriter<W>,
) -> std::io::Result<()> {
    match section {
        // The records of a chunk without a checksum may not add up.
        Section::Chunk { record, records } if is_sound(sections.bytes(records.clone())) => {
            writer.copy_chunk(sections.bytes(record), sections.bytes(records))
        }
        Section::Chunk { records, .. } | Section::CutChunk { records } => {
            let mut rest = sections.bytes(records);
            while let Some((kind, content, behind)) = split_record(rest) {
                copy_record(kind, content, writer)?;
                rest = behind;
            }
            Ok(())
        }
        Section::Record { kind, content } => copy_record(kind, sections.bytes(content), writer),
    }
}

/// Checks that a chunk consists of whole records, and that its messages have
/// their header.
fn is_sound(mut records: &[u8]) -> bool {
    while let Some((kind, content, behind)) = split_record(records) {
        if kind == kind::MESSAGE && MessageHeader::parse(content).is_none() {
            return false;
        }
        records = behind;
    }
    records.is_empty()
}

fn copy_record<W: Write>(
    kind: u8,
    content: &[u8],
    writer: &mut McapWriter<W>,
) -> std::io::Result<()> {
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
    Ok(())
}
