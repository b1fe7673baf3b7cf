//! [`Schedules`]: the polls of all streams, and the times at which they are due. Knows
//! no ports and no replies.

#[cfg(test)]
mod tests;

use std::iter::repeat_n;
use std::mem::{Discriminant, discriminant};
use std::sync::{Arc, Weak};
use std::time::Duration;

use tokio::time::Instant;

use super::rate_meter::{RateMeter, Shortfall};
use crate::ring::{Cursor, Ring};
use crate::scan::{Scan, ScanMeta};
use crate::state::{Audience, ScheduleStats, Telemetry};
use crate::{Error, Rate, Window};

/// Everything that is polled.
#[derive(Debug, Default)]
pub(crate) struct Schedules {
    all: Vec<Schedule>,
    /// The number of scans that were overwritten before a consumer read them.
    missed: u64,
    /// True if the published statistics are out of date.
    changed: bool,
}

/// One window at one rate, and the streams that want it.
#[derive(Debug)]
struct Schedule {
    window: Window,
    rate: Rate,
    ring: Arc<Ring>,
    /// The next place on the grid; or, as fast as possible, when the last poll
    /// ended.
    due: Instant,
    sequence: u64,
    /// The values of the latest scan that the ring has dropped: the next reply is decoded
    /// into their block, if nobody else holds them.
    spare: Option<Arc<[u16]>>,
    /// The number of scans that its readers had missed by its latest poll.
    missed: u64,
    /// The kind of the last error since the last scan.
    condition: Option<Discriminant<Error>>,
    speed: RateMeter,
}

/// A poll that is due.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DuePoll {
    pub(crate) window: Window,
    pub(crate) rate: Rate,
}

/// The changes at the end of a poll.
#[derive(Debug)]
struct Ended {
    /// The number of scans that readers have missed since the poll before.
    missed: u64,
    /// True if a span of the rate's measurement is over.
    changed: bool,
    /// The reason why its rate falls short, if that is news.
    shortfall: Option<Shortfall>,
}

/// The result of a poll.
#[derive(Debug, Default)]
pub(crate) struct Delivered {
    /// Its values are the same as those before.
    pub(crate) repeat: bool,
    /// The rate is not reached, which is reported once.
    pub(crate) shortfall: Option<Shortfall>,
}

impl Schedules {
    /// Returns a reader of the scans of `window` at `rate`, from the next one on. Equal
    /// subscriptions share a schedule. `trouble`, if any, is reported to it first.
    pub(crate) fn subscribe(
        &mut self,
        window: Window,
        rate: Rate,
        depth: usize,
        trouble: Option<&Error>,
    ) -> Cursor {
        self.drop_unread();
        if let Some(schedule) = self.find(window, rate) {
            return schedule.subscribe(depth, trouble);
        }
        let mut schedule = Schedule::new(window, rate);
        let reader = schedule.subscribe(depth, trouble);
        // Most sensors have one.
        self.all.reserve_exact(1);
        self.all.push(schedule);
        self.changed = true;
        reader
    }

    /// Continues after a time without polls. The places on the grid that went by do not
    /// count as skipped, and rates are measured anew.
    pub(crate) fn resume(&mut self, now: Instant) {
        for schedule in &mut self.all {
            schedule.catch_up(now);
            schedule.speed.restart(now);
        }
    }

    /// Returns the time at which the next poll is due.
    pub(crate) fn next_due(&self) -> Option<Instant> {
        self.all.iter().map(|schedule| schedule.due).min()
    }

    /// Returns the time at which the poll after the next one is due, if the next one is on
    /// a grid.
    pub(crate) fn due_after_next(&self) -> Option<Instant> {
        let next = self.all.iter().min_by_key(|schedule| schedule.due)?;
        let others = self.all.iter().filter(|schedule| !std::ptr::eq(*schedule, next));
        let again = next.due + next.rate.period()?;
        Some(others.map(|schedule| schedule.due).fold(again, Instant::min))
    }

    /// Returns true if nothing is polled.
    pub(crate) fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// Takes the poll that has been due for longest, and how many places on its
    /// grid went by unused. Schedules without readers end when they are due: a poll looks
    /// at the readers of its own schedule only, so that its cost does not grow with the
    /// number of all.
    pub(crate) fn take_due(&mut self, now: Instant) -> Option<(DuePoll, u64)> {
        loop {
            let schedule = self.all.iter_mut().min_by_key(|schedule| schedule.due)?;
            if schedule.due > now {
                return None;
            }
            if schedule.ring.readers() > 0 {
                let skipped = schedule.advance(now);
                return Some((DuePoll { window: schedule.window, rate: schedule.rate }, skipped));
            }
            self.drop_unread();
        }
    }

    /// Takes the block to decode the reply to `poll` into.
    pub(crate) fn take_spare(&mut self, poll: DuePoll) -> Arc<[u16]> {
        // Room for what a poll asks for beside its window.
        let points = poll.window.points() + usize::from(Window::MAX_EXTRA_POINTS);
        let spare = self.find(poll.window, poll.rate).and_then(|schedule| schedule.spare.take());
        spare.unwrap_or_else(|| repeat_n(0, points).collect())
    }

