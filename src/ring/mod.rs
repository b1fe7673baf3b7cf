//! Keep-last ring between the driver, which fills it and never waits, and streams, which
//! read at their own position and depth.

#[cfg(test)]
mod interleavings;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Waker, ready};

use tokio::task::coop;
use tokio::time::Instant;

use crate::{Error, Scan};

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

    /// Subscribes a reader to the scans from now on. It can fall `depth` scans behind
    /// before it misses one. If no scan has arrived since the latest error, it begins
    /// with that error.
    pub(crate) fn subscribe(self: &Arc<Self>, depth: usize) -> Cursor {
        let depth = depth.max(1);
        let mut inner = self.lock();
        let is_news = inner.error.is_some() && inner.error_at == inner.next;
        let place = Place {
            entry: inner.enter(depth),
            depth,
            next: inner.next,
            errors: inner.errors - u64::from(is_news),
            missed: 0,
            finished: false,
        };
        drop(inner);
        Cursor { ring: Arc::clone(self), place }
    }

    /// Adds a scan, and numbers it. Marks it, and returns true, if its values equal the values of
    /// the one before it. Also returns the number of scans that readers have missed.
    pub(crate) fn push(&self, scan: Scan) -> (bool, u64) {
        self.change(|inner| (inner.push(scan), inner.missed))
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
        while let Some(waker) = inner.take_waker(&mut entry) {
            drop(inner);
            waker.wake();
            inner = self.lock();
        }
        outcome
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        #[cfg(test)]
        interleavings::count_lock();
        // No code that may panic runs between two changes, so the data is consistent.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    fn push(&mut self, mut scan: Scan) -> bool {
        let repeats = self.scans.back().is_some_and(|latest| scan.values() == latest.values());
        scan.meta.repeat = repeats;
        scan.meta.sequence = self.next;
        while self.scans.len() >= self.depth {
            self.scans.pop_front();
        }
        self.scans.push_back(scan);
        self.next += 1;
        repeats
    }

    /// Takes the waker of the first waiting reader from `entry` on, and advances `entry` past that
    /// reader.
    fn take_waker(&mut self, entry: &mut usize) -> Option<Waker> {
        while let Some(reader) = self.readers.get_mut(*entry) {
            *entry += 1;
            if matches!(reader.state, ReaderState::Waiting(_)) {
                match std::mem::replace(&mut reader.state, ReaderState::Busy) {
                    ReaderState::Waiting(waker) => return Some(waker),
                    ReaderState::Gone | ReaderState::Busy => {}
                }
            }
        }
        None
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

/// Reader of a ring.
#[derive(Debug)]
pub(crate) struct Cursor {
    ring: Arc<Ring>,
    place: Place,
}

/// Position of a reader in the sequence of scans.
#[derive(Debug, Clone, Copy)]
struct Place {
    /// Its entry in `Inner::readers`.
    entry: usize,
    depth: usize,
    next: u64,
    errors: u64,
    missed: u64,
    finished: bool,
}

impl Cursor {
    /// Returns the next error or scan, or `None` after the end. Takes part in tokio's
    /// cooperative scheduling: a task that always finds a scan yields now and then.
    pub(crate) fn poll_next(&mut self, cx: &mut Context<'_>) -> Poll<Option<Result<Scan, Error>>> {
        if self.place.finished {
            return Poll::Ready(None);
        }
        let coop = ready!(coop::poll_proceed(cx));
        let mut inner = self.ring.lock();
        if let Poll::Ready(item) = self.place.take(&mut inner) {
            coop.made_progress();
            return Poll::Ready(item);
        }
        let before = match inner.readers.get_mut(self.place.entry).map(|reader| &mut reader.state) {
            Some(ReaderState::Waiting(waker)) if waker.will_wake(cx.waker()) => None,
            Some(state) => Some(std::mem::replace(state, ReaderState::Waiting(cx.waker().clone()))),
            None => None,
        };
        // After releasing the lock, because dropping a waker may run any code.
        drop(inner);
        drop(before);
        Poll::Pending
    }

    /// Newest scan, read or not.
    pub(crate) fn latest(&self) -> Option<Scan> {
        self.ring.latest()
    }

    /// When the newest scan was received, and the latest error since.
    pub(crate) fn freshness(&self) -> (Option<Instant>, Option<Error>) {
        let inner = self.ring.lock();
        let error = inner.error.as_ref().filter(|_| inner.error_at == inner.next);
        (inner.scans.back().map(Scan::received_at), error.cloned())
    }

    /// Creates a reader of the same depth that starts now.
    pub(crate) fn resubscribe(&self) -> Self {
        self.ring.subscribe(self.place.depth)
    }

    /// Returns true once the end has been read.
    pub(crate) fn is_finished(&self) -> bool {
        self.place.finished
    }

    /// Number of scans that this reader missed.
    pub(crate) fn missed(&self) -> u64 {
        self.place.missed
    }
}

impl Place {
    /// Takes the next error, scan or end, if one is ready.
    fn take(&mut self, inner: &mut Inner) -> Poll<Option<Result<Scan, Error>>> {
        if self.finished {
            return Poll::Ready(None);
        }
        let kept = inner.scans.len();
        let oldest = inner.next - kept.min(self.depth) as u64;
        // Errors keep their place: a scan from before a lost link, delivered after the
        // error, would look as if the link were back.
        if inner.errors != self.errors && self.next.max(oldest) >= inner.error_at {
            self.errors = inner.errors;
            if let Some(error) = inner.error.clone() {
                return Poll::Ready(Some(Err(error)));
            }
        }
        let missed = oldest.saturating_sub(self.next);
        self.missed += missed;
        inner.missed += missed;
        self.next += missed;
        // Distance from the next scan to the oldest one in the ring.
        let behind = self.next + kept as u64 - inner.next;
        if let Some(scan) = inner.scans.get(behind as usize) {
            self.next += 1;
            return Poll::Ready(Some(Ok(scan.clone())));
        }
        if inner.ended {
            self.finished = true;
            return Poll::Ready(None);
        }
        Poll::Pending
    }
}

impl Clone for Cursor {
    fn clone(&self) -> Self {
        let entry = self.ring.lock().enter(self.place.depth);
        Self { ring: Arc::clone(&self.ring), place: Place { entry, ..self.place } }
    }
}

impl Drop for Cursor {
    fn drop(&mut self) {
        let before = self.ring.lock().leave(self.place.entry);
        // After releasing the lock, because dropping a waker may run any code.
        drop(before);
    }
}
