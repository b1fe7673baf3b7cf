//! [`Writer`]: turns scans, replies and events into messages of a file, and
//! starts the next file where the recording is split. Knows no threads.

use std::collections::BTreeMap;
use std::io;
use std::time::{Duration, Instant, SystemTime};

use super::METADATA;
use super::mcap::{self, MAX_INDEX_ENTRIES, McapWriter, MessageHeader, nanos};
use super::parts::{Output, Parts};
use super::topics::Topic;
use crate::Scan;
use crate::ros::{self, since_1970};

/// The library as the file's header names it.
const LIBRARY: &str = concat!("tokio-scip ", env!("CARGO_PKG_VERSION"));
/// A message is in the file after this time at the latest: on the clock of the
/// recording, which may be a paused one, and on the real one.
const CHUNK_SPAN: Duration = Duration::from_secs(1);
/// A file is split right behind a scan, so that its reply is in the same file. A
/// consumer that is always behind never lets that be; after this time the file is
/// split anywhere.
const SEAM_PATIENCE: Duration = Duration::from_secs(1);

/// The time of an event, on both clocks.
#[derive(Debug, Clone, Copy)]
pub(super) struct Times {
    pub(super) steady: Instant,
    pub(super) wall: SystemTime,
}

/// Turns instants into times of the log: the wall clock at the start of the
/// recording, and from there on a steady clock.
#[derive(Debug)]
pub(super) struct LogClock {
    began: Times,
}

impl LogClock {
    pub(super) fn starting_now() -> Self {
        // tokio's clock, which a simulation may have paused.
        let steady = tokio::time::Instant::now().into_std();
        Self { began: Times { steady, wall: SystemTime::now() } }
    }

    /// Returns nanoseconds since 1970.
    fn log_time(&self, at: Instant) -> u64 {
        let since = at.saturating_duration_since(self.began.steady);
        let before = self.began.steady.saturating_duration_since(at);
        let began = since_1970(self.began.wall);
        nanos((began + since).saturating_sub(before))
    }
}

/// Writes a recording, in one file or several.
pub(super) struct Writer {
    mcap: McapWriter<Output>,
    parts: Parts,
    clock: LogClock,
    frame_id: String,
    /// The numbers of replies and events.
    numbers: [u32; 2],
    message: Vec<u8>,
    /// The time of the chunk's first message: its log time, and the real time.
    chunk_began: Option<(u64, Instant)>,
    part: Part,
    carried: Carried,
}

/// The state of the file that is being written.
#[derive(Debug, Default)]
struct Part {
    /// The log time of its first message.
    began: Option<u64>,
    /// The log time of the first message that it should not have.
    full: Option<u64>,
    /// The stamp of its latest reply.
    reply: Option<SystemTime>,
    /// True behind a scan whose reply was the latest.
    at_seam: bool,
}

/// The content that each file repeats, so that it can be replayed alone.
#[derive(Debug, Default)]
struct Carried {
    metadata: Option<BTreeMap<String, String>>,
    /// The latest reply to `V`, and its stamp.
    version: Option<(Box<[u8]>, SystemTime)>,
}

impl Writer {
    pub(super) fn new(
        out: Output,
        parts: Parts,
        clock: LogClock,
        frame_id: String,
    ) -> io::Result<Self> {
        let mut writer = Self {
            mcap: start(out)?,
            parts,
            clock,
            frame_id,
            numbers: [0; 2],
            message: Vec::with_capacity(4096),
            chunk_began: None,
            part: Part::default(),
            carried: Carried::default(),
        };
        writer.flush()?;
        Ok(writer)
    }

    pub(super) fn scan(&mut self, scan: &Scan) -> io::Result<()> {
        let times = Times { steady: scan.received_at().into_std(), wall: scan.stamp() };
        ros::write_scan(&mut self.message, scan, scan.first_ray_stamp(), &self.frame_id);
        // The field has 32 bits. A gap is still a gap.
        self.write(Topic::Scans, scan.sequence() as u32, times)?;
        self.part.at_seam = self.part.reply.is_none_or(|reply| reply <= scan.stamp());
        Ok(())
    }

    /// `bytes` is a frame without its terminator.
    pub(super) fn reply(&mut self, command: &str, bytes: &[u8], times: Times) -> io::Result<()> {
        ros::write_labelled_bytes(&mut self.message, command, &[bytes, b"\n\n"]);
        let [number, _] = &mut self.numbers;
        let sequence = std::mem::replace(number, number.wrapping_add(1));
        self.write(Topic::Replies, sequence, times)?;
        self.part.reply = Some(times.wall);
        self.part.at_seam = false;
        if bytes.starts_with(b"V\n0\n") {
            self.carried.version = Some((bytes.into(), times.wall));
        }
        Ok(())
    }

    pub(super) fn event(&mut self, json: &str, times: Times) -> io::Result<()> {
        ros::write_text(&mut self.message, json);
        let [_, number] = &mut self.numbers;
        let sequence = std::mem::replace(number, number.wrapping_add(1));
        self.write(Topic::Events, sequence, times)
    }

    pub(super) fn metadata(&mut self, metadata: BTreeMap<String, String>) -> io::Result<()> {
        self.mcap.metadata(METADATA, &metadata)?;
        self.carried.metadata = Some(metadata);
        Ok(())
    }

