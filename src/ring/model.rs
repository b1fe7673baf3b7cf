//! A ring under every interleaving of its threads, within a bound, which loom makes one
//! after the other. Built only with `--cfg ring_model`; tests/README.md has the command.

use std::future::{Future, poll_fn};
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll, Waker};

use loom::future::block_on;
use loom::model::Builder;
use loom::thread;

use super::tests::scan;
use super::{Cursor, Ring};
use crate::{Error, Scan};

/// Runs `model` in every interleaving with at most so many switches away from a thread
/// that could go on, and prints their number. `LOOM_MAX_PREEMPTIONS` sets another bound.
fn explore(preemptions: usize, model: impl Fn() + Send + Sync + 'static) {
    let runs = Arc::new(AtomicU64::new(0));
    let mut builder = Builder::new();
    builder.preemption_bound = builder.preemption_bound.or(Some(preemptions));
    builder.check({
        let runs = Arc::clone(&runs);
        move || {
            runs.fetch_add(1, Ordering::Relaxed);
            model();
        }
    });
    println!("{} interleavings", runs.load(Ordering::Relaxed));
}

fn cause() -> Error {
    Error::Loopback { sensor: None }
}

/// The items that a reader returned before the end.
#[derive(Debug, Default)]
struct Seen {
    scans: Vec<u64>,
    errors: Vec<String>,
}

impl Seen {
    /// Reads to the end. If a wake-up is lost it never comes, and loom reports a deadlock.
    fn all_of(mut reader: Cursor) -> Self {
        let mut seen = Self::default();
        while !seen.add(block_on(poll_fn(|cx| reader.poll_next(cx)))) {}
        seen
    }

    /// The same for a reader that another task has polled before: its latest waker is the
    /// one that counts.
    fn all_of_moved(mut reader: Cursor) -> Self {
        let mut seen = Self::default();
        let first = pin!(poll_fn(|cx| reader.poll_next(cx)));
        if let Poll::Ready(item) = first.poll(&mut Context::from_waker(Waker::noop()))
            && seen.add(item)
        {
            return seen;
        }
        let Self { scans, errors } = Self::all_of(reader);
        seen.scans.extend(scans);
        seen.errors.extend(errors);
        seen
    }

    /// Adds an item, and returns whether it is the end.
    fn add(&mut self, item: Option<Result<Scan, Error>>) -> bool {
        match item {
            Some(Ok(scan)) => self.scans.push(scan.sequence()),
            Some(Err(error)) => self.errors.push(error.to_string()),
            None => return true,
        }
        false
    }

    /// Checks that each scan came once and in order, and the cause of the end once.
    fn check(&self) {
        assert!(self.scans.is_sorted_by(|one, next| one < next), "{self:?}");
        assert_eq!(self.errors, [cause().to_string()], "{self:?}");
    }
}

fn read(reader: Cursor) -> thread::JoinHandle<Seen> {
    thread::spawn(move || Seen::all_of(reader))
}

#[test]
fn a_reader_gets_every_scan_and_the_cause_whatever_the_driver_does_meanwhile() {
    explore(3, || {
        let ring = Ring::new();
        let reader = ring.subscribe(2);
        let reader = thread::spawn(move || Seen::all_of_moved(reader));
        ring.push(scan(0));
        ring.push(scan(1));
        ring.end(Some(cause()));
        let seen = reader.join().unwrap();
        seen.check();
        assert_eq!(seen.scans, [0, 1]);
        assert_eq!(ring.readers(), 0);
    });
}

/// Nothing else wakes them: the ring does not end.
#[test]
fn a_scan_or_an_error_alone_wakes_each_reader() {
    for is_scan in [true, false] {
        explore(2, move || {
            let ring = Ring::new();
            let readers = [1, 2].map(|depth| {
                let mut reader = ring.subscribe(depth);
                thread::spawn(move || block_on(poll_fn(|cx| reader.poll_next(cx))).is_some())
            });
            if is_scan {
                ring.push(scan(0));
            } else {
                ring.report(cause());
            }
            for reader in readers {
                assert!(reader.join().unwrap());
            }
        });
    }
}

#[test]
fn three_readers_all_come_to_the_end() {
    explore(1, || {
        let ring = Ring::new();
        let [first, second, third] = [1, 2, 1].map(|depth| ring.subscribe(depth));
        let (first, second, third) = (read(first), read(second), read(third));
        ring.push(scan(0));
        ring.end(Some(cause()));
        for seen in [first, second, third] {
            seen.join().unwrap().check();
        }
        assert_eq!(ring.readers(), 0);
    });
}

/// The driver is the only writer; the ring does not rely on that.
#[test]
fn two_readers_come_to_the_end_of_two_writers() {
    explore(2, || {
        let ring = Ring::new();
        let [first, second] = [1, 2].map(|depth| ring.subscribe(depth));
        let pushed = Arc::clone(&ring);
        let pushing = thread::spawn(move || pushed.push(scan(0)));
        let (first, second) = (read(first), read(second));
        ring.end(Some(cause()));
        for seen in [first, second] {
            seen.join().unwrap().check();
        }
        pushing.join().unwrap();
        assert_eq!(ring.readers(), 0);
    });
}

#[test]
fn three_readers_come_to_the_end_of_two_writers() {
    explore(1, || {
        let ring = Ring::new();
        let [first, second, third] = [1, 2, 1].map(|depth| ring.subscribe(depth));
        let pushed = Arc::clone(&ring);
        let pushing = thread::spawn(move || pushed.push(scan(0)));
        let (first, second, third) = (read(first), read(second), read(third));
        ring.end(Some(cause()));
        for seen in [first, second, third] {
            seen.join().unwrap().check();
        }
        pushing.join().unwrap();
        assert_eq!(ring.readers(), 0);
    });
}

/// The third reader leaves while the writers wake all.
#[test]
fn two_readers_come_to_the_end_of_two_writers_while_a_third_leaves() {
    explore(1, || {
        let ring = Ring::new();
        let [first, second, leaving] = [1, 2, 1].map(|depth| ring.subscribe(depth));
        let pushed = Arc::clone(&ring);
        let pushing = thread::spawn(move || pushed.push(scan(0)));
        let (first, second) = (read(first), read(second));
        let leaving = thread::spawn(move || drop(leaving));
        ring.end(Some(cause()));
        for seen in [first, second] {
            seen.join().unwrap().check();
        }
        leaving.join().unwrap();
        pushing.join().unwrap();
        assert_eq!(ring.readers(), 0);
    });
}

#[test]
fn readers_that_are_cloned_and_dropped_leave_none_waiting_and_none_counted() {
    explore(2, || {
        let ring = Ring::new();
        let (cloned, left) = (ring.subscribe(1), ring.subscribe(2));
        let cloning = thread::spawn(move || {
            // Its entry is free for another reader while the ring wakes all.
            let clone = cloned.clone();
            drop(cloned);
            Seen::all_of(clone)
        });
        let leaving = thread::spawn(move || {
            let next = left.resubscribe();
            drop(left);
            Seen::all_of(next)
        });
        ring.push(scan(0));
        // The driver ends a schedule without readers. Here there is always one.
        assert!(ring.readers() > 0);
        ring.end(Some(cause()));
        for seen in [cloning, leaving] {
            seen.join().unwrap().check();
        }
        assert_eq!(ring.readers(), 0);
    });
}
