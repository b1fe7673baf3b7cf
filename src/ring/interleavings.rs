//! Every interleaving of two writers and three readers at a ring, without a bound.
//!
//! One lock protects everything they share, and a `Notify` wakes the readers. So whatever a
//! thread does under the lock is one step, and so is each call of the `Notify`. A step that takes
//! the lock twice fails the test, because others could run in between. One thread makes all steps
//! in every order. States reached before are not explored again, but their orders are counted.

use std::cell::Cell;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll, Wake, Waker};

use super::tests::scan;
use super::{Cursor, Ring};
use crate::{Error, ErrorKind};

thread_local! {
    /// How often the current step has taken the lock of a ring.
    static LOCKS: Cell<usize> = const { Cell::new(0) };
}

/// Counts a lock. Called by each lock of a ring.
pub(super) fn count_lock() {
    LOCKS.set(LOCKS.get() + 1);
}

fn cause() -> Error {
    ErrorKind::Loopback.into()
}

/// Operation of a writer.
#[derive(Debug, Clone, Copy)]
enum Write {
    Push,
    Report,
    End,
}

/// Writer between two steps.
#[derive(Debug)]
struct ModelWriter {
    writes: &'static [Write],
    /// True if it has changed the ring, and wakes the readers next.
    has_news: bool,
}

impl ModelWriter {
    fn step(&mut self, ring: &Ring) {
        if std::mem::take(&mut self.has_news) {
            return ring.changed.notify_waiters();
        }
        let Some((write, rest)) = self.writes.split_first() else { return };
        (self.writes, self.has_news) = (rest, true);
        let mut inner = ring.lock();
        match *write {
            Write::Push => _ = inner.push(scan()),
            Write::Report => inner.report(ErrorKind::LaserOff.into()),
            Write::End => inner.end(Some(cause())),
        }
    }

    fn is_done(&self) -> bool {
        self.writes.is_empty() && !self.has_news
    }
}

/// Change in the life of a reader, which otherwise reads to the end.
#[derive(Debug, Clone, Copy)]
enum Change {
    /// No change, or no further change.
    None,
    /// Continues as a clone of itself after reading this number of items.
    Clone(usize),
    /// Subscribes again after reading this number of items.
    Renew(usize),
    /// Is dropped after reading this number of items.
    Leave(usize),
}

/// True while its task runs, or was woken.
#[derive(Debug)]
struct TaskWaker(AtomicBool);

impl Wake for TaskWaker {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Reader between two steps.
#[derive(Debug)]
struct ModelReader {
    cursor: Option<Cursor>,
    /// Reader that was cloned or has ended, and is dropped next.
    original: Option<Cursor>,
    change: Change,
    /// True if it may be dropped before the end, or subscribe after the end.
    may_miss_cause: bool,
    /// True if it found nothing in the ring, and waits for a change next.
    is_waiting: bool,
    /// Number of wake-ups of the ring before its cursor began to wait for one.
    wakeups: usize,
    /// True if its task runs, or was woken.
    woken: Arc<TaskWaker>,
    scans: Vec<u64>,
    errors: Vec<String>,
}

impl ModelReader {
    fn new(cursor: Cursor, change: Change) -> Self {
        Self {
            cursor: Some(cursor),
            original: None,
            change,
            may_miss_cause: matches!(change, Change::Leave(_) | Change::Renew(_)),
            is_waiting: false,
            wakeups: 0,
            woken: Arc::new(TaskWaker(AtomicBool::new(true))),
            scans: Vec::new(),
            errors: Vec::new(),
        }
    }

    /// Takes a step, after this number of wake-ups of the ring.
    fn step(&mut self, wakeups: usize) {
        let items = self.scans.len() + self.errors.len();
        match self.change {
            _ if self.original.is_some() => self.original = None,
            _ if self.is_waiting => self.wait(wakeups),
            Change::Leave(after) if after == items => self.cursor = None,
            Change::Clone(after) if after == items => self.replace(Cursor::clone, wakeups),
            Change::Renew(after) if after == items => self.replace(Cursor::resubscribe, wakeups),
            _ => self.take(),
        }
    }

    fn replace(&mut self, another: impl FnOnce(&Cursor) -> Cursor, wakeups: usize) {
        (self.change, self.wakeups) = (Change::None, wakeups);
        let next = self.cursor.as_ref().map(another);
        self.original = std::mem::replace(&mut self.cursor, next);
    }

    fn is_ready(&self) -> bool {
        self.original.is_some() || self.cursor.is_some() && self.woken.0.load(Ordering::Relaxed)
    }

    fn take(&mut self) {
        match self.cursor.as_mut().map(Cursor::take) {
            Some(Poll::Pending) => self.is_waiting = true,
            Some(Poll::Ready(Some(Ok(scan)))) => self.scans.push(scan.sequence()),
            Some(Poll::Ready(Some(Err(error)))) => self.errors.push(error.to_string()),
            Some(Poll::Ready(None)) | None => self.original = self.cursor.take(),
        }
    }

