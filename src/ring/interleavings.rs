//! Every interleaving of two writers and three readers at a ring, without a bound.
//!
//! All that they share is behind one lock, so what one of them does while it holds the lock
//! is one step, and so is the call of a waker. One thread makes the steps of all in every
//! order. A state that was reached before is not explored again, but its orders are counted.
//! `model.rs` has real threads, within a bound.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll, Wake, Waker};

use super::tests::scan;
use super::{Cursor, ReaderState, Ring};
use crate::Error;

fn cause() -> Error {
    Error::Loopback { sensor: None }
}

/// An operation of a writer.
#[derive(Debug, Clone, Copy)]
enum Write {
    Push(u64),
    Report,
    End,
}

/// A writer between two steps.
#[derive(Debug)]
struct Writer {
    writes: &'static [Write],
    /// The entry from which on it wakes readers, between two writes `None`.
    entry: Option<usize>,
    /// A waker that it has taken and not called yet.
    waker: Option<Waker>,
}

impl Writer {
    fn step(&mut self, ring: &Ring) {
        if let Some(waker) = self.waker.take() {
            waker.wake();
        } else if let Some(entry) = &mut self.entry {
            self.waker = ring.take_waker(entry);
            if self.waker.is_none() {
                self.entry = None;
            }
        } else if let Some((write, rest)) = self.writes.split_first() {
            self.writes = rest;
            let is_news = match *write {
                Write::Push(sequence) => {
                    ring.lock().push(scan(sequence));
                    true
                }
                Write::Report => {
                    ring.lock().report(Error::LaserOff);
                    true
                }
                Write::End => ring.lock().end(Some(cause())),
            };
            self.entry = is_news.then_some(0);
        }
    }

    fn is_done(&self) -> bool {
        self.writes.is_empty() && self.entry.is_none()
    }
}

/// A change in the life of a reader, which otherwise reads to the end.
#[derive(Debug, Clone, Copy)]
enum Change {
    /// None, or none any more.
    None,
    /// It goes on with a clone of itself, once it has read so many items.
    Clone(usize),
    /// It subscribes anew and reads from there, once it has read so many items.
    Renew(usize),
    /// It is dropped, once it has read so many items.
    Leave(usize),
    /// It moves to another task after its first poll.
    Move,
    /// It is on its way there: the other task polls it without a wake-up.
    Moving,
}

#[derive(Debug, Default)]
struct Woken(AtomicBool);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// A reader between two steps.
#[derive(Debug)]
struct Reader {
    cursor: Option<Cursor>,
    /// The one that was cloned, and is dropped next.
    original: Option<Cursor>,
    change: Change,
    /// True if it may be dropped before the end, or subscribe after the end.
    may_miss_cause: bool,
    /// True if its task runs, or was woken.
    woken: Arc<Woken>,
    scans: Vec<u64>,
    errors: Vec<String>,
}

impl Reader {
    fn new(cursor: Cursor, change: Change) -> Self {
        Self {
            cursor: Some(cursor),
            original: None,
            change,
            may_miss_cause: matches!(change, Change::Leave(_) | Change::Renew(_)),
            woken: Arc::new(Woken(AtomicBool::new(true))),
            scans: Vec::new(),
            errors: Vec::new(),
        }
    }

    fn waker(&self) -> Waker {
        Waker::from(Arc::clone(&self.woken))
    }

    fn step(&mut self) {
        let items = self.scans.len() + self.errors.len();
        match self.change {
            _ if self.original.is_some() => self.original = None,
            Change::Leave(after) if after == items => self.cursor = None,
            Change::Clone(after) if after == items => self.go_on_with(Cursor::clone),
            Change::Renew(after) if after == items => self.go_on_with(Cursor::resubscribe),
            Change::Moving => {
                self.change = Change::None;
                self.woken = Arc::new(Woken(AtomicBool::new(true)));
            }
            Change::Move => {
                self.change = Change::Moving;
                self.poll();
            }
            _ => self.poll(),
        }
    }

    fn go_on_with(&mut self, another: impl FnOnce(&Cursor) -> Cursor) {
        self.change = Change::None;
        let next = self.cursor.as_ref().map(another);
        self.original = std::mem::replace(&mut self.cursor, next);
    }

    fn is_ready(&self) -> bool {
        let is_woken = self.woken.0.load(Ordering::Relaxed);
        self.cursor.is_some() && (is_woken || matches!(self.change, Change::Moving))
    }

    fn poll(&mut self) {
        let waker = self.waker();
        let Some(cursor) = &mut self.cursor else { return };
        self.woken.0.store(false, Ordering::Relaxed);
        match cursor.poll_next(&mut Context::from_waker(&waker)) {
            Poll::Pending => return,
            Poll::Ready(Some(Ok(scan))) => self.scans.push(scan.sequence()),
            Poll::Ready(Some(Err(error))) => self.errors.push(error.to_string()),
            Poll::Ready(None) => self.cursor = None,
        }
        self.woken.0.store(true, Ordering::Relaxed);
    }
}

