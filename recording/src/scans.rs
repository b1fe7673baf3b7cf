//! [`Recording::scans`]: the recorded scans as [`Scan`]s, so that one function serves live and recorded data.

use std::collections::BTreeSet;
use std::fmt;
use std::time::{Duration, SystemTime};

use tokio::time::Instant;

use super::left_out::LeftOutReason;
use super::polls::{PollReply, Polls};
use super::reply::{Values, parse_version};
use super::stream::Model;
use super::{Recording, RecordingError};
use tokio_scip::protocol::scip2::Stamp;
use tokio_scip::{Scan, Version};

impl Recording {
    /// Reads the scans of the recorded stream, as the driver delivered them.
    ///
    /// They are decoded from the sensor's replies. So you also get scans that the recording's own consumer missed,
    /// and the same ones as in a replay. Refused and malformed replies are left out; find them in the events.
    ///
    /// Each has the geometry of its sensor: a URG-04LX in SCIP 1.1, otherwise what its reply to `PP`
    /// or the metadata tell, whichever was recorded last.
    ///
    /// Scans whose reply was not recorded are made of the `/scan` messages, also of ones that another program
    /// recorded, if their directions are steps of a sensor: the described one, or one with 1,024, 1,440 or
    /// 2,880 steps in a revolution and the limits of the message. Distances are the recorded ones, rounded to
    /// millimetres. Messages have no error codes: a range beyond the limits, such as `+Inf`, becomes the
    /// sensor's [value for that](tokio_scip::Geometry::far_value), and `NaN` and `-Inf` become an [unknown
    /// value](tokio_scip::Geometry::unknown_value). Ranges of 0 to 0.019 m are error codes, as `urg_node` and
    /// `hokuyo_node` write them. `urg_node` writes 0 as `NaN`, as filters write what they remove.
    ///
    /// If the file describes several streams, as after [`cut`](super::cut) has joined recordings,
    /// the latest metadata before a scan decides which stream it must belong to, once that stream has
    /// begun. Up to 256 scans before the first metadata must belong to the stream that those describe.
    /// Messages without a description and without replies are all scans, whatever their windows.
    ///
    /// What is left out is counted: see [`left_out`](Self::left_out).
    ///
    /// - `values`, `window` and `stamp` are the recorded ones.
    /// - `sequence` numbers the scans from 0.
    /// - `received_at` is the time of this call for the first scan; the others follow at
    ///   their recorded intervals. `requested_at` is the same, because recordings do not
    ///   contain the time of the request.
    /// - `quality` is always [`Arrival`](tokio_scip::scan::StampQuality::Arrival), and
    ///   `scan_time` the nominal one: replies are recorded with their arrivals. The time by
    ///   the motor is in the header stamp of the recorded `LaserScan` message.
    /// - `reconnects` is 0: a gap shows in the stamps.
    ///
    /// A damaged part of the file is an item, [`RecordingError::Damaged`], and more scans follow. If the
    /// recording has neither replies nor such messages, the only item is [`RecordingError::NoScans`].
    ///
    /// ```no_run
    /// for scan in urg_recording::Recording::open("run.mcap")?.scans() {
    ///     println!("{:?}", scan?.nearest());
    /// }
    /// # Ok::<(), urg_recording::RecordingError>(())
    /// ```
    pub fn scans(self) -> RecordedScans {
        RecordedScans {
            polls: Polls::new(self),
            sequence: 0,
            log_time: SystemTime::UNIX_EPOCH,
            previous: None,
            started: None,
            sensor: None,
            is_of_one_sensor: false,
            has_answer: false,
        }
    }
}

/// Scans of a recording; made by [`Recording::scans`].
pub struct RecordedScans {
    polls: Polls,
    sequence: u64,
    log_time: SystemTime,
    previous: Option<Values>,
    /// Log time of the first scan, and the instant it gets.
    started: Option<(SystemTime, Instant)>,
    /// First sensor, and whether to leave out all others.
    sensor: Option<Model>,
    is_of_one_sensor: bool,
    /// Set after the first poll, or once it was reported that there is none.
    has_answer: bool,
}

impl RecordedScans {
    /// The recording, as far as it was read.
    pub fn recording(&self) -> &Recording {
        &self.polls.recording
    }

    /// Number of polls without a scan among the records read so far, by the recorded events.
    pub fn failed_polls(&self) -> u64 {
        self.polls.failed_polls
    }