    /// Returns the time until the chunk must be ended, or `None` if it has no message.
    pub(super) fn until_flush(&self) -> Option<Duration> {
        let (_, began) = self.chunk_began?;
        Some(CHUNK_SPAN.saturating_sub(began.elapsed()))
    }

    /// Ends the chunk: all messages up to now are in the file and can be read.
    pub(super) fn flush(&mut self) -> io::Result<()> {
        self.chunk_began = None;
        self.mcap.flush()
    }

    /// Writes the index and the end of the file.
    pub(super) fn finish(self) -> io::Result<()> {
        self.mcap.finish().map(drop)
    }

    /// Writes the encoded message.
    fn write(&mut self, topic: Topic, sequence: u32, times: Times) -> io::Result<()> {
        let log_time = self.clock.log_time(times.steady);
        if self.is_split_due(log_time) {
            self.start_next_part(log_time)?;
        }
        let span = self.chunk_began.map(|(began, _)| log_time.saturating_sub(began));
        if span.is_some_and(|span| span >= nanos(CHUNK_SPAN)) {
            self.flush()?;
        }
        self.chunk_began.get_or_insert_with(|| (log_time, Instant::now()));
        self.part.began.get_or_insert(log_time);
        let publish_time = nanos(since_1970(times.wall));
        let channel = topic.channel();
        let header = MessageHeader { channel, sequence, log_time, publish_time };
        self.mcap.message(header, &self.message)
    }

    /// Decides if the message of this log time starts the next file.
    fn is_split_due(&mut self, log_time: u64) -> bool {
        let Part { began, full, at_seam, .. } = &mut self.part;
        let Some(began) = *began else { return false };
        let length = Duration::from_nanos(log_time.saturating_sub(began));
        let is_full = self.parts.is_full(length, self.mcap.len(), self.mcap.index_entries());
        if !is_full {
            return false;
        }
        let full = *full.get_or_insert(log_time);
        *at_seam || log_time.saturating_sub(full) >= nanos(SEAM_PATIENCE)
    }

    fn start_next_part(&mut self, log_time: u64) -> io::Result<()> {
        let next = start(self.parts.next()?)?;
        std::mem::replace(&mut self.mcap, next).finish()?;
        self.part = Part::default();
        self.chunk_began = None;
        if let Some(metadata) = &self.carried.metadata {
            self.mcap.metadata(METADATA, metadata)?;
        }
        if let Some((bytes, stamp)) = &self.carried.version {
            // Encoded on its own: the message that is due is encoded already.
            let mut message = Vec::new();
            ros::write_labelled_bytes(&mut message, "V", &[bytes, b"\n\n"]);
            let publish_time = nanos(since_1970(*stamp));
            let channel = Topic::Replies.channel();
            // Its number is that of the next reply: it is no reply of its own.
            let [sequence, _] = self.numbers;
            let header = MessageHeader { channel, sequence, log_time, publish_time };
            self.mcap.message(header, &message)?;
        }
        Ok(())
    }
}

/// Starts a file with the three channels.
fn start(out: Output) -> io::Result<McapWriter<Output>> {
    let mut mcap = McapWriter::start(out, &mcap::header("ros2", LIBRARY), MAX_INDEX_ENTRIES)?;
    for topic in Topic::ALL {
        let message = topic.message_type();
        mcap.add_channel(topic.channel(), topic.name(), message.name(), message.definition());
    }
    Ok(mcap)
}

#[cfg(test)]
mod tests {
    use super::super::parts::{Limits, MAX_PART_ENTRIES};
    use super::*;

    #[test]
    fn the_log_runs_steadily_from_the_wall_clock_and_knows_what_was_before() {
        let wall = SystemTime::UNIX_EPOCH + Duration::from_secs(1_000);
        let steady = Instant::now();
        let clock = LogClock { began: Times { steady, wall } };
        let second = Duration::from_secs(1);
        assert_eq!(clock.log_time(steady + second), 1_001_000_000_000);
        // A scan that was received before the recorder was made.
        assert_eq!(steady.checked_sub(second).map(|at| clock.log_time(at)), Some(999_000_000_000));
    }

    /// A file waits for a scan behind which it can end, and gets further chunks meanwhile.
    #[test]
    fn a_file_that_is_split_because_of_its_chunks_still_has_an_index() {
        let folder = std::env::temp_dir().join(format!("scip-chunks-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("run.mcap");
        let files = |file| -> Output { Box::new(file) };
        let parts = Parts::new(Limits::default(), Some(path.clone()), files);
        let out = files(std::fs::File::create(&path).unwrap());
        let clock = LogClock::starting_now();
        let mut times = clock.began;
        let mut writer = Writer::new(out, parts, clock, "laser".to_owned()).unwrap();
        while writer.mcap.index_entries() < MAX_PART_ENTRIES - 4 {
            writer.metadata(BTreeMap::new()).unwrap();
        }
        // Each is in a chunk of its own.
        for _ in 0..8 {
            times.steady += CHUNK_SPAN;
            writer.event("", times).unwrap();
        }
        writer.finish().unwrap();
        let summary = |name| {
            let file = std::fs::read(folder.join(name)).unwrap();
            ::mcap::Summary::read(&file).unwrap().expect("no index").stats.unwrap()
        };
        let (first, second) = (summary("run.mcap"), summary("run_0002.mcap"));
        assert_eq!(first.message_count + second.message_count, 8);
        assert!(second.message_count > 0);
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
