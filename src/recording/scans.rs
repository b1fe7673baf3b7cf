//! [`Recording::scans`]: the recorded scans as [`Scan`]s, so that one function
//! serves live and recorded data.

use std::fmt;
use std::time::{Duration, SystemTime};

use tokio::time::Instant;

use super::polls::{PollReply, Polls};
use super::{Recording, RecordingError};
use crate::Scan;

impl Recording {
    /// Returns the scans of the recorded stream, as the driver delivered them.
    ///
    /// They are decoded from the sensor's replies, so scans that the recording's
    /// own consumer missed are there, too, and a replay has the same ones. Refused
    /// and malformed replies are left out; the events have them.
    ///
    /// - `values`, `window` and `stamp` are those of the time of recording.
    /// - `sequence` numbers the scans from 0.
    /// - `received_at` is the time of this call for the first scan; the others
    ///   follow with their recorded distances. `requested_at` is the same: the
    ///   time of the request is not in a recording.
    /// - `reconnects` is 0: a gap shows in the stamps.
    ///
    /// A damaged part of the file is an item, [`RecordingError::Damaged`], and more
    /// scans follow. If the file has no replies at all, the only item is
    /// [`RecordingError::NoReplies`]: it was recorded without
    /// [`Recorder::observer`](super::Recorder::observer).
    ///
    /// ```no_run
    /// use tokio_scip::Scan;
    /// use tokio_scip::recording::Recording;
    ///
    /// /// The same function as for `Sensor::scans`.
    /// fn nearest(scan: &Scan) -> Option<f32> {
    ///     scan.points().map(|point| point.range).reduce(f32::min)
    /// }
    ///
    /// for scan in Recording::open("run.mcap")?.scans() {
    ///     println!("{:?}", nearest(&scan?));
    /// }
    /// # Ok::<(), tokio_scip::recording::RecordingError>(())
    /// ```
    pub fn scans(self) -> RecordedScans {
        RecordedScans {
            polls: Polls::new(self),
            sequence: 0,
            position: Duration::ZERO,
            previous: None,
            started: None,
            has_replies: false,
            is_over: false,
        }
    }
}

/// The scans of a recording; made by [`Recording::scans`].
pub struct RecordedScans {
    polls: Polls,
    /// The number of the next scan.
    sequence: u64,
    position: Duration,
    /// The values of the scan before.
    previous: Option<Vec<u16>>,
    /// The log time of the first scan, and the instant it gets.
    started: Option<(SystemTime, Instant)>,
    has_replies: bool,
    is_over: bool,
}

impl RecordedScans {
    /// Returns true if all of the file was read and its end is missing; see
    /// [`Recording::is_truncated`].
    pub fn is_truncated(&self) -> bool {
        self.polls.is_truncated()
    }

    /// Returns the time of the latest scan since the file's first one, as
    /// [`Recording::range`] takes it.
    pub fn position(&self) -> Duration {
        self.position
    }

    /// Numbers the next scan `sequence`, and those behind it on from there: for a
    /// [part](Recording::range) whose place in the file is known.
    ///
    /// ```no_run
    /// use tokio_scip::recording::Recording;
    ///
    /// // The place of the thousandth scan, to which one may want to return.
    /// let mut scans = Recording::open("run.mcap")?.scans();
    /// scans.by_ref().take(1000).for_each(drop);
    /// let place = scans.position();
    ///
    /// let again = Recording::open("run.mcap")?.range(place..).scans().numbered_from(999);
    /// # Ok::<(), tokio_scip::recording::RecordingError>(())
    /// ```
    #[must_use]
    pub fn numbered_from(mut self, sequence: u64) -> Self {
        self.sequence = sequence;
        self
    }

    /// Returns the scan of a reply to the stream's poll, if it has one.
    fn scan(&mut self, poll: &PollReply) -> Option<Scan> {
        let window = self.polls.window()?;
        let mut values = poll.reply.values()?;
        // The driver may have asked for some points more, in front or behind.
        let surplus = window.start().number().saturating_sub(poll.asked.start().number());
        values.drain(..usize::from(surplus / u16::from(window.cluster_count())).min(values.len()));
        values.truncate(window.points());
        let (first, began) = *self.started.get_or_insert_with(|| (poll.at, Instant::now()));
        let since = poll.at.duration_since(first).unwrap_or_default();
        let mut scan = Scan::builder(window, values.as_slice())
            .sequence(self.sequence)
            .received_at(began.checked_add(since).unwrap_or(began))
            .stamp(poll.reply.stamp)
            .repeat(self.previous.as_ref() == Some(&values));
        if let Some(revolution) = self.polls.revolution() {
            scan = scan.scan_time(revolution);
        }
        let scan = scan.build().ok()?;
        self.sequence = self.sequence.wrapping_add(1);
        self.position = self.polls.since_first_scan(poll);
        self.previous = Some(values);
        Some(scan)
    }
}

impl Iterator for RecordedScans {
    type Item = Result<Scan, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        while !self.is_over {
            match self.polls.next() {
                None => {
                    self.is_over = true;
                    if !self.has_replies {
                        return Some(Err(RecordingError::NoReplies));
                    }
                }
                Some(Err(error)) => return Some(Err(error)),
                Some(Ok(poll)) => {
                    self.has_replies = true;
                    let is_of_stream = self.polls.is_of_stream(poll.asked);
                    if let Some(scan) = is_of_stream.then(|| self.scan(&poll)).flatten() {
                        return Some(Ok(scan));
                    }
                }
            }
        }
        None
    }
}

impl fmt::Debug for RecordedScans {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RecordedScans").field("sequence", &self.sequence).finish_non_exhaustive()
    }
}
