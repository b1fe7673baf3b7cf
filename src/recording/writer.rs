//! The file as it is written: header, channels, messages, and chunks that are
//! ended often. Knows no threads.

use std::collections::BTreeMap;
use std::io::Write;
use std::time::{Instant, SystemTime};

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{McapResult, WriteOptions};

use super::METADATA;
use super::topics::Topic;
use crate::Scan;
use crate::ros::{self, since_1970};

/// The library as the file's header names it.
const LIBRARY: &str = concat!("tokio-scip ", env!("CARGO_PKG_VERSION"));

/// When something happened, on both clocks.
#[derive(Debug, Clone, Copy)]
pub(super) struct Times {
    pub(super) steady: Instant,
    pub(super) wall: SystemTime,
}

/// Turns instants into times of the log: the wall clock when the recording
/// began, and on from there steadily, whatever happens to the wall clock.
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

    /// In nanoseconds since 1970.
    fn log_time(&self, at: Instant) -> u64 {
        let since = at.saturating_duration_since(self.began.steady);
        let before = self.began.steady.saturating_duration_since(at);
        let began = since_1970(self.began.wall);
        u64::try_from((began + since).saturating_sub(before).as_nanos()).unwrap_or(u64::MAX)
    }
}

pub(super) struct Writer<W: Write> {
    mcap: mcap::Writer<NoSeek<W>>,
    clock: LogClock,
    frame_id: String,
    scans: u16,
    replies: u16,
    events: u16,
    /// How many replies and events there are.
    numbers: [u32; 2],
    message: Vec<u8>,
}

impl<W: Write> Writer<W> {
    pub(super) fn new(out: W, clock: LogClock, frame_id: String) -> McapResult<Self> {
        // Without seeking a chunk is put together in memory and written in one
        // go: nothing in the file is ever changed, so no end of the program
        // leaves it half changed.
        let mut mcap = WriteOptions::new()
            .profile("ros2")
            .library(LIBRARY)
            .compression(None)
            .disable_seeking(true)
            .create(NoSeek::new(out))?;
        let mut channel = |topic: Topic| {
            let message = topic.message_type();
            let schema =
                mcap.add_schema(message.name(), "ros2msg", message.definition().as_bytes())?;
            mcap.add_channel(schema, topic.name(), "cdr", &BTreeMap::new())
        };
        let scans = channel(Topic::Scans)?;
        let (replies, events) = (channel(Topic::Replies)?, channel(Topic::Events)?);
        let mut writer = Self {
            mcap,
            clock,
            frame_id,
            scans,
            replies,
            events,
            numbers: [0; 2],
            message: Vec::with_capacity(4096),
        };
        writer.flush()?;
        Ok(writer)
    }

    pub(super) fn scan(&mut self, scan: &Scan) -> McapResult<()> {
        ros::write_scan(&mut self.message, scan, scan.first_ray_stamp(), &self.frame_id);
        let times = Times { steady: scan.received_at().into_std(), wall: scan.stamp() };
        // The field has 32 bits; a gap is a gap all the same.
        self.write(self.scans, scan.sequence() as u32, times)
    }

    /// `bytes` is a frame without its terminator.
    pub(super) fn reply(&mut self, command: &str, bytes: &[u8], times: Times) -> McapResult<()> {
        ros::write_labelled_bytes(&mut self.message, command, &[bytes, b"\n\n"]);
        let [number, _] = &mut self.numbers;
        let sequence = std::mem::replace(number, number.wrapping_add(1));
        self.write(self.replies, sequence, times)
    }

    pub(super) fn event(&mut self, json: &str, times: Times) -> McapResult<()> {
        ros::write_text(&mut self.message, json);
        let [_, number] = &mut self.numbers;
        let sequence = std::mem::replace(number, number.wrapping_add(1));
        self.write(self.events, sequence, times)
    }

    pub(super) fn metadata(&mut self, metadata: BTreeMap<String, String>) -> McapResult<()> {
        self.mcap.write_metadata(&Metadata { name: METADATA.to_owned(), metadata })
    }

    /// Ends the chunk: what was written so far is in the file and can be read.
    pub(super) fn flush(&mut self) -> McapResult<()> {
        self.mcap.flush()
    }

    /// Writes the index and the end of the file.
    pub(super) fn finish(mut self) -> McapResult<()> {
        self.mcap.finish().map(drop)
    }

    fn write(&mut self, channel_id: u16, sequence: u32, times: Times) -> McapResult<()> {
        let log_time = self.clock.log_time(times.steady);
        let publish_time = u64::try_from(since_1970(times.wall).as_nanos()).unwrap_or(u64::MAX);
        let header = MessageHeader { channel_id, sequence, log_time, publish_time };
        self.mcap.write_to_known_channel(&header, &self.message)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

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
}