    fn wait(&mut self, wakeups: usize) {
        let waker = Waker::from(Arc::clone(&self.woken));
        let Some(cursor) = &mut self.cursor else { return };
        self.woken.0.store(false, Ordering::Relaxed);
        if cursor.poll_change(&mut Context::from_waker(&waker)).is_ready() {
            (self.is_waiting, self.wakeups) = (false, wakeups);
            self.woken.0.store(true, Ordering::Relaxed);
        }
    }
}

/// All writers and readers after some steps.
struct Model {
    ring: Arc<Ring>,
    /// Number of times that a writer has woken the readers.
    wakeups: usize,
    writers: [ModelWriter; 2],
    readers: [ModelReader; 3],
}

impl Model {
    fn after(
        steps: &[usize],
        writes: [&'static [Write]; 2],
        changes: [(usize, Change); 3],
    ) -> Self {
        let ring = Ring::new();
        let writers = writes.map(|writes| ModelWriter { writes, has_news: false });
        let readers =
            changes.map(|(depth, change)| ModelReader::new(ring.subscribe(depth), change));
        let mut model = Self { ring, wakeups: 0, writers, readers };
        steps.iter().for_each(|step| model.step(*step));
        model
    }

    /// Lists the writers and readers that can take a step: 0 and 1, and 2 to 4.
    fn ready(&self) -> Vec<usize> {
        let writers = self.writers.iter().map(|writer| !writer.is_done());
        let readers = self.readers.iter().map(ModelReader::is_ready);
        let ready = writers.chain(readers).enumerate().filter(|(_, is_ready)| *is_ready);
        ready.map(|(number, _)| number).collect()
    }

    fn step(&mut self, number: usize) {
        LOCKS.set(0);
        let reader = number.checked_sub(self.writers.len());
        if let Some(writer) = self.writers.get_mut(number) {
            self.wakeups += usize::from(writer.has_news);
            writer.step(&self.ring);
        } else if let Some(reader) = reader.and_then(|number| self.readers.get_mut(number)) {
            reader.step(self.wakeups);
        }
        assert!(LOCKS.get() <= 1, "a step of {number} took the lock {} times", LOCKS.get());
    }

    /// Everything that determines the next steps, and what was read.
    fn state(&self) -> String {
        let inner = self.ring.lock();
        let scans: Vec<_> = inner.scans.iter().map(crate::Scan::sequence).collect();
        let error = inner.error.as_ref().map(Error::to_string);
        let shared = (
            (inner.ended, inner.next, inner.missed, &inner.depths, scans),
            (error, inner.error_at, inner.errors),
        );
        let writers = self.writers.each_ref().map(|writer| (writer.writes.len(), writer.has_news));
        let readers = self.readers.each_ref().map(|reader| {
            let places = [&reader.cursor, &reader.original]
                .map(|cursor| cursor.as_ref().map(|cursor| cursor.place));
            let is_woken = reader.woken.0.load(Ordering::Relaxed);
            let waits = (reader.is_waiting, reader.wakeups == self.wakeups, is_woken);
            (places, reader.change, waits, &reader.scans, &reader.errors)
        });
        format!("{shared:?}{writers:?}{readers:?}")
    }

    /// Fails unless all have ended and have read what they had to.
    fn check(&self, steps: &[usize]) {
        for reader in &self.readers {
            let ModelReader { cursor, may_miss_cause, scans, errors, .. } = reader;
            assert!(cursor.is_none(), "a reader waits for ever after {steps:?}: {reader:?}");
            assert!(scans.is_sorted_by(|one, next| one < next), "{steps:?}: {reader:?}");
            let causes = errors.iter().filter(|error| **error == cause().to_string()).count();
            let at_least = usize::from(!may_miss_cause);
            assert!((at_least..=1).contains(&causes), "{steps:?}: {reader:?}");
        }
        assert_eq!(self.ring.readers(), 0, "{steps:?}");
    }
}

/// Explored states, each with the number of orders from there to the end.
#[derive(Default)]
struct Explorer {
    orders: HashMap<String, u128>,
}

impl Explorer {
    /// Makes all further steps after these, in every order, and returns the number of orders.
    fn explore(
        &mut self,
        steps: &mut Vec<usize>,
        writes: [&'static [Write]; 2],
        changes: [(usize, Change); 3],
    ) -> u128 {
        let model = Model::after(steps, writes, changes);
        let state = model.state();
        if let Some(orders) = self.orders.get(&state) {
            return *orders;
        }
        let ready = model.ready();
        if ready.is_empty() {
            model.check(steps);
        }
        let mut orders = u128::from(ready.is_empty());
        for number in ready {
            steps.push(number);
            orders += self.explore(steps, writes, changes);
            steps.pop();
        }
        self.orders.insert(state, orders);
        orders
    }
}

/// Explores the last writes of each writer: one, or the number in `SCIP_RING_WRITES`.
fn explore(writes: [&'static [Write]; 2], changes: [(usize, Change); 3]) {
    let setting = std::env::var("SCIP_RING_WRITES").ok();
    let count: usize = setting.and_then(|text| text.parse().ok()).unwrap_or(1);
    let writes = writes.map(|writes| writes.split_at(writes.len().saturating_sub(count)).1);
    let mut explorer = Explorer::default();
    let orders = explorer.explore(&mut Vec::new(), writes, changes);
    println!("{orders} orders, {} states", explorer.orders.len());
}

#[test]
fn three_readers_reach_the_end() {
    explore(
        [&[Write::Push, Write::Push], &[Write::Report, Write::End]],
        [(1, Change::None), (2, Change::None), (1, Change::None)],
    );
}

#[test]
fn readers_that_come_and_go_block_nobody() {
    explore(
        [&[Write::Push, Write::Push], &[Write::Report, Write::End]],
        [(1, Change::Renew(0)), (2, Change::Clone(0)), (1, Change::Leave(1))],
    );
}

/// No end follows that would wake them.
#[test]
fn each_item_wakes_each_reader() {
    for write in [&[Write::Push], &[Write::Report]] {
        explore([write, &[]], [1, 2, 1].map(|depth| (depth, Change::Leave(1))));
    }
}
