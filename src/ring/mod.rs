//! Keep-last ring between the driver, which fills it and never waits, and streams, which
//! read at their own position and depth.

#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::mem;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Waker, ready};

use tokio::task::coop;
use tokio::time::Instant;

use crate::{Error, Scan};

/// Newest scans of a schedule, and its latest error.
///
/// Errors are kept beside the scans, so that no scan overwrites them.
///
/// One lock protects everything. A reader that finds nothing leaves its waker before it releases the
/// lock, so it misses no change.
#[derive(Debug)]
pub(crate) struct Ring(Mutex<Inner>);

#[derive(Debug, Default)]
struct Inner {
    scans: VecDeque<Scan>,
    /// Number of scans so far, which is the number of the next one.
    next: u64,
    error: Option<Error>,
    /// Number of the scan after the error.
    error_at: u64,
    /// Number of errors so far, which is the number of the one in `error`.
    errors: u64,
    /// Set once the driver has ended: no more scans follow.
    ended: bool,
    /// Readers by their slot. A free slot has depth 0.
    readers: Vec<Reader>,
    /// Depth of the deepest reader, at least 1.
    depth: usize,
    missed: u64,
}

#[derive(Debug, Default)]
struct Reader {
    depth: usize,
    /// Wakes the task that waits for a change.
    waker: Option<Waker>,
}

impl Ring {
    pub(crate) fn new() -> Arc<Self> {
        // Room for the depth of most readers.
        let inner = Inner { scans: VecDeque::with_capacity(1), depth: 1, ..Inner::default() };
        Arc::new(Self(Mutex::new(inner)))
    }

    /// Subscribes a reader to the scans from now on. It can fall `depth` scans behind before it
    /// misses one. If no scan has arrived since the latest error, it begins with that error.
    pub(crate) fn subscribe(self: &Arc<Self>, depth: usize) -> Cursor {
        let depth = depth.max(1);
        let inner = self.lock();
        let is_news = inner.error.is_some() && inner.error_at == inner.next;
        let errors = inner.errors - u64::from(is_news);
        let place = Place { depth, next: inner.next, errors, missed: 0, finished: false };
        Cursor::enter(self, inner, place)
    }

    /// Adds a scan, and numbers it. Marks it, and returns true, if its values equal the values of
    /// the one before it. Also returns the number of scans that readers have missed.
    pub(crate) fn push(&self, scan: Scan) -> (bool, u64) {
        self.change(|inner| (inner.push(scan), inner.missed))
    }

    /// Replaces the latest error. Each reader gets it after the present scans and before the next one.
    pub(crate) fn report(&self, error: Error) {
        self.change(|inner| inner.report(error));
    }

    /// Ends the ring: readers get the remaining scans, `cause`, and then the end.
    pub(crate) fn end(&self, cause: Option<Error>) {
        self.change(|inner| inner.end(cause));
    }

    pub(crate) fn readers(&self) -> usize {
        self.lock().readers.iter().filter(|reader| reader.depth > 0).count()
    }

    /// Number of scans that readers missed.
    pub(crate) fn missed(&self) -> u64 {
        self.lock().missed
    }

    fn change<T>(&self, change: impl FnOnce(&mut Inner) -> T) -> T {
        let mut inner = self.lock();
        let outcome = change(&mut inner);
        for slot in 0..inner.readers.len() {
            if let Some(waker) = inner.readers.get_mut(slot).and_then(|reader| reader.waker.take())
            {
                // Not under the lock: a task that ends now may drop a reader, which takes it.
                drop(inner);
                waker.wake();
                inner = self.lock();
            }
        }
        outcome
    }

    // Several times a scan: one copy of its code.
    #[inline(never)]
    fn lock(&self) -> MutexGuard<'_, Inner> {
        #[cfg(test)]
        tests::count_lock();
        // No code that may panic runs between two changes, so the data is consistent.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    fn push(&mut self, mut scan: Scan) -> bool {
        let repeats = self.scans.back().is_some_and(|latest| scan.is_same_as(latest));
        scan.meta.repeat = repeats;
        scan.meta.sequence = self.next;
        while self.scans.len() >= self.depth {
            self.scans.pop_front();
        }
        self.scans.push_back(scan);
        self.next += 1;
        repeats
    }

    fn report(&mut self, error: Error) {
        self.error = Some(error);
        self.error_at = self.next;
        self.errors += 1;
    }

    /// Does nothing if the ring had ended before.
    fn end(&mut self, cause: Option<Error>) {
        // Together with its cause: a reader on another thread must not see the end alone.
        let has_ended = mem::replace(&mut self.ended, true);
        if let Some(cause) = cause.filter(|_| !has_ended) {
            self.report(cause);
        }
    }

    /// Puts a reader into this slot and returns the former one. Drops scans that no reader reaches.
    fn replace(&mut self, slot: usize, reader: Reader) -> Option<Reader> {
        let before = self.readers.get_mut(slot).map(|slot| mem::replace(slot, reader));
        self.depth = self.readers.iter().map(|reader| reader.depth).fold(1, usize::max);
        let surplus = self.scans.len().saturating_sub(self.depth);
        self.scans.drain(..surplus);
        before
    }
}

/// Reader of a ring.
#[derive(Debug)]
pub(crate) struct Cursor {
    ring: Arc<Ring>,
    slot: usize,
    place: Place,
}

/// Position of a reader in the sequence of scans.
#[derive(Debug, Clone, Copy)]
struct Place {
    depth: usize,
    next: u64,
    errors: u64,
    missed: u64,
    finished: bool,
}

impl Cursor {
    /// Registers a reader at this place.
    fn enter(ring: &Arc<Ring>, mut inner: MutexGuard<'_, Inner>, place: Place) -> Self {
        let readers = &mut inner.readers;
        let slot = readers.iter().position(|reader| reader.depth == 0).unwrap_or(readers.len());
        readers.resize_with(readers.len().max(slot + 1), Reader::default);
        inner.replace(slot, Reader { depth: place.depth, waker: None });
        Self { ring: Arc::clone(ring), slot, place }
    }

    /// Returns the next error or scan, or `None` after the end. Takes part in tokio's
    /// cooperative scheduling: a task that always finds a scan yields now and then.
    pub(crate) fn poll_next(&mut self, cx: &mut Context<'_>) -> Poll<Option<Result<Scan, Error>>> {
        if self.place.finished {
            return Poll::Ready(None);
        }
        let coop = ready!(coop::poll_proceed(cx));
        let mut inner = self.ring.lock();
        let item = self.place.take(&mut inner);
        if item.is_ready() {
            coop.made_progress();
        } else if let Some(reader) = inner.readers.get_mut(self.slot) {
            let before = reader.waker.replace(cx.waker().clone());
            drop(inner);
            // Not under the lock, as in `change`.
            drop(before);
        }
        item
    }

    /// Newest scan, read or not.
    pub(crate) fn latest(&self) -> Option<Scan> {
        self.ring.lock().scans.back().cloned()
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
        Self::enter(&self.ring, self.ring.lock(), self.place)
    }
}

impl Drop for Cursor {
    fn drop(&mut self) {
        // The waker is dropped without the lock, as in `change`.
        let _reader = self.ring.lock().replace(self.slot, Reader::default());
    }
}
