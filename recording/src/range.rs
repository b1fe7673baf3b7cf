//! [`TimeRange`]: the part of a recording to read, as times since its first scan. Every
//! part includes the first reply to `V`, because a replay begins with it.

use std::ops::{Bound, RangeBounds, RangeInclusive};
use std::time::{Duration, SystemTime};

use super::mcap::nanos;
use super::record::{Entry, Record};
use super::reply::ReplyKind;
use crate::ros::since_1970;

/// Limits of a part, and the start of their count.
#[derive(Debug, Clone, Copy)]
pub(super) struct TimeRange {
    limits: (Bound<Duration>, Bound<Duration>),
    /// Log time of the first scan, once it was read.
    first: Option<SystemTime>,
    /// Set once a reply to `V` was read.
    has_version: bool,
}

impl TimeRange {
    pub(super) fn new(range: &impl RangeBounds<Duration>) -> Self {
        let limits = (range.start_bound().cloned(), range.end_bound().cloned());
        Self { limits, first: None, has_version: false }
    }

    /// Returns the log times of a part, once they are known.
    pub(super) fn times(&self) -> Option<RangeInclusive<u64>> {
        let is_part = self.limits != (Bound::Unbounded, Bound::Unbounded);
        let first = self.first.filter(|_| self.has_version && is_part)?;
        let at = |limit: Bound<Duration>, unbounded| match limit {
            Bound::Included(since) | Bound::Excluded(since) => {
                nanos(since_1970(first).saturating_add(since))
            }
            Bound::Unbounded => unbounded,
        };
        let (begin, end) = (at(self.limits.0, 0), at(self.limits.1, u64::MAX));
        // Before the first scan, all is at its time.
        Some(if self.limits.contains(&Duration::ZERO) { 0 } else { begin }..=end)
    }

    /// Time from the first scan to `at`, or 0 before that.
    pub(super) fn since_first_scan(&self, at: SystemTime) -> Duration {
        at.duration_since(self.first.unwrap_or(at)).unwrap_or_default()
    }

    /// Takes the next record of the file. Returns true for one of the first replies to `V` (in SCIP 2
    /// to `VV` and `PP`), up to a successful one.
    pub(super) fn see(&mut self, record: &Record) -> bool {
        let is_scan = match &record.entry {
            Entry::Scan(_) => true,
            Entry::Event(_) => false,
            Entry::Reply(reply) => match reply.kind() {
                ReplyKind::Version if !self.has_version => {
                    self.has_version = reply.version_lines().is_some();
                    return true;
                }
                // Before the version.
                ReplyKind::Parameters if !self.has_version => return true,
                kind => kind == ReplyKind::Poll,
            },
        };
        if is_scan {
            self.first.get_or_insert(record.at);
        }
        false
    }

    pub(super) fn begins_after(&self, at: SystemTime) -> bool {
        !(self.limits.0, Bound::Unbounded).contains(&self.since_first_scan(at))
    }

    pub(super) fn contains(&self, at: SystemTime) -> bool {
        self.limits.contains(&self.since_first_scan(at))
    }
}
