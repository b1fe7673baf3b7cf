//! [`TimeRange`]: the part of a recording to read, as times since its first scan. Every
//! part includes the first reply to `V`, because a replay begins with it.

use std::ops::{Bound, RangeBounds};
use std::time::{Duration, SystemTime};

use super::record::{Entry, Record};
use tokio_scip::protocol::Command;

/// Limits of a part, and the start of their count.
#[derive(Debug, Clone, Copy)]
pub(super) struct TimeRange {
    limits: (Bound<Duration>, Bound<Duration>),
    /// Log time of the first scan, once it was read.
    first: Option<SystemTime>,
    /// Set once a reply to `V` was read.
    has_version: bool,
    /// True until the beginning of the part was taken.
    is_begin_wanted: bool,
}

/// Where a record lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RecordPlace {
    Outside,
    Inside,
    /// After the end, like all that follow.
    Behind,
}

impl TimeRange {
    pub(super) fn new(range: &impl RangeBounds<Duration>) -> Self {
        let limits = (range.start_bound().cloned(), range.end_bound().cloned());
        Self { limits, first: None, has_version: false, is_begin_wanted: true }
    }

    /// Returns the start of the part, as a log time, the first time that it is known, and then
    /// `None`.
    pub(super) fn take_begin(&mut self) -> Option<SystemTime> {
        let first = self.first.filter(|_| self.has_version && self.is_begin_wanted)?;
        self.is_begin_wanted = false;
        match self.limits.0 {
            Bound::Included(from) | Bound::Excluded(from) => first.checked_add(from),
            Bound::Unbounded => None,
        }
    }

    /// Time from the first scan to `at`, or 0 before that.
    pub(super) fn since_first_scan(&self, at: SystemTime) -> Duration {
        at.duration_since(self.first.unwrap_or(at)).unwrap_or_default()
    }

    /// Decides where the next record of the file lies.
    pub(super) fn place(&mut self, record: &Record) -> RecordPlace {
        let (mut is_scan, mut is_first_version) = (false, false);
        match &record.entry {
            Entry::Scan(_) => is_scan = true,
            Entry::Event(_) => {}
            Entry::Reply(reply) => match reply.command {
                Some(Command::Distances(_)) => is_scan = true,
                Some(Command::Version) if !self.has_version => {
                    is_first_version = true;
                    self.has_version = reply.parse().is_some();
                }
                _ => {}
            },
        }
        if is_scan {
            self.first.get_or_insert(record.at);
        }
        match self.place_of(record.at) {
            RecordPlace::Outside if is_first_version => RecordPlace::Inside,
            place => place,
        }
    }

    /// Decides where a time in the file lies.
    pub(super) fn place_of(&self, at: SystemTime) -> RecordPlace {
        let since = self.since_first_scan(at);
        let is_behind = match self.limits.1 {
            Bound::Included(end) => since > end,
            Bound::Excluded(end) => since >= end,
            Bound::Unbounded => false,
        };
        match () {
            () if is_behind => RecordPlace::Behind,
            () if self.limits.contains(&since) => RecordPlace::Inside,
            () => RecordPlace::Outside,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::event::Event;

    fn seconds(seconds: u64) -> Duration {
        Duration::from_secs(seconds)
    }

    fn at(number: u64) -> SystemTime {
        SystemTime::UNIX_EPOCH + seconds(number)
    }

    /// Makes a reply to a poll if `bytes` are empty, otherwise to `V`.
    fn reply(number: u64, bytes: &[u8]) -> Record {
        let poll = Command::Distances(tokio_scip::Window::DETECTION);
        let command = Some(if bytes.is_empty() { poll } else { Command::Version });
        let (bytes, stamp) = (bytes.to_vec(), SystemTime::UNIX_EPOCH);
        let entry = Entry::Reply(crate::RecordedReply { command, bytes, stamp });
        Record { at: at(number), sequence: 0, entry }
    }

    fn event(number: u64) -> Record {
        let entry = Entry::Event(Event::Unknown { text: String::new() });
        Record { entry, ..reply(number, POLL) }
    }

    const VERSION: &[u8] = b"V\n0\nSERI:1\n\n";
    const REFUSED: &[u8] = b"V\n1\n\n";
    const POLL: &[u8] = b"";

    #[test]
    fn the_first_scan_is_at_zero_and_both_limits_are_kept() {
        let mut range = TimeRange::new(&(seconds(2)..seconds(4)));
        assert_eq!(range.place(&reply(90, VERSION)), RecordPlace::Inside);
        assert_eq!(range.place(&event(95)), RecordPlace::Outside);
        for (number, expected) in [
            (100, RecordPlace::Outside),
            (101, RecordPlace::Outside),
            (102, RecordPlace::Inside),
            (103, RecordPlace::Inside),
            (104, RecordPlace::Behind),
        ] {
            assert_eq!(range.place(&reply(number, POLL)), expected, "{number}");
        }
        let mut all = TimeRange::new(&(..=seconds(1)));
        assert_eq!(all.place(&reply(5, POLL)), RecordPlace::Inside);
        assert_eq!(all.place(&event(6)), RecordPlace::Inside);
        assert_eq!(all.place(&event(7)), RecordPlace::Behind);
    }

    #[test]
    fn only_the_replies_to_v_up_to_the_first_successful_one_are_of_every_part() {
        let mut range = TimeRange::new(&(seconds(2)..));
        for (bytes, expected) in [
            (REFUSED, RecordPlace::Inside),
            (VERSION, RecordPlace::Inside),
            (VERSION, RecordPlace::Outside),
            (REFUSED, RecordPlace::Outside),
            (VERSION, RecordPlace::Outside),
        ] {
            assert_eq!(range.place(&reply(90, bytes)), expected);
        }
    }

    #[test]
    fn the_beginning_is_known_once_behind_the_first_scan_and_the_first_version() {
        for range in [
            (Bound::Included(seconds(2)), Bound::Unbounded),
            (Bound::Excluded(seconds(2)), Bound::Unbounded),
        ] {
            for (first, second) in [(POLL, VERSION), (VERSION, POLL)] {
                let mut range = TimeRange::new(&range);
                range.place(&reply(90, REFUSED));
                assert_eq!(range.take_begin(), None);
                range.place(&reply(90, first));
                assert_eq!(range.take_begin(), None);
                range.place(&reply(90, second));
                assert_eq!(range.take_begin(), Some(at(92)));
                assert_eq!(range.take_begin(), None);
            }
        }
        let mut all = TimeRange::new(&..);
        all.place(&reply(90, VERSION));
        all.place(&reply(90, POLL));
        assert_eq!(all.take_begin(), None);
    }
}
