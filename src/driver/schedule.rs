//! [`Schedules`]: the polls of all streams, and the times at which they are due. Knows
//! no ports and no replies.

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
    /// Missed scans of schedules that are gone.
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
    previous: Option<Arc<[u16]>>,
    /// The values before those: their block is used again once nobody holds them.
    spare: Option<Arc<[u16]>>,
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

    /// Returns true if nothing is polled.
    pub(crate) fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// Takes the poll that has been due for longest, and how many places on its
    /// grid went by unused. Schedules without readers end here.
    pub(crate) fn take_due(&mut self, now: Instant) -> Option<(DuePoll, u64)> {
        self.drop_unread();
        let schedule = self.all.iter_mut().min_by_key(|schedule| schedule.due)?;
        if schedule.due > now {
            return None;
        }
        let skipped = schedule.advance(now);
        Some((DuePoll { window: schedule.window, rate: schedule.rate }, skipped))
    }

    /// Delivers the values that `poll` brought.
    pub(crate) fn deliver(
        &mut self,
        poll: DuePoll,
        values: &[u16],
        mut meta: ScanMeta,
    ) -> Delivered {
        let Some(schedule) = self.find(poll.window, poll.rate) else { return Delivered::default() };
        meta.sequence = schedule.sequence;
        meta.repeat = schedule.previous.as_deref() == Some(values);
        schedule.sequence += 1;
        schedule.condition = None;
        let values = schedule.reuse_block(values);
        schedule.ring.push(Scan::new(poll.window, values, 0, meta));
        let now = Instant::now();
        if schedule.rate.period().is_none() {
            schedule.due = now;
        }
        schedule.speed.count_scan();
        let (changed, shortfall) = schedule.finish_span(now);
        self.changed |= changed;
        Delivered { repeat: meta.repeat, shortfall }
    }

    /// Reports the error of one poll.
    pub(crate) fn fail(&mut self, poll: DuePoll, error: &Error) -> Delivered {
        let Some(schedule) = self.find(poll.window, poll.rate) else { return Delivered::default() };
        let now = Instant::now();
        schedule.report(error);
        if schedule.rate.period().is_none() {
            schedule.due = now;
        }
        schedule.speed.count_failure();
        let (changed, shortfall) = schedule.finish_span(now);
        self.changed |= changed;
        Delivered { repeat: false, shortfall }
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

    /// Returns the number of scans that were overwritten before a consumer read them.
    pub(crate) fn missed(&self) -> u64 {
        self.missed + self.all.iter().map(|schedule| schedule.ring.missed()).sum::<u64>()
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
        all.retain(|schedule| {
            let read = schedule.ring.readers() > 0;
            if !read {
                *missed += schedule.ring.missed();
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
            previous: None,
            spare: None,
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

    /// Shares `values`, as those of the latest scan.
    fn reuse_block(&mut self, values: &[u16]) -> Arc<[u16]> {
        let reused = self.spare.take().and_then(|mut spare| {
            let place = Arc::get_mut(&mut spare).filter(|place| place.len() == values.len())?;
            place.copy_from_slice(values);
            Some(spare)
        });
        let values = reused.unwrap_or_else(|| values.into());
        self.spare = self.previous.replace(Arc::clone(&values));
        values
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

    /// Returns whether a span of the rate's measurement is over, and why it falls
    /// short, if that is news.
    fn finish_span(&mut self, now: Instant) -> (bool, Option<Shortfall>) {
        let Some(span) = self.speed.finish_span(now) else { return (false, None) };
        let shortfall = self.rate.period().and_then(|period| self.speed.report(span, period));
        (true, shortfall)
    }
}

#[cfg(test)]
mod tests {
    use std::future::poll_fn;

    use futures::FutureExt;

    use super::*;

    const HUNDRED_MS: Duration = Duration::from_millis(100);

    fn schedules(rates: &[(Window, Rate)]) -> (Schedules, Vec<Cursor>) {
        let mut schedules = Schedules::default();
        let readers = rates
            .iter()
            .map(|&(window, rate)| schedules.subscribe(window, rate, 1, None))
            .collect();
        (schedules, readers)
    }

    #[tokio::test(start_paused = true)]
    async fn a_late_poll_goes_out_at_once_and_the_next_one_is_on_the_grid_again() {
        let start = Instant::now();
        let (mut schedules, _readers) = schedules(&[(Window::FULL, Rate::hz(10.0))]);
        let mut take = |at: u64| {
            let (_, skipped) = schedules.take_due(start + Duration::from_millis(at))?;
            let due = schedules.next_due()?;
            Some((skipped, (due - start).as_millis()))
        };
        assert_eq!(take(0), Some((0, 100)));
        assert_eq!(take(99), None);
        assert_eq!(take(100), Some((0, 200)));
        assert_eq!(take(260), Some((0, 300)));
        assert_eq!(take(650), Some((3, 700)));
        assert_eq!(take(700), Some((0, 800)));
    }

    #[tokio::test(start_paused = true)]
    async fn a_suspend_of_eight_hours_costs_one_poll_and_no_burst() {
        let start = Instant::now();
        let (mut schedules, _readers) = schedules(&[(Window::FULL, Rate::hz(10.0))]);
        assert!(schedules.take_due(start).is_some());
        let later = start + Duration::from_secs(8 * 3600) + Duration::from_millis(30);
        let skipped = schedules.take_due(later).map(|(_, skipped)| skipped);
        assert_eq!(skipped, Some(8 * 36_000 - 1));
        assert!(schedules.take_due(later).is_none());
        assert_eq!(schedules.next_due(), Some(later + Duration::from_millis(70)));
    }

    #[tokio::test(start_paused = true)]
    async fn what_has_been_due_for_longest_goes_first() {
        let start = Instant::now();
        let fast = (Window::FULL, Rate::hz(20.0));
        let slow = (Window::DETECTION, Rate::hz(10.0));
        let (mut schedules, _readers) = schedules(&[fast, slow]);
        let mut order = Vec::new();
        for _ in 0..4 {
            order.push(schedules.take_due(start + HUNDRED_MS).map(|(poll, _)| poll.window));
        }
        assert_eq!(order, [Some(Window::FULL), Some(Window::DETECTION), None, None]);
    }

    #[tokio::test(start_paused = true)]
    async fn equal_schedules_are_one_and_one_without_readers_ends() {
        let same = (Window::FULL, Rate::MAX);
        let (mut schedules, readers) = schedules(&[same, same]);
        let telemetry = Telemetry::new(None);
        schedules.note(&telemetry);
        assert_eq!(telemetry.snapshot().schedules.len(), 1);
        assert!(schedules.take_due(Instant::now()).is_some());
        drop(readers);
        assert_eq!(telemetry.snapshot().schedules, [], "before the driver has noticed");
        assert!(schedules.take_due(Instant::now()).is_none());
        assert!(schedules.is_empty());
    }

    #[tokio::test(start_paused = true)]
    async fn a_condition_is_reported_once_until_it_changes_or_a_scan_comes() {
        let (window, rate) = (Window::single(384), Rate::MAX);
        let (mut schedules, mut readers) = schedules(&[(window, rate)]);
        let poll = DuePoll { window, rate };
        let now = Instant::now();
        let meta = ScanMeta {
            sequence: 0,
            requested_at: now,
            received_at: now,
            stamp: std::time::SystemTime::now(),
            repeat: false,
            scan_time: HUNDRED_MS,
            reconnects: 0,
        };
        let mut errors = 0;
        let mut count = |schedules: &mut Schedules, error: Option<Error>| {
            match error {
                Some(error) => drop(schedules.fail(poll, &error)),
                None => drop(schedules.deliver(poll, &[1000], meta)),
            }
            let next = readers.iter_mut().map(|reader| poll_fn(|cx| reader.poll_next(cx)));
            let items = next.filter_map(FutureExt::now_or_never);
            errors += items.filter(|item| matches!(item, Some(Err(_)))).count();
            errors
        };
        assert_eq!(count(&mut schedules, Some(Error::LaserOff)), 1);
        assert_eq!(count(&mut schedules, Some(Error::LaserOff)), 1);
        assert_eq!(count(&mut schedules, Some(Error::Loopback { sensor: None })), 2);
        assert_eq!(count(&mut schedules, None), 2);
        assert_eq!(count(&mut schedules, Some(Error::Loopback { sensor: None })), 3);
    }
}
