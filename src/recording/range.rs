//! [`TimeRange`]: the part of a recording that is read, as times since its first
//! scan. Replies to `V` are of every part: a replay begins with one.

use std::ops::{Bound, RangeBounds};
use std::time::{Duration, SystemTime};

use super::record::{Entry, Record};
use crate::protocol::Command;

/// The limits of a part, and the time that they count from.
#[derive(Debug, Clone, Copy)]
pub(super) struct TimeRange {
    limits: (Bound<Duration>, Bound<Duration>),
    /// The log time of the first scan, once it was read.
    first: Option<SystemTime>,
}

/// The place of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RecordPlace {
    Outside,
    Inside,
    /// Behind the end, as are all that follow.
    Behind,
}

impl TimeRange {
    pub(super) fn new(range: &impl RangeBounds<Duration>) -> Self {
        let limits = (range.start_bound().cloned(), range.end_bound().cloned());
        Self { limits, first: None }
    }

    /// Returns the place of the next record of the file.
    pub(super) fn place(&mut self, record: &Record) -> RecordPlace {
        let command = match &record.entry {
            Entry::Reply(reply) => reply.command,
            Entry::Scan(_) | Entry::Event(_) => None,
        };
        let is_scan = matches!(record.entry, Entry::Scan(_));
        if is_scan || matches!(command, Some(Command::Distances(_))) {
            self.first.get_or_insert(record.at);
        }
        let first = self.first.unwrap_or(record.at);
        let since = record.at.duration_since(first).unwrap_or_default();
        let is_behind = match self.limits.1 {
            Bound::Included(end) => since > end,
            Bound::Excluded(end) => since >= end,
            Bound::Unbounded => false,
        };
        if is_behind {
            RecordPlace::Behind
        } else if self.limits.contains(&since) || command == Some(Command::Version) {
            RecordPlace::Inside
        } else {
            RecordPlace::Outside
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Event;

    #[test]
    fn the_first_scan_is_at_zero_and_both_limits_are_kept() {
        let poll = Command::Distances(crate::Window::DETECTION);
        let reply = |seconds, command| Record {
            at: SystemTime::UNIX_EPOCH + Duration::from_secs(seconds),
            sequence: 0,
            entry: Entry::Reply(crate::recording::Reply {
                command,
                bytes: Vec::new(),
                stamp: SystemTime::UNIX_EPOCH,
            }),
        };
        let event = |seconds| Record {
            entry: Entry::Event(Event::Unknown { text: String::new() }),
            ..reply(seconds, None)
        };
        let seconds = Duration::from_secs;
        let mut range = TimeRange::new(&(seconds(2)..seconds(4)));
        assert_eq!(range.place(&reply(90, Some(Command::Version))), RecordPlace::Inside);
        assert_eq!(range.place(&event(95)), RecordPlace::Outside);
        for (at, expected) in [
            (100, RecordPlace::Outside),
            (101, RecordPlace::Outside),
            (102, RecordPlace::Inside),
            (103, RecordPlace::Inside),
            (104, RecordPlace::Behind),
        ] {
            assert_eq!(range.place(&reply(at, Some(poll))), expected, "{at}");
        }
        let mut all = TimeRange::new(&(..=seconds(1)));
        assert_eq!(all.place(&reply(5, Some(poll))), RecordPlace::Inside);
        assert_eq!(all.place(&event(6)), RecordPlace::Inside);
        assert_eq!(all.place(&event(7)), RecordPlace::Behind);
    }
}
