//! The keep-last ring between the driver, which fills it and never waits, and
//! streams, each of which reads from a place of its own.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Waker};

use crate::state::Audience;
use crate::{Error, Scan};

/// The newest scans of a schedule, and its latest error.
///
/// Errors are kept beside the scans, where none can push them out.
#[derive(Debug)]
pub(crate) struct Ring {
    inner: Mutex<Inner>,
}

#[derive(Debug)]
struct Inner {
    scans: VecDeque<Scan>,
    depth: usize,
    /// How many scans there ever were: the number of the next one.
    next: u64,
    error: Option<Error>,
    /// The number of the scan that comes after it.
    error_at: u64,
    /// How many errors there ever were: the number of the one in `error`.
    errors: u64,
    /// Set once the driver has ended: nothing more comes.
    ended: bool,
    readers: Vec<Reader>,
    missed: u64,
}

#[derive(Debug)]
enum Reader {
    /// A place that a reader has left.
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
    /// A ring that keeps the last `depth` scans.
    pub(crate) fn new(depth: usize) -> Arc<Self> {
        let depth = depth.max(1);
        let inner = Inner {
            scans: VecDeque::new(),
            depth,
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

    /// Adds a scan, in place of the oldest where the ring is full.
    pub(crate) fn push(&self, scan: Scan) {
        let mut inner = self.lock();
        if inner.scans.len() == inner.depth {
            inner.scans.pop_front();
        }
        inner.scans.push_back(scan);
        inner.next += 1;
        drop(inner);
        self.wake();
    }

    /// Puts an error in the place of the one before: each reader gets it behind
    /// the scans that are there and before the next one.
    pub(crate) fn report(&self, error: Error) {
        let mut inner = self.lock();
        inner.error(error);
        drop(inner);
        self.wake();
    }

    /// Nothing more comes: readers get what is left, `cause`, and then the end.
    pub(crate) fn end(&self, cause: Option<Error>) {
        let mut inner = self.lock();
        if inner.ended {
            return;
        }
        // With its cause: a reader on another thread must not see the end alone.
        inner.ended = true;
        if let Some(cause) = cause {
            inner.error(cause);
        }
        drop(inner);
        self.wake();
    }

    /// How many readers there are.
    pub(crate) fn readers(&self) -> usize {
        self.lock().readers.iter().filter(|reader| !matches!(reader, Reader::Gone)).count()
    }

    /// How many scans readers did not get to see.
    pub(crate) fn missed(&self) -> u64 {
        self.lock().missed
    }

    /// A reader that gets what comes from now on, and before that, if it is to
    /// be `told`, the latest error.
    pub(crate) fn reader(self: &Arc<Self>, told: bool) -> Cursor {
        let mut inner = self.lock();
        let (next, errors) = (inner.next, inner.errors.saturating_sub(told.into()));
        let place = inner.enter();
        drop(inner);
        Cursor { ring: Arc::clone(self), place, next, errors, missed: 0, finished: false }
    }

    /// Wakes all readers, with the lock released: a waker may run anything.
    fn wake(&self) {
        for place in 0.. {
            let mut inner = self.lock();
            let Some(reader) = inner.readers.get_mut(place) else { return };
            if let Reader::Waiting(_) = reader {
                let reader = std::mem::replace(reader, Reader::Busy);
                drop(inner);
                if let Reader::Waiting(waker) = reader {
                    waker.wake();
                }
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // Nothing can be half done in there: no code that may panic runs
        // between two changes.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    fn error(&mut self, error: Error) {
        self.error = Some(error);
        self.error_at = self.next;
        self.errors += 1;
    }

    fn enter(&mut self) -> usize {
        let free = self.readers.iter().position(|reader| matches!(reader, Reader::Gone));
        match free.and_then(|place| Some((place, self.readers.get_mut(place)?))) {
            Some((place, reader)) => {
                *reader = Reader::Busy;
                place
            }
            None => {
                self.readers.push(Reader::Busy);
                self.readers.len() - 1
            }
        }
    }
}

/// A reader's place in a ring.
#[derive(Debug)]
pub(crate) struct Cursor {
    ring: Arc<Ring>,
    place: usize,
    next: u64,
    errors: u64,
    missed: u64,
    finished: bool,
}

impl Cursor {
    /// The next error or scan, or `None` after the end.
    pub(crate) fn poll_next(&mut self, cx: &mut Context<'_>) -> Poll<Option<Result<Scan, Error>>> {
        if self.finished {
            return Poll::Ready(None);
        }
        let mut inner = self.ring.lock();
        let oldest = inner.next - inner.scans.len() as u64;
        // In its place: a scan from before a link was lost, after the loss, would
        // look as if the link were back.
        if inner.errors != self.errors && self.next.max(oldest) >= inner.error_at {
            self.errors = inner.errors;
            if let Some(error) = inner.error.clone() {
                return Poll::Ready(Some(Err(error)));
            }
        }
        if self.next < oldest {
            self.missed += oldest - self.next;
            inner.missed += oldest - self.next;
            self.next = oldest;
        }
        if let Some(scan) = inner.scans.get((self.next - oldest) as usize) {
            self.next += 1;
            return Poll::Ready(Some(Ok(scan.clone())));
        }
        if inner.ended {
            self.finished = true;
            return Poll::Ready(None);
        }
        let before = match inner.readers.get_mut(self.place) {
            Some(Reader::Waiting(waker)) if waker.will_wake(cx.waker()) => None,
            Some(reader) => Some(std::mem::replace(reader, Reader::Waiting(cx.waker().clone()))),
            None => None,
        };
        // With the lock released, as a waker that is dropped may run anything.
        drop(inner);
        drop(before);
        Poll::Pending
    }

    /// True once the end was reported.
    pub(crate) fn is_finished(&self) -> bool {
        self.finished
    }

    /// How many scans this reader did not get to see.
    pub(crate) fn missed(&self) -> u64 {
        self.missed
    }
}

impl Clone for Cursor {
    fn clone(&self) -> Self {
        let place = self.ring.lock().enter();
        Self { ring: Arc::clone(&self.ring), place, ..*self }
    }
}

impl Drop for Cursor {
    fn drop(&mut self) {
        let mut inner = self.ring.lock();
        let place = inner.readers.get_mut(self.place);
        let before = place.map(|reader| std::mem::replace(reader, Reader::Gone));
        // With the lock released, as a waker that is dropped may run anything.
        drop(inner);
        drop(before);
    }
}

#[cfg(test)]
mod tests {
    use futures::FutureExt;
    use std::future::poll_fn;
    use tokio::time::Instant;

    use super::*;
    use crate::Window;
    use crate::scan::ScanMeta;

    fn scan(sequence: u64) -> Scan {
        let now = Instant::now();
        let meta = ScanMeta {
            sequence,
            requested_at: now,
            received_at: now,
            stamp: std::time::SystemTime::now(),
            repeat: false,
            scan_time: std::time::Duration::from_millis(100),
            reconnects: 0,
        };
        Scan::new(Window::single(384), Arc::new([1000]), 0, meta)
    }

    /// What the reader gets without waiting.
    fn take(cursor: &mut Cursor) -> Option<Option<Result<u64, String>>> {
        let item = poll_fn(|cx| cursor.poll_next(cx)).now_or_never()?;
        Some(item.map(|item| item.map(|scan| scan.sequence()).map_err(|error| error.to_string())))
    }

    #[test]
    fn a_slow_reader_gets_the_newest_and_knows_what_it_missed() {
        let ring = Ring::new(2);
        let mut reader = ring.reader(false);
        (0..5).for_each(|sequence| ring.push(scan(sequence)));
        assert_eq!(take(&mut reader), Some(Some(Ok(3))));
        assert_eq!(take(&mut reader), Some(Some(Ok(4))));
        assert_eq!(take(&mut reader), None);
        assert_eq!((reader.missed(), ring.missed()), (3, 3));
    }

    #[test]
    fn an_error_comes_before_the_next_scan_and_is_pushed_out_by_none() {
        let ring = Ring::new(1);
        let mut reader = ring.reader(false);
        ring.report(Error::LaserOff);
        (0..5).for_each(|sequence| ring.push(scan(sequence)));
        assert_eq!(take(&mut reader), Some(Some(Err(Error::LaserOff.to_string()))));
        assert_eq!(take(&mut reader), Some(Some(Ok(4))));
        assert_eq!(take(&mut reader), None);
    }

    #[test]
    fn an_error_comes_behind_the_scans_from_before_it() {
        let ring = Ring::new(2);
        let (mut reader, mut slow) = (ring.reader(false), ring.reader(false));
        (0..3).for_each(|sequence| ring.push(scan(sequence)));
        ring.report(Error::LaserOff);
        assert_eq!(take(&mut reader), Some(Some(Ok(1))));
        assert_eq!(take(&mut reader), Some(Some(Ok(2))));
        assert_eq!(take(&mut reader), Some(Some(Err(Error::LaserOff.to_string()))));
        assert_eq!(take(&mut reader), None);
        ring.push(scan(3));
        assert_eq!(take(&mut reader), Some(Some(Ok(3))));
        // Of the two scans that are kept one is from before the error.
        assert_eq!(take(&mut slow), Some(Some(Ok(2))));
        assert_eq!(take(&mut slow), Some(Some(Err(Error::LaserOff.to_string()))));
        assert_eq!(take(&mut slow), Some(Some(Ok(3))));
        assert_eq!((take(&mut slow), slow.missed()), (None, 2));
    }

    #[test]
    fn the_end_comes_after_what_is_left_and_its_cause() {
        let ring = Ring::new(1);
        let (mut reader, mut other) = (ring.reader(false), ring.reader(false));
        ring.push(scan(0));
        ring.end(Some(Error::Loopback));
        ring.end(Some(Error::Closed));
        for reader in [&mut reader, &mut other] {
            assert_eq!(take(reader), Some(Some(Ok(0))));
            assert_eq!(take(reader), Some(Some(Err(Error::Loopback.to_string()))));
            assert!(!reader.is_finished());
            assert_eq!(take(reader), Some(None));
            assert_eq!(take(reader), Some(None));
            assert!(reader.is_finished());
        }
    }

    #[test]
    fn a_reader_that_comes_while_there_is_trouble_is_told_of_it() {
        let ring = Ring::new(1);
        assert_eq!(take(&mut ring.reader(true)), None, "there was no error");
        ring.report(Error::Loopback);
        let (mut told, mut other) = (ring.reader(true), ring.reader(false));
        assert_eq!(take(&mut told), Some(Some(Err(Error::Loopback.to_string()))));
        assert_eq!((take(&mut told), take(&mut other)), (None, None));
    }

    #[test]
    fn no_reader_ever_sees_the_end_without_its_cause() {
        for _ in 0..1000 {
            let ring = Ring::new(1);
            let mut reader = ring.reader(false);
            let ending = std::thread::spawn(move || ring.end(Some(Error::Loopback)));
            let mut items = std::iter::repeat_with(|| take(&mut reader)).flatten();
            assert_eq!(items.next(), Some(Some(Err(Error::Loopback.to_string()))));
            assert_eq!(items.next(), Some(None));
            assert!(ending.join().is_ok());
        }
    }

    #[test]
    fn a_clone_goes_on_from_the_same_place_and_a_new_reader_from_now() {
        let ring = Ring::new(8);
        let mut reader = ring.reader(false);
        ring.push(scan(0));
        ring.push(scan(1));
        assert_eq!(take(&mut reader), Some(Some(Ok(0))));
        let (mut clone, mut late) = (reader.clone(), ring.reader(false));
        assert_eq!(take(&mut late), None);
        for reader in [&mut reader, &mut clone] {
            assert_eq!(take(reader), Some(Some(Ok(1))));
        }
        assert_eq!(ring.readers(), 3);
        drop((reader, late));
        assert_eq!(ring.readers(), 1);
    }

    #[tokio::test]
    async fn every_waiting_reader_is_woken() {
        let ring = Ring::new(1);
        let readers: Vec<_> = (0..3).map(|_| ring.reader(false)).collect();
        let waiting = readers.into_iter().map(|mut reader| {
            tokio::spawn(async move { poll_fn(|cx| reader.poll_next(cx)).await })
        });
        let waiting: Vec<_> = waiting.collect();
        tokio::task::yield_now().await;
        ring.push(scan(7));
        for task in waiting {
            let scan = task.await.ok().flatten().and_then(Result::ok);
            assert_eq!(scan.map(|scan| scan.sequence()), Some(7));
        }
    }
}
