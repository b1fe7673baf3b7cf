//! [`Writer`]: turns scans, replies and events into messages of a file, and starts the
//! next file at a split. Knows no threads.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::time::{Duration, Instant, SystemTime};

use super::METADATA;
use super::mcap::{self, Compression, McapWriter, MessageHeader, kind, nanos};
use super::parts::{Counted, Parts};
use super::record::Topic;
use super::reply::{RecordedReply, identity_command};
use crate::ros::{self, since_1970};
use tokio_scip::Scan;

/// Name of the library in the file's header.
const LIBRARY: &str = concat!("tokio-scip ", env!("CARGO_PKG_VERSION"));
/// Longest time until a message is in the file: on the clock of the recording, which may be paused,
/// and on the real one once no message waits.
const CHUNK_SPAN: Duration = Duration::from_secs(1);
/// A file is split right after a scan, so that its reply is in the same file. If a consumer is always behind,
/// there is no such point; after this time the file is split anywhere.
const MAX_SPLIT_DELAY: Duration = Duration::from_secs(1);

/// Time of an event, on both clocks.
#[derive(Debug, Clone, Copy)]
pub(super) struct Times {
    pub(super) steady: Instant,
    pub(super) wall: SystemTime,
}

impl Times {
    pub(super) fn now() -> Self {
        // tokio's clock, which a simulation may have paused.
        let steady = tokio::time::Instant::now().into_std();
        Self { steady, wall: SystemTime::now() }
    }

    pub(super) fn of(scan: &Scan) -> Self {
        Self { steady: scan.received_at().into_std(), wall: scan.times().stamp }
    }

    /// Returns the wall-clock time of `at`, in nanoseconds since 1970. Assumes that the clock was not
    /// set in between.
    fn continued_to(&self, at: Instant) -> u64 {
        let since = at.saturating_duration_since(self.steady);
        let before = self.steady.saturating_duration_since(at);
        nanos((since_1970(self.wall) + since).saturating_sub(before))
    }
}

type Mcap = McapWriter<Counted>;

/// Writes a recording, in one file or several.
pub(super) struct Writer {
    mcap: Mcap,
    parts: Parts,
    /// Start of the log.
    began: Times,
    frame_id: String,
    compression: Compression,
    /// Numbers of replies and events.
    numbers: [u32; 2],
    message: Vec<u8>,
    /// Time of the chunk's first message: its log time, and the real time.
    chunk_began: Option<(u64, Instant)>,
    part: Part,
    // Each file begins with these, so that you can replay it alone.
    metadata: Option<Vec<u8>>,
    /// Latest successful replies that identify the sensor, by their commands: the message and its stamp.
    identity: BTreeMap<&'static str, (Vec<u8>, SystemTime)>,
}

/// State of the file being written.
#[derive(Debug, Default)]
struct Part {
    /// Log time of its first message.
    began: Option<u64>,
    /// Log time of the first message that belongs in the next file.
    full: Option<u64>,
    /// Stamp of its latest reply.
    reply: Option<SystemTime>,
    /// True after a scan whose reply was the latest.
    after_scan: bool,
}

impl Writer {
    pub(super) fn new(
        out: Box<dyn Write + Send>,
        parts: Parts,
        frame_id: String,
        compression: Compression,
    ) -> io::Result<Self> {
        let mut writer = Self {
            mcap: start(parts.count(out), compression)?,
            parts,
            began: Times::now(),
            frame_id,
            compression,
            numbers: [0; 2],
            message: Vec::with_capacity(4096),
            chunk_began: None,
            part: Part::default(),
            metadata: None,
            identity: BTreeMap::new(),
        };
        writer.parts.remove_old(writer.mcap.len());
        writer.flush()?;
        Ok(writer)
    }

    pub(super) fn scan(&mut self, scan: &Scan) -> io::Result<()> {
        ros::write_scan(&mut self.message, scan, scan.first_ray_stamp(), &self.frame_id);
        // The field has 32 bits. A gap is still a gap.
        self.write(Topic::Scans, scan.sequence() as u32, Times::of(scan))?;
        self.part.after_scan = self.part.reply.is_none_or(|reply| reply <= scan.times().stamp);
        Ok(())
    }

    /// `bytes` is a frame without its terminator.
    pub(super) fn reply(&mut self, request: &str, bytes: &[u8], times: Times) -> io::Result<()> {
        ros::write_labelled_bytes(&mut self.message, request, &[bytes, b"\n\n"]);
        let [number, _] = &mut self.numbers;
        let sequence = std::mem::replace(number, number.wrapping_add(1));
        self.write(Topic::Replies, sequence, times)?;
        self.part.reply = Some(times.wall);
        self.part.after_scan = false;
        let parsed = || RecordedReply::new(request, &[bytes, b"\n\n"].concat(), times.wall);
        if let Some(command) = identity_command(request)
            && parsed().identity().is_some()
        {
            self.identity.insert(command, (self.message.clone(), times.wall));
        }
        Ok(())
    }

    pub(super) fn event(&mut self, json: &str, times: Times) -> io::Result<()> {
        ros::write_text(&mut self.message, json);
        let [_, number] = &mut self.numbers;
        let sequence = std::mem::replace(number, number.wrapping_add(1));
        self.write(Topic::Events, sequence, times)
    }

