//! [`Counters`]: what the driver counts, and when it was last successful.

use std::ops::{Deref, DerefMut};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, Weak};

use tokio::time::Instant;

use super::lock;
use crate::Error;
use crate::ring::Ring;
use crate::stats::{ScheduleStats, Stats};

#[derive(Debug, Default)]
pub(crate) struct Counters {
    counted: Mutex<Counted>,
    schedules: Mutex<Vec<(ScheduleStats, Weak<Ring>)>>,
    polls: AtomicU64,
}

/// [`Stats`] and what [`Freshness`](super::Freshness) needs, which change together.
#[derive(Debug, Default)]
pub(crate) struct Counted {
    stats: Stats,
    pub(super) last_scan: Option<Instant>,
    /// Latest error since the last scan.
    pub(super) error: Option<Error>,
    /// True while the laser is switched off by request.
    pub(crate) is_laser_off: bool,
}

impl Counters {
    pub(crate) fn stats(&self) -> MutexGuard<'_, Counted> {
        lock(&self.counted)
    }

    /// Counts a poll, without a lock.
    pub(crate) fn count_poll(&self) {
        self.polls.fetch_add(1, Ordering::Relaxed);
    }

    /// Replaces the schedules, in place and without allocating.
    pub(crate) fn set_schedules(
        &self,
        schedules: impl Iterator<Item = (ScheduleStats, Weak<Ring>)>,
    ) {
        let mut noted = lock(&self.schedules);
        noted.clear();
        noted.extend(schedules);
    }

    /// Copies the counters, with the schedules that have a stream.
    pub(crate) fn snapshot(&self) -> Stats {
        let mut stats = self.stats().stats.clone();
        stats.polls = self.polls.load(Ordering::Relaxed);
        // The streams may all be gone before the driver notices.
        let is_read = |ring: &Weak<Ring>| ring.upgrade().is_some_and(|ring| ring.readers() > 0);
        let schedules = lock(&self.schedules);
        let read = schedules.iter().filter(|(_, ring)| is_read(ring));
        stats.schedules.extend(read.map(|(schedule, _)| *schedule));
        stats
    }

    /// Records why there is no scan.
    pub(crate) fn fail(&self, error: Error) {
        self.stats().error = Some(error);
    }
}

impl Counted {
    /// Counts a good scan.
    pub(crate) fn scanned(&mut self, requested_at: Instant, received_at: Instant) {
        self.stats.scans += 1;
        self.stats.reply_latency.add(received_at - requested_at);
        self.last_scan = Some(received_at);
        self.error = None;
    }
}

impl Deref for Counted {
    type Target = Stats;

    fn deref(&self) -> &Stats {
        &self.stats
    }
}

impl DerefMut for Counted {
    fn deref_mut(&mut self) -> &mut Stats {
        &mut self.stats
    }
}