    /// Time from the file's first scan to the latest one, as [`Recording::range`] takes it.
    pub fn position(&self) -> Duration {
        self.polls.recording.range.since_first_scan(self.log_time)
    }

    /// Time from the file's first scan to the latest message, also of another topic.
    pub fn end(&self) -> Duration {
        self.polls.recording.range.since_first_scan(self.polls.recording.latest)
    }

    /// Returns true if the link to the sensor was lost and did not return, by the events read so far.
    pub fn is_disconnected(&self) -> bool {
        self.polls.stream.is_disconnected
    }

    /// Version of the recorded sensor: its first reply to `V` among the records read so far, or else what the
    /// [metadata](Recording::metadata) have of it. Fields that the recording does not have are empty.
    pub fn version(&self) -> Version {
        parse_version(&self.polls.version_lines()).unwrap_or_default()
    }

    /// Numbers the next scan `sequence`, and counts on from there. Use it for a
    /// [part](Recording::range) whose position in the file you know.
    #[must_use]
    pub fn numbered_from(mut self, sequence: u64) -> Self {
        self.sequence = sequence;
        self
    }

    /// Leaves out the scans of all other laser scanners than the first, as a replay does.
    #[must_use]
    pub fn of_one_sensor(mut self) -> Self {
        self.is_of_one_sensor = true;
        self
    }

    /// Clock of the sensor at the end of the latest scan's revolution, since it was last at 0: once in
    /// 2^24 ms, and when the sensor starts. `None` in SCIP 1.1, and without the sensor's reply.
    pub fn sensor_clock(&self) -> Option<Duration> {
        self.previous.as_ref()?.clock.map(Stamp::since_zero)
    }

    /// Log time of the latest scan.
    pub fn log_time(&self) -> SystemTime {
        self.log_time
    }

    /// Frames of the scan messages read so far, at most 16. Several ones mean several sensors, unless
    /// somebody renamed the frame.
    pub fn frame_ids(&self) -> &BTreeSet<String> {
        &self.polls.stream.frame_ids
    }

    /// Serial numbers in the replies to `V` and in the metadata read so far, at most 16.
    pub fn serial_numbers(&self) -> &BTreeSet<String> {
        &self.polls.serial_numbers
    }

    /// Decodes the scan of a reply to the stream's poll, if it has one.
    fn scan(&mut self, poll: &PollReply) -> Option<Scan> {
        let Some((window, values)) = poll.stream_values() else {
            if let Some(window) = poll.window {
                self.polls.recording.left_out.add(LeftOutReason::FailedPoll, window);
            }
            return None;
        };
        let sensor = self.sensor.get_or_insert_with(|| poll.asked.model.clone());
        if self.is_of_one_sensor && !poll.asked.model.is_like(sensor) {
            self.polls.recording.left_out.add(LeftOutReason::OtherLaser, window);
            return None;
        }
        let (first, began) = *self.started.get_or_insert_with(|| (poll.at, Instant::now()));
        let since = poll.at.duration_since(first).unwrap_or_default();
        let mut scan = Scan::builder(window, values.distances.as_slice())
            .intensities(values.intensities.as_slice())
            .geometry(poll.asked.model.geometry())
            .sequence(self.sequence)
            .received_at(began.checked_add(since).unwrap_or(began))
            .stamp(poll.stamp)
            .repeat(self.previous.as_ref() == Some(&values));
        // In SCIP 2 the geometry has it.
        let told = self.polls.revolution.filter(|_| poll.asked.model.0.is_none());
        if let Some(revolution) = poll.scan_time.or(told) {
            scan = scan.scan_time(revolution);
        }
        let scan = scan.build().ok()?;
        self.sequence = self.sequence.wrapping_add(1);
        self.log_time = poll.at;
        self.previous = Some(values);
        Some(scan)
    }
}

impl Iterator for RecordedScans {
    type Item = Result<Scan, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let poll = match self.polls.next().transpose() {
                Ok(poll) => poll,
                Err(error) => return Some(Err(error)),
            };
            let had_answer = std::mem::replace(&mut self.has_answer, true);
            let Some(poll) = poll else {
                return (!had_answer).then(|| Err(self.polls.recording.no_scans()));
            };
            if let Some(scan) = self.scan(&poll) {
                return Some(Ok(scan));
            }
        }
    }
}

impl fmt::Debug for RecordedScans {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RecordedScans").field("sequence", &self.sequence).finish_non_exhaustive()
    }
}