/// All of them after some steps.
struct Model {
    ring: Arc<Ring>,
    writers: [Writer; 2],
    readers: [Reader; 3],
}

impl Model {
    fn after(
        steps: &[usize],
        writes: [&'static [Write]; 2],
        changes: [(usize, Change); 3],
    ) -> Self {
        let ring = Ring::new();
        let writers = writes.map(|writes| Writer { writes, entry: None, waker: None });
        let readers = changes.map(|(depth, change)| Reader::new(ring.subscribe(depth), change));
        let mut model = Self { ring, writers, readers };
        steps.iter().for_each(|step| model.step(*step));
        model
    }

    /// Returns the writers and readers that can go on: 0 and 1, and 2 to 4.
    fn ready(&self) -> Vec<usize> {
        let writers = self.writers.iter().map(|writer| !writer.is_done());
        let readers = self.readers.iter().map(Reader::is_ready);
        let ready = writers.chain(readers).enumerate().filter(|(_, is_ready)| *is_ready);
        ready.map(|(number, _)| number).collect()
    }

    fn step(&mut self, number: usize) {
        let reader = number.checked_sub(self.writers.len());
        if let Some(writer) = self.writers.get_mut(number) {
            writer.step(&self.ring);
        } else if let Some(reader) = reader.and_then(|number| self.readers.get_mut(number)) {
            reader.step();
        }
    }

    /// Everything on which the next steps depend, and what was read.
    fn state(&self) -> String {
        let whose =
            |waker: &Waker| self.readers.iter().position(|reader| waker.will_wake(&reader.waker()));
        let inner = self.ring.lock();
        let entries = inner.readers.iter().map(|reader| match &reader.state {
            ReaderState::Gone => "gone".to_owned(),
            ReaderState::Busy => format!("{} busy", reader.depth),
            ReaderState::Waiting(waker) => format!("{} {:?}", reader.depth, whose(waker)),
        });
        let (ended, next, missed) = (inner.ended, inner.next, inner.missed);
        let scans = inner.scans.iter().map(crate::Scan::sequence);
        let shared = (
            (ended, next, missed, inner.depth, scans.collect::<Vec<_>>()),
            (inner.error.as_ref().map(Error::to_string), inner.error_at, inner.errors),
            entries.collect::<Vec<_>>(),
        );
        let writers = self
            .writers
            .each_ref()
            .map(|writer| (writer.writes.len(), writer.entry, writer.waker.as_ref().map(whose)));
        let readers = self.readers.each_ref().map(|reader| {
            let places = [&reader.cursor, &reader.original]
                .map(|cursor| cursor.as_ref().map(|cursor| cursor.place));
            let is_woken = reader.woken.0.load(Ordering::Relaxed);
            (places, reader.change, is_woken, &reader.scans, &reader.errors)
        });
        format!("{shared:?}{writers:?}{readers:?}")
    }

    /// Fails unless all have come to their end, with what they had to read.
    fn check(&self, steps: &[usize]) {
        for reader in &self.readers {
            let Reader { cursor, may_miss_cause, scans, errors, .. } = reader;
            assert!(cursor.is_none(), "a reader waits for ever after {steps:?}: {reader:?}");
            assert!(scans.is_sorted_by(|one, next| one < next), "{steps:?}: {reader:?}");
            let causes = errors.iter().filter(|error| **error == cause().to_string()).count();
            let at_least = usize::from(!may_miss_cause);
            assert!((at_least..=1).contains(&causes), "{steps:?}: {reader:?}");
        }
        assert_eq!(self.ring.readers(), 0, "{steps:?}");
    }
}

/// The states that were explored, and the number of orders from each of them to the end.
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

/// Explores the last writes of each writer: one, or as many as `SCIP_RING_WRITES` is.
fn explore(writes: [&'static [Write]; 2], changes: [(usize, Change); 3]) {
    let setting = std::env::var("SCIP_RING_WRITES").ok();
    let count: usize = setting.and_then(|text| text.parse().ok()).unwrap_or(1);
    let writes = writes.map(|writes| writes.split_at(writes.len() - count).1);
    let mut explorer = Explorer::default();
    let orders = explorer.explore(&mut Vec::new(), writes, changes);
    println!("{orders} orders, {} states", explorer.orders.len());
}

#[test]
fn three_readers_come_to_the_end_of_two_writers_in_every_order() {
    explore(
        [&[Write::Push(0), Write::Push(1)], &[Write::Report, Write::End]],
        [(1, Change::None), (2, Change::None), (1, Change::Move)],
    );
}

#[test]
fn readers_that_clone_themselves_or_leave_keep_none_of_the_others_waiting_in_every_order() {
    explore(
        [&[Write::Push(0), Write::Push(1)], &[Write::Report, Write::End]],
        [(1, Change::Renew(0)), (2, Change::Clone(0)), (1, Change::Leave(1))],
    );
}
