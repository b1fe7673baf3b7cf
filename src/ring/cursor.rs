//! [`Cursor`]: a reader of a ring, at a place and to a depth of its own.

use std::sync::Arc;
use std::task::{Context, Poll, ready};

use tokio::task::coop;
use tokio::time::Instant;

use super::{Inner, ReaderState, Ring};
use crate::{Error, Scan};

impl Ring {
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
}

/// Reader of a ring.
#[derive(Debug)]
pub(crate) struct Cursor {
    ring: Arc<Ring>,
    pub(super) place: Place,
}

/// Position of a reader in the sequence of scans.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
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

    /// Takes the next error or scan without waiting. Returns `None` if nothing is ready,
    /// and after the end.
    pub(crate) fn next_if_ready(&mut self) -> Option<Result<Scan, Error>> {
        match self.place.take(&mut self.ring.lock()) {
            Poll::Ready(item) => item,
            Poll::Pending => None,
        }
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
