//! [`Schedules`]: the polls of all streams, and when each is due. Knows nothing of ports
//! and replies.

#[cfg(test)]
mod tests;

use std::mem::{Discriminant, discriminant};
use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use super::rate_meter::RateMeter;
use crate::ring::{Cursor, Ring};
use crate::scan::Scan;
use crate::state::Counters;
use crate::stats::ScheduleStats;
use crate::{BaudRate, Error, ErrorKind, Geometry, Rate, Window};

/// Largest number of scans that a stream can leave out after each one.
const MOST_SKIPPED: u8 = 9;

/// All schedules of a driver.
#[derive(Debug, Default)]
pub(crate) struct Schedules {
    all: Vec<Schedule>,
    /// Number of scans overwritten before a consumer read them.
    missed: u64,
    /// True if the published statistics are out of date.
    changed: bool,
}

/// One window at one rate, for all streams that want it.
#[derive(Debug)]
struct Schedule {
    /// Its window is in the steps of the sensor that was last found.
    stats: ScheduleStats,
    /// True unless this sensor cannot measure the window.
    is_measured: bool,
    ring: Arc<Ring>,
    /// Next grid point. At [`Rate::UNLIMITED`], the end of the last poll.
    due: Instant,
    /// Number of scans that readers had missed by the latest one.
    missed: u64,
    /// True while it gets its scans from the stream, and is not polled.
    is_streamed: bool,
    /// Kind of the last error since the last scan.
    condition: Option<Discriminant<ErrorKind>>,
    speed: RateMeter,
}

/// Stream of scans that the sensor sends on its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct StreamWish {
    pub(crate) window: Window,
    /// Number of scans to leave out after each one.
    pub(crate) skipped: u8,
}

/// Poll that is due.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DuePoll {
    pub(crate) window: Window,
    pub(crate) rate: Rate,
    /// True unless this sensor cannot measure the window.
    pub(crate) is_measured: bool,
}

/// What the end of a poll changed.
#[derive(Debug, Default)]
pub(crate) struct Ended {
    /// True if the scan's values equal the previous ones.
    pub(crate) repeats: bool,
    /// Number of scans that readers have missed since the previous one.
    pub(crate) newly_missed: u64,
    /// True if the rate falls short, and the log does not tell so yet.
    pub(crate) falls_short: bool,
}

impl Schedules {
    /// Returns a reader of the scans of `window` at `rate`, starting with the next one.
    /// Equal subscriptions share a schedule. Reports `trouble` to a new schedule only: an
    /// existing one has already told its readers. `geometry` is the sensor's, if there is a link.
    pub(crate) fn subscribe(
        &mut self,
        window: Window,
        rate: Rate,
        depth: usize,
        trouble: Option<&Error>,
        geometry: Option<&Geometry>,
    ) -> Cursor {
        self.drop_unread();
        if let Some(schedule) = find(&mut self.all, window, rate) {
            return schedule.ring.subscribe(depth);
        }
        let mut schedule = Schedule::new(window, rate);
        if let Some(geometry) = geometry {
            schedule.resolve(geometry);
        }
        if let Some(error) = trouble {
            schedule.report(error);
        }
        let reader = schedule.ring.subscribe(depth);
        // Most sensors have one schedule.
        self.all.reserve_exact(1);
        self.all.push(schedule);
        self.changed = true;
        reader
    }

    /// Resolves all windows for a sensor that was just found.
    pub(crate) fn resolve(&mut self, geometry: &Geometry) {
        self.all.iter_mut().for_each(|schedule| schedule.resolve(geometry));
    }

    /// Resumes polling. Does not count the grid points missed meanwhile as skipped, and
    /// restarts rate measurement.
    pub(crate) fn resume(&mut self, now: Instant) {
        self.drop_unread();
        for schedule in &mut self.all {
            schedule.catch_up(now);
            schedule.speed.restart(now);
        }
    }

    /// Stream that serves all schedules which are not too slow for one, if there are any.
    pub(crate) fn stream(&self, revolution: Duration) -> Option<StreamWish> {
        let skipped = self.all.iter().filter_map(|schedule| schedule.skipped(revolution)).min()?;
        // The slow ones can take their scans from it, too.
        let measured = self.all.iter().filter(|schedule| schedule.is_measured);
        let window = measured.map(|schedule| schedule.stats.window);
        Some(StreamWish { window: window.reduce(|one, other| one.hull(&other))?, skipped })
    }

    /// Serves the schedules from the stream.
    pub(crate) fn begin_stream(&mut self, revolution: Duration) {
        for schedule in &mut self.all {
            schedule.is_streamed = schedule.skipped(revolution).is_some();
        }
    }

