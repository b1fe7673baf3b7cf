//! [`Counters`]: what the driver counts, and when it was last successful.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, Weak};

use tokio::time::Instant;

use super::lock;
use crate::Error;
use crate::protocol::ReplyError;
use crate::ring::Ring;
use crate::stats::{MotorStats, ScheduleStats, Stats};

#[derive(Debug, Default)]
pub(crate) struct Counters {
    counted: Mutex<Counted>,
    schedules: Mutex<Vec<(ScheduleStats, Weak<Ring>)>>,
    polls: AtomicU64,
}

/// [`Stats`] and what [`Freshness`](super::Freshness) needs, which change together.
#[derive(Debug, Default)]
pub(crate) struct Counted {
    pub(crate) stats: Stats,
    pub(super) last_scan: Option<Instant>,
    /// Latest error since the last scan.
    pub(super) error: Option<Error>,
    /// True while the laser is switched off by request.
    pub(crate) is_laser_off: bool,
}

impl Counters {
    pub(crate) fn lock(&self) -> MutexGuard<'_, Counted> {
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
        let mut stats = self.lock().stats.clone();
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
        self.lock().error = Some(error);
    }

    /// Counts a good scan. `motor` is what is known of the motor then.
    pub(crate) fn count_scan(
        &self,
        requested: Instant,
        received: Instant,
        motor: Option<MotorStats>,
    ) {
        let mut counted = self.lock();
        counted.stats.scans += 1;
        counted.stats.reply_latency.add(received - requested);
        counted.stats.motor = motor;
        (counted.last_scan, counted.error) = (Some(received), None);
    }

    /// Counts a malformed reply, and bytes that belong to no reply.
    pub(crate) fn count_malformed(&self, error: &ReplyError, skipped: u64) {
        let mut counted = self.lock();
        counted.stats.malformed.count(error);
        counted.stats.bytes_skipped += skipped;
    }
}
