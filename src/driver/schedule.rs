//! [`Schedules`]: the polls of all streams, and when each is due. Knows no ports or replies.

use std::mem::{Discriminant, discriminant};
use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use super::rate_meter::RateMeter;
use crate::ring::{Cursor, Ring};
use crate::scan::Scan;
use crate::state::Shared;
use crate::stats::ScheduleStats;
use crate::{BaudRate, Error, ErrorKind, Geometry, Rate, Window};

/// Most revolutions from one scan of a stream to the next.
const MOST_TURNS: u8 = 10;

/// All schedules of a driver, whose statistics they publish.
#[derive(Debug)]
pub(crate) struct Schedules {
    all: Vec<Schedule>,
    shared: Arc<Shared>,
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
    /// Number of grid points skipped before it.
    skipped: u64,
}

impl Schedules {
    pub(crate) fn new(shared: Arc<Shared>) -> Self {
        Self { all: Vec::new(), shared }
    }

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
        self.publish();
        reader
    }

    /// Resolves all windows for a sensor that was just found.
    pub(crate) fn resolve(&mut self, geometry: &Geometry) {
        self.all.iter_mut().for_each(|schedule| schedule.resolve(geometry));
    }

    /// Resumes polling: counts no grid point missed meanwhile as skipped, and measures rates anew.
    pub(crate) fn resume(&mut self, now: Instant) {
        self.drop_unread();
        for schedule in &mut self.all {
            schedule.catch_up(now);
            schedule.speed.restart(now);
        }
    }

    /// Stream that serves all schedules, if there are any that are not too slow for one.
    pub(crate) fn stream(&self, revolution: Duration) -> Option<StreamWish> {
        let turns = self.all.iter().filter_map(|schedule| schedule.turns(revolution)).min()?;
        let is_dense = |turns: &u8| self.all.iter().all(|one| one.is_served(revolution, *turns));
        let skipped = (1..=turns).rev().find(is_dense).map_or(0, |turns| turns - 1);
        // The slow ones take their scans from it, too: a poll beside it would wait for the next.
        let measured = self.all.iter().filter(|schedule| schedule.is_measured);
        let window = measured.map(|schedule| schedule.stats.window);
        Some(StreamWish { window: window.reduce(|one, other| one.hull(&other))?, skipped })
    }

    /// Serves the schedules from the stream.
    pub(crate) fn begin_stream(&mut self) {
        self.all.iter_mut().for_each(|schedule| schedule.is_streamed = schedule.is_measured);
    }

    /// Polls for all schedules again.
    pub(crate) fn end_stream(&mut self) {
        self.all.iter_mut().for_each(|schedule| schedule.is_streamed = false);
    }

    /// Takes a poll of each schedule that gets a scan of the stream, which came at `now` or would have
    /// come then without a delay. The scans come `period` apart. Grid points without a scan do not
    /// count as skipped: the sensor sends when its motor has turned. A scan that shows only part of a
    /// window was sent before the stream had it.
    pub(crate) fn take_streamed(
        &mut self,
        now: Instant,
        period: Duration,
        shown: Option<Window>,
    ) -> Vec<DuePoll> {
        let is_shown = |window: &Window| shown.is_none_or(|shown| shown.holds(window));
        let all = self.all.iter_mut();
        let streamed = all.filter(|one| one.is_streamed && is_shown(&one.stats.window));
        let taken = streamed.filter_map(|schedule| {
            // A scan that is a little early is for the point that follows.
            let is_due = schedule.due <= now + period / 2;
            if is_due {
                schedule.advance(now);
            }
            // No motor turns exactly with the grid, so a stream at the rate of the scans gets each of them.
            let asked = schedule.stats.rate.period();
            let gets_each = asked.is_none_or(|asked| asked <= period + period / 100);
            (is_due || gets_each).then(|| schedule.poll(0))
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

    /// Takes the poll that has been due longest. Drops unread schedules only when they are due: a poll
    /// checks only its own schedule's readers, so its cost does not grow with the number of schedules.
    pub(crate) fn take_due(&mut self, now: Instant) -> Option<DuePoll> {
        loop {
            let polled = self.all.iter_mut().filter(|schedule| !schedule.is_streamed);
            let schedule = polled.min_by_key(|schedule| schedule.due)?;
            if schedule.due > now {
                return None;
            }
            // Readers own the ring, too. Cheaper than to count them.
            if Arc::strong_count(&schedule.ring) > 1 {
                let skipped = schedule.advance(now);
                return Some(schedule.poll(skipped));
            }
            self.drop_unread();
        }
    }

    /// Delivers the scan that `poll` received, on a line at `baud_rate` if there is one.
    pub(crate) fn deliver(&mut self, poll: DuePoll, scan: Scan, baud_rate: Option<BaudRate>) {
        let Some(schedule) = find(&mut self.all, poll.window, poll.rate) else { return };
        schedule.condition = None;
        let received_at = scan.received_at();
        let latency = received_at.saturating_duration_since(scan.meta.requested_at);
        schedule.speed.count_scan(received_at, latency, scan.scan_time());
        schedule.stats.protocol = scan.geometry().protocol();
        let (repeats, missed) = schedule.ring.push(scan);
        let newly_missed = missed - std::mem::replace(&mut schedule.missed, missed);
        if repeats || newly_missed > 0 || poll.skipped > 0 {
            let stats = &mut self.shared.counters.lock().stats;
            stats.repeats += u64::from(repeats);
            stats.missed += newly_missed;
            stats.polls_skipped += poll.skipped;
        }
        if schedule.end_poll(received_at, received_at, baud_rate) {
            self.publish();
        }
    }

    /// Reports the error of one poll. At [`Rate::UNLIMITED`] the next one is due at `again`.
    #[cold]
    pub(crate) fn fail(&mut self, poll: DuePoll, error: &Error, again: Instant) {
        let Some(schedule) = find(&mut self.all, poll.window, poll.rate) else { return };
        schedule.report(error);
        schedule.speed.count_failure();
        self.shared.counters.lock().stats.polls_skipped += poll.skipped;
        if schedule.end_poll(Instant::now(), again, None) {
            self.publish();
        }
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
            schedule.stats = ScheduleStats::new(schedule.stats.window, schedule.stats.rate);
        }
        self.publish();
    }

    fn publish(&self) {
        let rings = self.all.iter().map(|one| (one.stats, Arc::downgrade(&one.ring)));
        self.shared.counters.set_schedules(rings);
    }

    /// Ends all streams.
    pub(crate) fn end(&self, cause: Option<&Error>) {
        for schedule in &self.all {
            schedule.ring.end(cause.cloned());
        }
    }

    /// Drops the schedules without readers.
    pub(crate) fn drop_unread(&mut self) {
        self.all.retain(|schedule| {
            let is_read = schedule.ring.readers() > 0;
            if !is_read {
                let newly_missed = schedule.ring.missed() - schedule.missed;
                self.shared.counters.lock().stats.missed += newly_missed;
            }
            is_read
        });
    }
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
            stats: ScheduleStats::new(window, rate),
            is_measured: true,
            ring: Ring::new(),
            due: now,
            missed: 0,
            is_streamed: false,
            condition: None,
            speed: RateMeter::new(now),
        }
    }

    /// Number of revolutions in a period. `None` if it is too slow for a stream, or cannot be served.
    fn turns(&self, revolution: Duration) -> Option<u8> {
        let period = self.stats.rate.period().unwrap_or_default();
        // To within a twentieth, so that no rounding halves the rate.
        let turns = (period + revolution / 20).as_nanos() / revolution.as_nanos().max(1);
        u8::try_from(turns).ok().filter(|turns| self.is_measured && *turns <= MOST_TURNS)
    }

    /// Returns true if one scan every `turns` revolutions serves the schedule: its period is a multiple
    /// of them, or each scan comes within an eighth of the period of its time.
    fn is_served(&self, revolution: Duration, turns: u8) -> bool {
        let period = self.stats.rate.period().unwrap_or_default();
        let (apart, shorter) = (revolution * turns.into(), revolution / 20);
        let over = || (period + shorter).as_nanos() % apart.as_nanos().max(1);
        let is_multiple = || over() <= (shorter + period / 100).as_nanos();
        turns == 1 || !self.is_measured || period >= 4 * apart || is_multiple()
    }

    fn poll(&self, skipped: u64) -> DuePoll {
        let ScheduleStats { window, rate, .. } = self.stats;
        DuePoll { window, rate, is_measured: self.is_measured, skipped }
    }

    /// Advances to the first grid point after `now`, so that a late poll delays at most
    /// one other. Returns the number of grid points skipped.
    fn advance(&mut self, now: Instant) -> u64 {
        let skipped = self.catch_up(now);
        self.due += self.stats.rate.period().unwrap_or_default();
        skipped
    }

    /// Advances to the last grid point that is due, if any. Returns the number of grid points skipped.
    fn catch_up(&mut self, now: Instant) -> u64 {
        let Some(period) = self.stats.rate.period() else { return 0 };
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

    /// Ends a poll, and returns true if the statistics have changed. At [`Rate::UNLIMITED`] the next
    /// poll is due at `due`.
    fn end_poll(&mut self, now: Instant, due: Instant, baud_rate: Option<BaudRate>) -> bool {
        if self.stats.rate.period().is_none() {
            self.due = due;
        }
        let is_over = self.speed.finish_span(now, baud_rate, &mut self.stats);
        if is_over && self.is_measured && self.speed.is_news(self.stats.shortfall) {
            self.warn_of_shortfall();
        }
        is_over
    }

    /// Logs why the rate falls short.
    #[cold]
    fn warn_of_shortfall(&self) {
        let ScheduleStats { window, rate, reached, .. } = self.stats;
        let reached = reached.unwrap_or_default();
        let explanation = self.stats.explanation().unwrap_or_default();
        tracing::warn!(%window, asked = %rate, reached, "{explanation}");
    }

    /// Passes `error` on unless it is of the same kind as the last error since the last scan.
    fn report(&mut self, error: &Error) {
        let kind = discriminant(error.kind());
        if self.condition.replace(kind) != Some(kind) {
            self.ring.report(error.clone());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_fast_motor_leaves_the_grid_as_it_is() {
        const PERIOD: Duration = Duration::from_millis(100);
        let start = Instant::now();
        let mut schedules = Schedules::new(Arc::new(Shared::new(None)));
        let _reader = schedules.subscribe(Window::FULL, Rate::hz(10.0), 1, None, None);
        schedules.begin_stream();
        let turn = Duration::from_micros(99_760);
        for n in 0..10_000 {
            assert!(!schedules.take_streamed(start + turn * n, PERIOD, None).is_empty());
        }
        schedules.end_stream();
        let ahead = schedules.next_due().unwrap() - (start + turn * 9_999);
        assert!(ahead <= PERIOD * 3 / 2, "{ahead:?}");
    }
}