    /// Polls for all schedules again.
    pub(crate) fn end_stream(&mut self) {
        self.all.iter_mut().for_each(|schedule| schedule.is_streamed = false);
    }

    /// Takes a poll of each schedule that gets a scan of the stream, which came at `now` or would have
    /// come then without a delay. The scans come `period` apart. Grid points without a scan do not
    /// count as skipped: the sensor sends when its motor has turned.
    pub(crate) fn take_streamed(&mut self, now: Instant, period: Duration) -> Vec<DuePoll> {
        let streamed = self.all.iter_mut().filter(|schedule| schedule.is_streamed);
        let taken = streamed.filter_map(|schedule| {
            // A scan that is a little early is for the point that follows.
            let is_due = schedule.due <= now + period / 2;
            if is_due {
                schedule.advance(now);
            }
            // No motor turns exactly with the grid, so a stream at the rate of the scans gets each of them.
            let asked = schedule.stats.rate.period();
            let gets_each = asked.is_none_or(|asked| asked <= period + period / 100);
            (is_due || gets_each).then(|| schedule.poll())
        });
        taken.collect()
    }

    /// Returns true if a poll is due.
    pub(crate) fn is_due(&self) -> bool {
        self.next_due().is_some_and(|due| due <= Instant::now())
    }

    /// When the next poll is due.
    pub(crate) fn next_due(&self) -> Option<Instant> {
        self.all.iter().filter(|one| !one.is_streamed).map(|schedule| schedule.due).min()
    }

    /// Returns true if nothing is polled.
    pub(crate) fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// Takes the poll that has been due longest. Also returns the number of grid points
    /// skipped. Drops unread schedules only when they are due: a poll checks only its own
    /// schedule's readers, so its cost does not grow with the number of schedules.
    pub(crate) fn take_due(&mut self, now: Instant) -> Option<(DuePoll, u64)> {
        loop {
            let polled = self.all.iter_mut().filter(|schedule| !schedule.is_streamed);
            let schedule = polled.min_by_key(|schedule| schedule.due)?;
            if schedule.due > now {
                return None;
            }
            // Readers own the ring, too. Cheaper than to count them.
            if Arc::strong_count(&schedule.ring) > 1 {
                let skipped = schedule.advance(now);
                return Some((schedule.poll(), skipped));
            }
            self.drop_unread();
        }
    }

    /// Delivers the scan that `poll` received, on a line at `baud_rate` if there is one.
    pub(crate) fn deliver(
        &mut self,
        poll: DuePoll,
        scan: Scan,
        baud_rate: Option<BaudRate>,
    ) -> Ended {
        let Self { all, missed, changed } = self;
        let Some(schedule) = find(all, poll.window, poll.rate) else { return Ended::default() };
        schedule.condition = None;
        let received_at = scan.received_at();
        let latency = received_at.saturating_duration_since(scan.meta.requested_at);
        schedule.speed.count_scan(latency, scan.scan_time());
        let (repeats, now_missed) = schedule.ring.push(scan);
        let newly_missed = now_missed - std::mem::replace(&mut schedule.missed, now_missed);
        *missed += newly_missed;
        let falls_short = schedule.end_poll(received_at, received_at, baud_rate, changed);
        Ended { repeats, newly_missed, falls_short }
    }

    /// Reports the error of one poll. At [`Rate::UNLIMITED`] the next one is due at `again`.
    pub(crate) fn fail(&mut self, poll: DuePoll, error: &Error, again: Instant) -> Ended {
        let Self { all, changed, .. } = self;
        let Some(schedule) = find(all, poll.window, poll.rate) else { return Ended::default() };
        schedule.report(error);
        schedule.speed.count_failure();
        let falls_short = schedule.end_poll(Instant::now(), again, None, changed);
        Ended { falls_short, ..Ended::default() }
    }

    /// Reports a lost link to all streams.
    pub(crate) fn fail_all(&mut self, error: &Error) {
        for schedule in &mut self.all {
            schedule.report(error);
        }
    }

    /// Pauses polling: all rates are zero until [`resume`](Self::resume).
    pub(crate) fn pause(&mut self) {
        for schedule in &mut self.all {
            schedule.stats = unmeasured(schedule.stats.window, schedule.stats.rate);
            self.changed = true;
        }
    }

    /// Publishes the statistics if they have changed.
    pub(crate) fn publish(&mut self, counters: &Counters) {
        if std::mem::take(&mut self.changed) {
            let rings = self.all.iter().map(|one| (one.stats, Arc::downgrade(&one.ring)));
            counters.set_schedules(rings);
        }
    }

    /// Requested and achieved rate of a schedule.
    pub(crate) fn stats(&mut self, poll: DuePoll) -> Option<ScheduleStats> {
        find(&mut self.all, poll.window, poll.rate).map(|schedule| schedule.stats)
    }

