//! [`cut`]: copies a part of a recording, or all files of a split one, into one file. Keeps the
//! recorded times.

use std::collections::HashSet;
use std::io::{self, Read, Write};
use std::ops::RangeBounds;
use std::time::{Duration, SystemTime};

use super::RecordingError;
use super::mcap::{Fields, Input, McapWriter, MessageHeader, Records, header, kind};
use super::messages::{InvalidMessage, Messages};
use super::range::{RecordPlace, TimeRange};
use super::record::{Entry, Record};
use tokio_scip::protocol::Command;

/// Time span of a chunk in the copy: about a second of messages, as in a recording.
const CHUNK_SPAN: u64 = 1_000_000_000;

/// Outcome of [`cut`].
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct CutOutcome {
    /// Number of messages copied.
    pub messages: u64,
    /// Number of scans among them.
    pub scans: u64,
    /// Number of damaged parts left out, each about a second.
    pub damaged_parts: u64,
    /// True if the end of a file was missing or damaged.
    pub was_truncated: bool,
}

/// Copies the part of a recording in `range`, counted from the first scan, to `output`. Pass all
/// files of a split recording as `inputs`, in their order.
///
/// Messages of all topics keep their bytes, times and numbers. You can replay the copy: it gets the
/// metadata and the sensor's version even if they lie before the part. The version is then dated to
/// the start of the part.
///
/// Blocks the thread, and reads all inputs up to the end of the part.
///
/// # Errors
///
/// Fails with [`RecordingError::NotMcap`] if an input is no recording,
/// [`RecordingError::Compressed`] if this build does not read its compression,
/// [`RecordingError::Read`] if reading fails, and [`RecordingError::Write`] if
/// writing does. The output is then incomplete.
///
/// ```no_run
/// use std::fs::File;
/// use std::time::Duration;
///
/// use urg_recording::cut;
///
/// let files = [File::open("run.mcap")?, File::open("run_0002.mcap")?];
/// let from = Duration::from_secs(3500);
/// let outcome = cut(files, from..from + Duration::from_secs(200), File::create_new("part.mcap")?)?;
/// println!("{} scans", outcome.scans);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn cut<R: Read + Send + 'static>(
    inputs: impl IntoIterator<Item = R>,
    range: impl RangeBounds<Duration>,
    output: impl Write,
) -> Result<CutOutcome, RecordingError> {
    let mut writer = None;
    let mut output = Some(output);
    let mut cut = Cutting {
        messages: Messages::default(),
        range: TimeRange::new(&range),
        version: None,
        metadata: HashSet::new(),
        chunk_began: None,
        outcome: CutOutcome::default(),
    };
    for input in inputs {
        let mut records = Records::new(Input::Stream(Box::new(input)));
        loop {
            let (kind, content) = match records.next() {
                Ok(Some(record)) => record,
                Ok(None) => break,
                Err(error) => match RecordingError::from(error) {
                    RecordingError::Damaged { .. } => {
                        cut.outcome.damaged_parts += 1;
                        continue;
                    }
                    error => return Err(error),
                },
            };
            // Write nothing before an input is known to be a recording.
            let writer = match (&mut writer, output.take()) {
                (Some(writer), _) => writer,
                (none, Some(output)) => {
                    let head = if kind == kind::HEADER { content } else { &header("ros2", "") };
                    let started = McapWriter::start(output, head, usize::MAX);
                    none.insert(started.map_err(RecordingError::write)?)
                }
                (None, None) => break,
            };
            let goes_on = cut.record(kind, content, writer).map_err(RecordingError::write)?;
            if !goes_on {
                return cut.finish(Some(writer));
            }
        }
        cut.outcome.was_truncated |= records.is_truncated();
    }
    cut.finish(writer.as_mut())
}

/// Cut in progress.
struct Cutting {
    messages: Messages,
    range: TimeRange,
    /// Message with the sensor's version, until the part begins.
    version: Option<(MessageHeader, Vec<u8>)>,
    /// Metadata copied so far: each file of a split recording repeats it.
    metadata: HashSet<Vec<u8>>,
    /// Time of the first message in the open chunk.
    chunk_began: Option<u64>,
    outcome: CutOutcome,
}

impl Cutting {
    /// Copies a record if it belongs to the part. Returns false after the end of the part.
    fn record<W: Write>(
        &mut self,
        kind: u8,
        content: &[u8],
        writer: &mut McapWriter<W>,
    ) -> io::Result<bool> {
        match kind {
            kind::SCHEMA | kind::CHANNEL => {
                self.messages.define(kind, content);
                writer.declare(kind, content);
            }
            kind::METADATA => {
                if let Some(name) = Fields(content).string()
                    && self.metadata.insert(content.to_vec())
                {
                    writer.copy_metadata(name, content)?;
                }
            }
            kind::MESSAGE => {
                let Some((header, data)) = MessageHeader::parse(content) else { return Ok(true) };
                let record = match self.messages.parse(content) {
                    Ok(record) => record,
                    Err(InvalidMessage) => {
                        self.outcome.damaged_parts += 1;
                        return Ok(true);
                    }
                };
                return self.message(record.as_ref(), header, data, writer);
            }
            _ => {}
        }
        Ok(true)
    }

    fn message<W: Write>(
        &mut self,
        record: Option<&Record>,
        header: MessageHeader,
        data: &[u8],
        writer: &mut McapWriter<W>,
    ) -> io::Result<bool> {
        let place = match record {
            Some(record) => self.range.place(record),
            None => {
                let at = SystemTime::UNIX_EPOCH + Duration::from_nanos(header.log_time);
                self.range.place_of(at)
            }
        };
        if record.is_some_and(is_version) {
            let is_known = self.version.as_ref().is_some_and(|(known, version)| {
                known.publish_time == header.publish_time && version == data
            });
            // Each file of a split recording begins with the version.
            if !is_known {
                self.version = Some((header, data.to_vec()));
            }
            if is_known || self.chunk_began.is_none() {
                return Ok(true);
            }
        }
        match place {
            RecordPlace::Behind => return Ok(false),
            RecordPlace::Outside => return Ok(true),
            RecordPlace::Inside => {}
        }
        let began = self.chunk_began.unwrap_or(header.log_time);
        if self.chunk_began.is_none()
            && let Some((version, data)) = &self.version
        {
            writer.message(MessageHeader { log_time: header.log_time, ..*version }, data)?;
            self.outcome.messages += 1;
        }
        self.chunk_began = Some(began);
        if header.log_time.saturating_sub(began) >= CHUNK_SPAN {
            writer.flush()?;
            self.chunk_began = Some(header.log_time);
        }
        writer.message(header, data)?;
        self.outcome.messages += 1;
        self.outcome.scans += u64::from(record.is_some_and(is_scan));
        Ok(true)
    }

    fn finish<W: Write>(
        self,
        writer: Option<&mut McapWriter<W>>,
    ) -> Result<CutOutcome, RecordingError> {
        if let Some(writer) = writer {
            writer.end().map_err(RecordingError::write)?;
        }
        Ok(self.outcome)
    }
}

fn is_version(record: &Record) -> bool {
    matches!(&record.entry, Entry::Reply(reply)
        if reply.command == Some(Command::Version) && reply.parse().is_some())
}

fn is_scan(record: &Record) -> bool {
    matches!(record.entry, Entry::Scan(_))
}
