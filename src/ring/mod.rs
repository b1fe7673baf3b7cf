//! Keep-last ring between the driver, which fills it and never waits, and streams, which
//! read at their own position and depth.

mod cursor;
#[cfg(test)]
mod interleavings;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Waker;

pub(crate) use self::cursor::Cursor;
use crate::{Error, Scan};

/// Number of wakers taken under one lock. More waiting readers take further locks.
const WAKERS: usize = 4;

/// Newest scans of a schedule, and its latest error.
///
/// Errors are kept beside the scans, so that no scan overwrites them.
#[derive(Debug)]
pub(crate) struct Ring {
    inner: Mutex<Inner>,
}

#[derive(Debug)]
struct Inner {
    scans: VecDeque<Scan>,
    /// Depth of the deepest reader.
    depth: usize,
    /// Number of scans so far, which is the number of the next one.
    next: u64,
    error: Option<Error>,
    /// Number of the scan after the error.
    error_at: u64,
    /// Number of errors so far, which is the number of the one in `error`.
    errors: u64,
    /// Set once the driver has ended: no more scans follow.
    ended: bool,
    readers: Vec<Reader>,
    missed: u64,
}

/// Entry for a reader.
#[derive(Debug)]
struct Reader {
    depth: usize,
    state: ReaderState,
}

#[derive(Debug)]
enum ReaderState {
    /// Free entry, whose reader was dropped.
    Gone,
    Busy,
    Waiting(Waker),
}

/// Result of adding a scan to a ring.
#[derive(Debug)]
pub(crate) struct Pushed {
    /// The scan that it displaced, if the ring was full.
    pub(crate) displaced: Option<Scan>,
    /// True if the scan has the same values as the previous one.
    pub(crate) repeats: bool,
    /// Number of scans that readers have missed so far.
    pub(crate) missed: u64,
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

    /// Adds a scan, and marks it if it repeats the one before it.
    pub(crate) fn push(&self, scan: Scan) -> Pushed {
        self.change(|inner| inner.push(scan))
    }

    /// Newest scan.
    pub(crate) fn latest(&self) -> Option<Scan> {
        self.lock().scans.back().cloned()
    }

    /// Replaces the latest error. Each reader gets it after the present scans and before
    /// the next one.
    pub(crate) fn report(&self, error: Error) {
        self.change(|inner| inner.report(error));
    }

    /// Ends the ring: readers get the remaining scans, `cause`, and then the end.
    pub(crate) fn end(&self, cause: Option<Error>) {
        self.change(|inner| inner.end(cause));
    }

    /// Number of readers.
    pub(crate) fn readers(&self) -> usize {
        let inner = self.lock();
        inner.readers.iter().filter(|reader| !matches!(reader.state, ReaderState::Gone)).count()
    }

    /// Number of scans that readers missed.
    pub(crate) fn missed(&self) -> u64 {
        self.lock().missed
    }

    /// Changes the ring, and wakes all readers after releasing the lock: a waker may run any
    /// code.
    fn change<T>(&self, change: impl FnOnce(&mut Inner) -> T) -> T {
        let (mut inner, mut entry) = (self.lock(), 0);
        let outcome = change(&mut inner);
        loop {
            let wakers = inner.take_wakers(&mut entry);
            let is_last = entry == inner.readers.len();
            drop(inner);
            wakers.into_iter().flatten().for_each(Waker::wake);
            if is_last {
                return outcome;
            }
            inner = self.lock();
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        #[cfg(test)]
        interleavings::count_lock();
        // No code that may panic runs between two changes, so the data is consistent.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    fn push(&mut self, mut scan: Scan) -> Pushed {
        let repeats = self.scans.back().is_some_and(|latest| scan.note_repeat_of(latest));
        let mut displaced = None;
        while self.scans.len() >= self.depth {
            displaced = self.scans.pop_front();
        }
        self.scans.push_back(scan);
        self.next += 1;
        Pushed { displaced, repeats, missed: self.missed }
    }

    /// Takes the wakers of up to [`WAKERS`] waiting readers from `entry` on, and advances
    /// `entry` past those readers.
    fn take_wakers(&mut self, entry: &mut usize) -> [Option<Waker>; WAKERS] {
        let mut wakers = [const { None }; WAKERS];
        let mut room = wakers.iter_mut();
        for reader in self.readers.iter_mut().skip(*entry) {
            if matches!(reader.state, ReaderState::Waiting(_)) {
                let Some(place) = room.next() else { break };
                if let ReaderState::Waiting(waker) =
                    std::mem::replace(&mut reader.state, ReaderState::Busy)
                {
                    *place = Some(waker);
                }
            }
            *entry += 1;
        }
        wakers
    }

    fn report(&mut self, error: Error) {
        self.error = Some(error);
        self.error_at = self.next;
        self.errors += 1;
    }

    /// Does nothing if the ring had ended before.
    fn end(&mut self, cause: Option<Error>) {
        // Together with its cause: a reader on another thread must not see the end alone.
        let has_ended = std::mem::replace(&mut self.ended, true);
        if let Some(cause) = cause.filter(|_| !has_ended) {
            self.report(cause);
        }
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

    /// Frees an entry, and the scans that only its reader wanted. Returns values to drop
    /// after releasing the lock.
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
