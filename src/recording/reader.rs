//! [`Recording`]: a file read from its beginning, as far as it goes.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use mcap::parse_record;
use mcap::records::{MessageHeader, Record as McapRecord};

use super::record::{Entry, Record, Reply, parse_command};
use super::records::Records;
use super::topics::Topic;
use super::{Event, METADATA, RecordingError};
use crate::ros;
use crate::{Rate, Window};

/// How many records are read to find the metadata: it stands near the
/// beginning.
const HEAD: usize = 256;

/// A recording, read record by record, in the order in which they were written.
///
/// What is missing at the end, after a kill or a full disk, is no error: what
/// was recorded before is read, and [`is_truncated`](Self::is_truncated) tells.
/// Reading blocks, for as long as a file takes.
///
/// ```no_run
/// use tokio_scip::recording::{Entry, Recording};
///
/// for record in Recording::open("run.mcap")? {
///     if let Entry::Scan(scan) = record?.entry {
///         println!("{:?} {:?}", scan.stamp, scan.ranges);
///     }
/// }
/// # Ok::<(), tokio_scip::recording::RecordingError>(())
/// ```
pub struct Recording {
    records: Records,
    channels: HashMap<u16, Topic>,
    metadata: BTreeMap<String, String>,
    /// Read, and not given out yet.
    ahead: VecDeque<Record>,
    ended: bool,
}

impl Recording {
    /// Opens a recording, and reads its beginning.
    ///
    /// # Errors
    ///
    /// [`RecordingError::Open`] if there is no such file or it may not be read,
    /// [`RecordingError::NotMcap`], [`RecordingError::Read`] and
    /// [`RecordingError::Damaged`] for what is in it.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, RecordingError> {
        let path = path.as_ref();
        let file = File::open(path).map_err(|error| RecordingError::Open {
            path: path.to_owned(),
            source: Arc::new(error),
        })?;
        Self::read(file)
    }

    /// Reads a recording from anything that has its bytes.
    ///
    /// # Errors
    ///
    /// Those of [`open`](Self::open), but for those of opening a file.
    pub fn read(input: impl Read + Send + 'static) -> Result<Self, RecordingError> {
        let mut recording = Self {
            records: Records::new(input),
            channels: HashMap::new(),
            metadata: BTreeMap::new(),
            ahead: VecDeque::new(),
            ended: false,
        };
        while recording.metadata.is_empty() && recording.ahead.len() < HEAD {
            let Some(record) = recording.advance()? else { break };
            recording.ahead.push_back(record);
        }
        Ok(recording)
    }

    /// What was written down of the sensor, by
    /// [`Recorder::describe`](super::Recorder::describe): `vendor`, `product`,
    /// `firmware`, `protocol`, `serial_number`, `status`, `baud_rate` (`none` on
    /// USB), `start`, `end`, `cluster`, `rate`. Empty if nothing was.
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.metadata
    }

    /// The window of the stream that was recorded, if it was written down.
    pub fn window(&self) -> Option<Window> {
        let number = |key| self.metadata.get(key)?.parse().ok();
        let window = Window::new(number("start")?..=number("end")?).ok()?;
        window.with_cluster_count(number("cluster")?.try_into().ok()?).ok()
    }

    /// The rate of the stream that was recorded, if it was written down.
    pub fn rate(&self) -> Option<Rate> {
        self.metadata.get("rate")?.parse().ok()
    }

    /// True once the end was reached and the file's end was missing: the
    /// recorder was killed, the disk full, or it is being recorded still.
    pub fn is_truncated(&self) -> bool {
        self.records.is_truncated()
    }

    /// The next record of a kind that is known. Nothing comes after an error.
    fn advance(&mut self) -> Result<Option<Record>, RecordingError> {
        if self.ended {
            return Ok(None);
        }
        let outcome = self.next_known();
        self.ended = !matches!(outcome, Ok(Some(_)));
        outcome
    }

    fn next_known(&mut self) -> Result<Option<Record>, RecordingError> {
        while let Some((kind, content)) = self.records.next()? {
            match parse_record(kind, content).map_err(RecordingError::read)? {
                McapRecord::Channel(channel) => {
                    let known = Topic::ALL.into_iter().find(|topic| topic.name() == channel.topic);
                    self.channels.extend(known.map(|known| (channel.id, known)));
                }
                McapRecord::Metadata(metadata) if metadata.name == METADATA => {
                    self.metadata = metadata.metadata;
                }
                McapRecord::Message { header, data } => {
                    let Some(channel) = self.channels.get(&header.channel_id) else { continue };
                    let entry = decode(*channel, &header, &data).ok_or_else(|| {
                        RecordingError::Damaged {
                            reason: "a message is not of its type".to_owned(),
                        }
                    })?;
                    let (at, sequence) = (time(header.log_time), header.sequence);
                    return Ok(Some(Record { at, sequence, entry }));
                }
                _ => {}
            }
        }
        Ok(None)
    }
}

impl Iterator for Recording {
    type Item = Result<Record, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.ahead.pop_front().map(Ok).or_else(|| self.advance().transpose())
    }
}

impl fmt::Debug for Recording {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Recording").field("metadata", &self.metadata).finish_non_exhaustive()
    }
}

/// Decodes a message, or returns `None` if it is not of its topic's type.
fn decode(topic: Topic, header: &MessageHeader, message: &[u8]) -> Option<Entry> {
    match topic {
        Topic::Scans => ros::read_scan(message).map(Entry::Scan),
        Topic::Events => {
            let text = ros::read_text(message)?;
            let unknown = || Event::Unknown { text: text.to_owned() };
            Some(Entry::Event(text.parse().unwrap_or_else(|_| unknown())))
        }
        Topic::Replies => {
            let (command, bytes) = ros::read_labelled_bytes(message)?;
            let command = parse_command(command);
            let stamp = time(header.publish_time);
            Some(Entry::Reply(Reply { command, bytes: bytes.to_vec(), stamp }))
        }
    }
}

fn time(nanos: u64) -> SystemTime {
    SystemTime::UNIX_EPOCH + Duration::from_nanos(nanos)
}