    /// Delivers the `values` that `poll` brought, of which those before `first` are not of
    /// its window.
    pub(crate) fn deliver(
        &mut self,
        poll: DuePoll,
        values: Arc<[u16]>,
        first: usize,
        mut meta: ScanMeta,
    ) -> Delivered {
        let Some(schedule) = self.find(poll.window, poll.rate) else { return Delivered::default() };
        meta.sequence = schedule.sequence;
        schedule.sequence += 1;
        schedule.condition = None;
        let fresh = values.get(first..).unwrap_or_default();
        let latest = schedule.ring.latest();
        meta.repeat = latest.is_some_and(|latest| fresh.starts_with(latest.values()));
        let displaced = schedule.ring.push(Scan::new(poll.window, values, first, meta));
        schedule.spare = displaced.map(Scan::into_block);
        schedule.speed.count_scan();
        let ended = schedule.end_poll();
        Delivered { repeat: meta.repeat, shortfall: self.note_end(ended) }
    }

    /// Reports the error of one poll.
    pub(crate) fn fail(&mut self, poll: DuePoll, error: &Error) -> Delivered {
        let Some(schedule) = self.find(poll.window, poll.rate) else { return Delivered::default() };
        schedule.report(error);
        schedule.speed.count_failure();
        let ended = schedule.end_poll();
        Delivered { repeat: false, shortfall: self.note_end(ended) }
    }

    /// Adds up what the end of a poll brought, and returns its shortfall.
    fn note_end(&mut self, ended: Ended) -> Option<Shortfall> {
        self.changed |= ended.changed;
        self.missed += ended.missed;
        ended.shortfall
    }

    /// Reports a lost link to all streams, and sets all rates to zero.
    pub(crate) fn fail_all(&mut self, error: &Error) {
        for schedule in &mut self.all {
            schedule.report(error);
            schedule.speed.clear();
            self.changed = true;
        }
    }

    /// Publishes the statistics of the schedules if they have changed.
    pub(crate) fn note(&mut self, telemetry: &Telemetry) {
        if std::mem::take(&mut self.changed) {
            telemetry.set_schedules(self.all.iter().map(|one| {
                let audience: Weak<Ring> = Arc::downgrade(&one.ring);
                (one.stats(), audience as Weak<dyn Audience>)
            }));
        }
    }

    /// Returns what a schedule asked for and gets.
    pub(crate) fn stats(&mut self, poll: DuePoll) -> Option<ScheduleStats> {
        self.find(poll.window, poll.rate).map(|schedule| schedule.stats())
    }

    /// Returns the number of scans that were overwritten before a consumer read them, as
    /// each schedule knew it at its latest poll.
    pub(crate) fn missed(&self) -> u64 {
        self.missed
    }

    /// Ends all streams.
    pub(crate) fn end(&mut self, cause: Option<&Error>) {
        for schedule in self.all.drain(..) {
            schedule.ring.end(cause.cloned());
        }
    }

    /// Ends the schedules that nobody reads any more.
    fn drop_unread(&mut self) {
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

    fn find(&mut self, window: Window, rate: Rate) -> Option<&mut Schedule> {
        self.all.iter_mut().find(|schedule| schedule.window == window && schedule.rate == rate)
    }
}

impl Schedule {
    fn new(window: Window, rate: Rate) -> Self {
        let now = Instant::now();
        Self {
            window,
            rate,
            ring: Ring::new(),
            due: now,
            sequence: 0,
            spare: None,
            missed: 0,
            condition: None,
            speed: RateMeter::new(now),
        }
    }

    fn subscribe(&mut self, depth: usize, trouble: Option<&Error>) -> Cursor {
        if let Some(error) = trouble {
            self.report(error);
        }
        self.ring.subscribe(depth)
    }

    /// Moves on to the first place on the grid behind `now`, so that a poll is
    /// late at most once for being late; returns how many places that skips.
    fn advance(&mut self, now: Instant) -> u64 {
        let skipped = self.catch_up(now);
        self.due += self.rate.period().unwrap_or_default();
        skipped
    }

    /// Moves on to the last place on the grid that is due, if any is; returns
    /// how many places that skips.
    fn catch_up(&mut self, now: Instant) -> u64 {
        let Some(period) = self.rate.period() else {
            self.due = self.due.max(now);
            return 0;
        };
        let late = now.saturating_duration_since(self.due).as_nanos();
        let period = period.as_nanos();
        // A grid lasts as long as the stream: counted in u64 it would end after
        // 584 years.
        let skipped = (late / period) as u64;
        self.due += Duration::from_nanos((period * u128::from(skipped)) as u64);
        skipped
    }

    /// Returns the number of scans that its readers missed since the latest call.
    fn newly_missed(&mut self) -> u64 {
        let before = std::mem::replace(&mut self.missed, self.ring.missed());
        self.missed - before
    }

    /// Passes `error` on if it is another kind than the last one since the last
    /// scan.
    fn report(&mut self, error: &Error) {
        let kind = discriminant(error);
        if self.condition.replace(kind) != Some(kind) {
            self.ring.report(error.clone());
        }
    }

    fn stats(&self) -> ScheduleStats {
        let span = self.speed.span();
        ScheduleStats::new(self.window, self.rate, span.reached, span.failed)
    }

    /// Ends a poll: as fast as possible, the next one is due now.
    fn end_poll(&mut self) -> Ended {
        let (now, missed) = (Instant::now(), self.newly_missed());
        if self.rate.period().is_none() {
            self.due = now;
        }
        let Some(span) = self.speed.finish_span(now) else {
            return Ended { missed, changed: false, shortfall: None };
        };
        let shortfall = self.rate.period().and_then(|period| self.speed.report(span, period));
        Ended { missed, changed: true, shortfall }
    }
}