    /// Number of scans overwritten before a consumer read them, as of each schedule's
    /// latest poll.
    pub(crate) fn missed(&self) -> u64 {
        self.missed
    }

    /// Ends all streams.
    pub(crate) fn end(&mut self, cause: Option<&Error>) {
        for schedule in self.all.drain(..) {
            schedule.ring.end(cause.cloned());
        }
    }

    /// Drops the schedules without readers.
    pub(crate) fn drop_unread(&mut self) {
        let Self { all, missed, changed, .. } = self;
        all.retain_mut(|schedule| {
            let read = schedule.ring.readers() > 0;
            if !read {
                *missed += schedule.newly_missed();
                *changed = true;
            }
            read
        });
    }
}

/// Statistics of a schedule before the first span.
fn unmeasured(window: Window, rate: Rate) -> ScheduleStats {
    ScheduleStats { window, rate, reached: None, failed: 0, shortfall: None, baud_rate: None }
}

#[inline(never)]
fn find(all: &mut [Schedule], window: Window, rate: Rate) -> Option<&mut Schedule> {
    all.iter_mut()
        .find(|schedule| schedule.stats.rate == rate && schedule.stats.window.is_same_wish(&window))
}

impl Schedule {
    fn new(window: Window, rate: Rate) -> Self {
        let now = Instant::now();
        Self {
            stats: unmeasured(window, rate),
            is_measured: true,
            ring: Ring::new(),
            due: now,
            missed: 0,
            is_streamed: false,
            condition: None,
            speed: RateMeter::new(now),
        }
    }

    /// Number of scans that a stream may leave out after each one, and still serve this schedule.
    /// `None` if it is too slow for a stream, or cannot be served at all.
    fn skipped(&self, revolution: Duration) -> Option<u8> {
        let period = self.stats.rate.period().unwrap_or_default();
        // To within a twentieth, so that no rounding halves the rate.
        let turns = (period + revolution / 20).as_nanos() / revolution.as_nanos().max(1);
        let skipped = u8::try_from(turns).ok()?.saturating_sub(1);
        (self.is_measured && skipped <= MOST_SKIPPED).then_some(skipped)
    }

    fn poll(&self) -> DuePoll {
        let ScheduleStats { window, rate, .. } = self.stats;
        DuePoll { window, rate, is_measured: self.is_measured }
    }

    /// Advances to the first grid point after `now`, so that a late poll delays at most
    /// one other. Returns the number of grid points skipped.
    fn advance(&mut self, now: Instant) -> u64 {
        let skipped = self.catch_up(now);
        self.due += self.stats.rate.period().unwrap_or_default();
        skipped
    }

    /// Advances to the last grid point that is due, if any. Returns the number of grid
    /// points skipped.
    fn catch_up(&mut self, now: Instant) -> u64 {
        let Some(period) = self.stats.rate.period() else {
            self.due = self.due.max(now);
            return 0;
        };
        let late = now.saturating_duration_since(self.due);
        if late < period {
            return 0;
        }
        let (late, period) = (late.as_nanos(), period.as_nanos());
        // Both casts are exact: u64 nanoseconds overflow after 584 years.
        let skipped = (late / period) as u64;
        self.due += Duration::from_nanos((period * u128::from(skipped)) as u64);
        skipped
    }

    fn resolve(&mut self, geometry: &Geometry) {
        let resolved = self.stats.window.resolve(geometry);
        self.is_measured = resolved.is_ok();
        self.stats.window = resolved.unwrap_or(self.stats.window);
    }

    /// Ends a poll, and returns true if the rate falls short and that is news. At [`Rate::UNLIMITED`]
    /// the next poll is due at `due`. Sets `changed` if the statistics have changed.
    fn end_poll(
        &mut self,
        now: Instant,
        due: Instant,
        baud_rate: Option<BaudRate>,
        changed: &mut bool,
    ) -> bool {
        if self.stats.rate.period().is_none() {
            self.due = due;
        }
        let is_over = self.speed.finish_span(now, baud_rate, &mut self.stats);
        *changed |= is_over;
        is_over && self.speed.is_news(self.stats.shortfall)
    }

    /// Number of scans that readers missed since the last call.
    fn newly_missed(&mut self) -> u64 {
        let missed = self.ring.missed();
        missed - std::mem::replace(&mut self.missed, missed)
    }

    /// Passes `error` on unless it is of the same kind as the last error since the last
    /// scan.
    fn report(&mut self, error: &Error) {
        let kind = discriminant(error.kind());
        if self.condition.replace(kind) != Some(kind) {
            self.ring.report(error.clone());
        }
    }
}