    pub(super) fn metadata(&mut self, metadata: &BTreeMap<String, String>) -> io::Result<()> {
        let metadata = mcap::metadata(METADATA, metadata);
        self.step(|mcap| mcap.metadata(METADATA, &metadata))?;
        self.metadata = Some(metadata);
        Ok(())
    }

    /// Time until the chunk must be ended, or `None` without a message.
    pub(super) fn until_flush(&self) -> Option<Duration> {
        let (_, began) = self.chunk_began?;
        Some(CHUNK_SPAN.saturating_sub(began.elapsed()))
    }

    /// Ends the chunk: all messages so far are in the file and can be read.
    pub(super) fn flush(&mut self) -> io::Result<()> {
        self.step(McapWriter::flush)?;
        self.chunk_began = None;
        Ok(())
    }

    /// Writes the index and the end of the file.
    pub(super) fn finish(&mut self) -> io::Result<()> {
        self.flush()?;
        self.mcap.end()
    }

    /// Writes the encoded message.
    fn write(&mut self, topic: Topic, sequence: u32, times: Times) -> io::Result<()> {
        let log_time = self.began.continued_to(times.steady);
        if self.is_split_due(log_time) {
            self.flush()?;
            self.start_next_part(log_time)?;
        }
        let span = self.chunk_began.map(|(began, _)| log_time.saturating_sub(began));
        if span.is_some_and(|span| span >= nanos(CHUNK_SPAN)) {
            self.flush()?;
        }
        if topic == Topic::Events {
            declare(&mut self.mcap, topic);
        }
        self.chunk_began.get_or_insert_with(|| (log_time, Instant::now()));
        self.part.began.get_or_insert(log_time);
        let publish_time = nanos(since_1970(times.wall));
        let channel = topic.channel();
        let header = MessageHeader { channel, sequence, log_time, publish_time };
        let message = std::mem::take(&mut self.message);
        let written = self.step(|mcap| mcap.message(header, &message));
        self.message = message;
        written?;
        // Before the chunk is written, because the disk may have no room for both.
        self.parts.remove_old(self.mcap.len());
        Ok(())
    }

    /// Decides whether the message of this log time starts the next file.
    fn is_split_due(&mut self, log_time: u64) -> bool {
        let Part { began, full, after_scan, .. } = &mut self.part;
        let Some(began) = *began else { return false };
        let length = Duration::from_nanos(log_time.saturating_sub(began));
        let is_full = self.parts.is_full(length, self.mcap.len(), self.mcap.index.entries());
        if !is_full {
            return false;
        }
        let full = *full.get_or_insert(log_time);
        *after_scan || log_time.saturating_sub(full) >= nanos(MAX_SPLIT_DELAY)
    }

    /// Takes a step that may write a chunk. If the file may not grow so far, takes it in a further file.
    fn step(&mut self, step: impl Fn(&mut Mcap) -> io::Result<()>) -> io::Result<()> {
        match step(&mut self.mcap) {
            Err(error) if self.parts.continues_after(&error) => {
                self.outgrow()?;
                step(&mut self.mcap)
            }
            done => done,
        }
    }

    /// Continues in a further file with the open chunk, which this file has no room for.
    fn outgrow(&mut self) -> io::Result<()> {
        let records = self.mcap.take_records();
        self.parts.stay_below(self.mcap.offset);
        let began = self.chunk_began.map(|(began, _)| began).or(self.part.began);
        self.start_next_part(began.unwrap_or_default())?;
        // The chunk may have events.
        declare(&mut self.mcap, Topic::Events);
        self.part.began = began;
        self.mcap.add_messages(&records)
    }

    fn start_next_part(&mut self, log_time: u64) -> io::Result<()> {
        // End the file first: if there is no room for another one, this one is complete.
        match self.mcap.end() {
            Err(error) if self.parts.continues_after(&error) => {
                tracing::warn!("a file has no room for its end, which `repair` adds");
            }
            ended => ended?,
        }
        self.mcap = start(self.parts.next()?, self.compression)?;
        self.part = Part::default();
        // First, because the metadata are written at once.
        self.parts.remove_old(self.mcap.len());
        if let Some(metadata) = &self.metadata {
            self.mcap.metadata(METADATA, metadata)?;
        }
        for (message, stamp) in self.identity.values() {
            let publish_time = nanos(since_1970(*stamp));
            let channel = Topic::Replies.channel();
            // Gets the number of a later reply, because it is not a reply of its own.
            let [sequence, _] = self.numbers;
            let header = MessageHeader { channel, sequence, log_time, publish_time };
            self.mcap.message(header, message)?;
        }
        Ok(())
    }
}

/// Starts a file with the channels of scans and replies. The channel of events follows with the first
/// event, because some checkers of recordings refuse a topic without messages.
fn start(out: Counted, compression: Compression) -> io::Result<Mcap> {
    let mut mcap = McapWriter::start(out, &mcap::header("ros2", LIBRARY), compression)?;
    for topic in [Topic::Scans, Topic::Replies] {
        declare(&mut mcap, topic);
    }
    Ok(mcap)
}

/// Declares the channel of a topic, unless the file has it.
fn declare(mcap: &mut Mcap, topic: Topic) {
    let message = topic.message_type();
    let schema = mcap::schema(message.name(), message.definition());
    mcap.declare(kind::SCHEMA, topic.schema(), &schema);
    let channel = mcap::channel(topic.schema(), topic.name());
    mcap.declare(kind::CHANNEL, topic.channel(), &channel);
}
