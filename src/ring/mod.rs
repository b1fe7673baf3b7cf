//! The keep-last ring between the driver, which fills it and never waits, and
//! streams, each of which reads at a place and to a depth of its own.

mod cursor;
#[cfg(all(test, not(ring_model)))]
mod interleavings;
#[cfg(all(test, ring_model))]
mod model;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::sync::{Arc, PoisonError};
#[cfg(not(all(test, ring_model)))]
use std::sync::{Mutex, MutexGuard};
use std::task::Waker;

#[cfg(all(test, ring_model))]
use loom::sync::{Mutex, MutexGuard};

pub(crate) use self::cursor::Cursor;
use crate::state::Audience;
use crate::{Error, Scan};

/// The newest scans of a schedule, and its latest error.
///
/// Errors are kept beside the scans, so that no scan overwrites them.
#[derive(Debug)]
pub(crate) struct Ring {
    inner: Mutex<Inner>,
}

#[derive(Debug)]
struct Inner {
    scans: VecDeque<Scan>,
    /// The depth of the deepest reader.
    depth: usize,
    /// The number of scans so far, which is the number of the next one.
    next: u64,
    error: Option<Error>,
    /// The number of the scan that comes after it.
    error_at: u64,
    /// The number of errors so far, which is the number of the one in `error`.
    errors: u64,
    /// Set once the driver has ended: nothing more comes.
    ended: bool,
    readers: Vec<Reader>,
    missed: u64,
}

/// An entry for a reader.
#[derive(Debug)]
struct Reader {
    depth: usize,
    state: ReaderState,
}

#[derive(Debug)]
enum ReaderState {
    /// The reader was dropped; its entry can be used again.
    Gone,
    Busy,
    Waiting(Waker),
}

impl Audience for Ring {
    fn is_present(&self) -> bool {
        self.readers() > 0
    }
}

impl Ring {
    pub(crate) fn new() -> Arc<Self> {
        let inner = Inner {
            // Room for the depth of most readers.
            scans: VecDeque::with_capacity(1),
            depth: 1,
            next: 0,
            error: None,
            error_at: 0,
            errors: 0,
            ended: false,
            readers: Vec::new(),
            missed: 0,
        };
        Arc::new(Self { inner: Mutex::new(inner) })
    }

    /// Adds a scan, and returns the one that it displaces if the ring is full.
    pub(crate) fn push(&self, scan: Scan) -> Option<Scan> {
        let displaced = self.lock().push(scan);
        self.wake();
        displaced
    }

    /// Returns the newest scan.
    pub(crate) fn latest(&self) -> Option<Scan> {
        self.lock().scans.back().cloned()
    }

    /// Replaces the latest error: each reader gets it behind the scans that are there
    /// and before the next one.
    pub(crate) fn report(&self, error: Error) {
        self.lock().report(error);
        self.wake();
    }

    /// Ends the ring: readers get what is left, `cause`, and then the end.
    pub(crate) fn end(&self, cause: Option<Error>) {
        let is_first = self.lock().end(cause);
        if is_first {
            self.wake();
        }
    }

    /// Returns the number of readers.
    pub(crate) fn readers(&self) -> usize {
        let inner = self.lock();
        inner.readers.iter().filter(|reader| !matches!(reader.state, ReaderState::Gone)).count()
    }

    /// Returns the number of scans that readers missed.
    pub(crate) fn missed(&self) -> u64 {
        self.lock().missed
    }

    /// Wakes all readers, with the lock released: a waker may run anything.
    fn wake(&self) {
        let mut entry = 0;
        while let Some(waker) = self.take_waker(&mut entry) {
            waker.wake();
        }
    }

    /// Takes the waker of the first reader from `entry` on that waits, and sets `entry`
    /// to the one behind it.
    fn take_waker(&self, entry: &mut usize) -> Option<Waker> {
        let mut inner = self.lock();
        while let Some(reader) = inner.readers.get_mut(*entry) {
            *entry += 1;
            if matches!(reader.state, ReaderState::Waiting(_))
                && let ReaderState::Waiting(waker) =
                    std::mem::replace(&mut reader.state, ReaderState::Busy)
            {
                return Some(waker);
            }
        }
        None
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // No code that may panic runs between two changes, so nothing is half done.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    fn push(&mut self, scan: Scan) -> Option<Scan> {
        let mut displaced = None;
        while self.scans.len() >= self.depth {
            displaced = self.scans.pop_front();
        }
        self.scans.push_back(scan);
        self.next += 1;
        displaced
    }

    fn report(&mut self, error: Error) {
        self.error = Some(error);
        self.error_at = self.next;
        self.errors += 1;
    }

    /// Returns false if the ring has ended before.
    fn end(&mut self, cause: Option<Error>) -> bool {
        if self.ended {
            return false;
        }
        // With its cause: a reader on another thread must not see the end alone.
        self.ended = true;
        if let Some(cause) = cause {
            self.report(cause);
        }
        true
    }

    fn enter(&mut self, depth: usize) -> usize {
        self.depth = self.depth.max(depth);
        let reader = Reader { depth, state: ReaderState::Busy };
        let free = self.readers.iter().position(|one| matches!(one.state, ReaderState::Gone));
        match free.and_then(|entry| Some((entry, self.readers.get_mut(entry)?))) {
            Some((entry, place)) => {
                *place = reader;
                entry
            }
            None => {
                self.readers.push(reader);
                self.readers.len() - 1
            }
        }
    }

    /// Frees an entry, and the scans that only its reader wanted. Returns what has to be
    /// dropped with the lock released.
    fn leave(&mut self, entry: usize) -> Option<ReaderState> {
        let reader = self.readers.get_mut(entry)?;
        let state = std::mem::replace(&mut reader.state, ReaderState::Gone);
        let present = self.readers.iter().filter(|one| !matches!(one.state, ReaderState::Gone));
        self.depth = present.map(|one| one.depth).max().unwrap_or(1);
        let surplus = self.scans.len().saturating_sub(self.depth);
        self.scans.drain(..surplus);
        Some(state)
    }
}
