//! The keep-last ring between the driver, which fills it and never waits, and
//! streams, each of which reads at a place and to a depth of its own.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Waker, ready};

use tokio::task::coop;
use tokio::time::Instant;

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
            scans: VecDeque::new(),
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

    /// Adds a scan, and drops the oldest if the ring is full.
    pub(crate) fn push(&self, scan: Scan) {
        let mut inner = self.lock();
        while inner.scans.len() >= inner.depth {
            inner.scans.pop_front();
        }
        inner.scans.push_back(scan);
        inner.next += 1;
        drop(inner);
        self.wake();
    }

    /// Replaces the latest error: each reader gets it behind the scans that are there
    /// and before the next one.
    pub(crate) fn report(&self, error: Error) {
        let mut inner = self.lock();
        inner.error(error);
        drop(inner);
        self.wake();
    }

    /// Ends the ring: readers get what is left, `cause`, and then the end.
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

    /// Returns the number of readers.
    pub(crate) fn readers(&self) -> usize {
        let inner = self.lock();
        inner.readers.iter().filter(|reader| !matches!(reader.state, ReaderState::Gone)).count()
    }

    /// Returns the number of scans that readers missed.
    pub(crate) fn missed(&self) -> u64 {
        self.lock().missed
    }

    /// Returns a reader of what comes from now on, which can be `depth` scans behind
    /// before it misses one. If no scan has come since the latest error, it begins with
    /// that error.
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

    /// Wakes all readers, with the lock released: a waker may run anything.
    fn wake(&self) {
        for entry in 0.. {
            let mut inner = self.lock();
            let Some(reader) = inner.readers.get_mut(entry) else { return };
            if let ReaderState::Waiting(_) = reader.state {
                let state = std::mem::replace(&mut reader.state, ReaderState::Busy);
                drop(inner);
                if let ReaderState::Waiting(waker) = state {
                    waker.wake();
                }
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // No code that may panic runs between two changes, so nothing is half done.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    fn error(&mut self, error: Error) {
        self.error = Some(error);
        self.error_at = self.next;
        self.errors += 1;
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

/// A reader of a ring.
#[derive(Debug)]
pub(crate) struct Cursor {
    ring: Arc<Ring>,
    place: Place,
}

/// How far a reader has got.
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
        // With the lock released, as a waker that is dropped may run anything.
        drop(inner);
        drop(before);
        Poll::Pending
    }

    /// Returns the next error or scan if there is one, without waiting; `None` also
    /// after the end.
    pub(crate) fn next_if_ready(&mut self) -> Option<Result<Scan, Error>> {
        match self.place.take(&mut self.ring.lock()) {
            Poll::Ready(item) => item,
            Poll::Pending => None,
        }
    }

    /// Returns the newest scan, whether or not it was read.
    pub(crate) fn latest(&self) -> Option<Scan> {
        self.ring.lock().scans.back().cloned()
    }

    /// Returns the time of the newest scan, and the latest error since.
    pub(crate) fn freshness(&self) -> (Option<Instant>, Option<Error>) {
        let inner = self.ring.lock();
        let error = inner.error.as_ref().filter(|_| inner.error_at == inner.next);
        (inner.scans.back().map(Scan::received_at), error.cloned())
    }

    /// Returns another reader of the same depth, of what comes from now on.
    pub(crate) fn resubscribe(&self) -> Self {
        self.ring.subscribe(self.place.depth)
    }

    /// Returns true once the end was returned.
    pub(crate) fn is_finished(&self) -> bool {
        self.place.finished
    }

    /// Returns the number of scans that this reader missed.
    pub(crate) fn missed(&self) -> u64 {
        self.place.missed
    }
}

impl Place {
    /// Takes the next error, scan or end, if one is there.
    fn take(&mut self, inner: &mut Inner) -> Poll<Option<Result<Scan, Error>>> {
        if self.finished {
            return Poll::Ready(None);
        }
        let kept = inner.scans.len();
        let oldest = inner.next - kept.min(self.depth) as u64;
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
        // How far the next one is behind the oldest that the ring keeps.
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
        // With the lock released, as a waker that is dropped may run anything.
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
        let ring = Ring::new();
        let mut reader = ring.subscribe(2);
        (0..5).for_each(|sequence| ring.push(scan(sequence)));
        assert_eq!(take(&mut reader), Some(Some(Ok(3))));
        assert_eq!(take(&mut reader), Some(Some(Ok(4))));
        assert_eq!(take(&mut reader), None);
        assert_eq!((reader.missed(), ring.missed()), (3, 3));
    }

    #[test]
    fn an_error_comes_before_the_next_scan_and_is_pushed_out_by_none() {
        let ring = Ring::new();
        let mut reader = ring.subscribe(1);
        ring.report(Error::LaserOff);
        (0..5).for_each(|sequence| ring.push(scan(sequence)));
        assert_eq!(take(&mut reader), Some(Some(Err(Error::LaserOff.to_string()))));
        assert_eq!(take(&mut reader), Some(Some(Ok(4))));
        assert_eq!(take(&mut reader), None);
    }

    #[test]
    fn an_error_comes_behind_the_scans_from_before_it() {
        let ring = Ring::new();
        let (mut reader, mut slow) = (ring.subscribe(2), ring.subscribe(2));
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
        let ring = Ring::new();
        let (mut reader, mut other) = (ring.subscribe(1), ring.subscribe(1));
        ring.push(scan(0));
        ring.end(Some(Error::Loopback { sensor: None }));
        ring.end(Some(Error::Closed));
        for reader in [&mut reader, &mut other] {
            assert_eq!(take(reader), Some(Some(Ok(0))));
            assert_eq!(take(reader), Some(Some(Err(Error::Loopback { sensor: None }.to_string()))));
            assert!(!reader.is_finished());
            assert_eq!(take(reader), Some(None));
            assert_eq!(take(reader), Some(None));
            assert!(reader.is_finished());
        }
    }

    #[test]
    fn a_reader_that_comes_late_begins_with_an_error_only_if_no_scan_has_come_since() {
        let ring = Ring::new();
        ring.report(Error::Loopback { sensor: None });
        let (mut during, kept) = (ring.subscribe(1), ring.subscribe(1));
        assert_eq!(
            take(&mut during),
            Some(Some(Err(Error::Loopback { sensor: None }.to_string())))
        );
        assert_eq!(take(&mut during), None);
        (0..5).for_each(|sequence| ring.push(scan(sequence)));
        let mut after = kept.resubscribe();
        assert_eq!(take(&mut after), None);
        ring.push(scan(5));
        assert_eq!(take(&mut after), Some(Some(Ok(5))));
        // Nor does it count what came before it as missed; `during` never read it.
        assert_eq!((after.missed(), kept.missed(), ring.missed()), (0, 0, 0));
        assert_eq!(
            take(&mut kept.clone()),
            Some(Some(Err(Error::Loopback { sensor: None }.to_string())))
        );
    }

    #[test]
    fn each_reader_has_a_depth_of_its_own() {
        let ring = Ring::new();
        let (mut newest, mut all) = (ring.subscribe(1), ring.subscribe(4));
        (0..6).for_each(|sequence| ring.push(scan(sequence)));
        assert_eq!((take(&mut newest), take(&mut newest)), (Some(Some(Ok(5))), None));
        for sequence in 2..6 {
            assert_eq!(take(&mut all), Some(Some(Ok(sequence))));
        }
        assert_eq!((take(&mut all), newest.missed(), all.missed()), (None, 5, 2));
        // With the deepest reader the ring gives up what nobody else wants.
        drop(all);
        assert_eq!(ring.lock().scans.len(), 1);
        (6..9).for_each(|sequence| ring.push(scan(sequence)));
        assert_eq!(ring.lock().scans.len(), 1);
        assert_eq!(take(&mut newest), Some(Some(Ok(8))));
    }

    #[test]
    fn the_newest_scan_is_there_without_reading_it_and_without_waiting() {
        let ring = Ring::new();
        let mut reader = ring.subscribe(2);
        assert!(reader.latest().is_none() && reader.next_if_ready().is_none());
        (0..3).for_each(|sequence| ring.push(scan(sequence)));
        assert_eq!(reader.latest().map(|scan| scan.sequence()), Some(2));
        let mut next = || reader.next_if_ready().and_then(Result::ok).map(|scan| scan.sequence());
        assert_eq!([next(), next(), next()], [Some(1), Some(2), None]);
        assert_eq!(reader.latest().map(|scan| scan.sequence()), Some(2));
        ring.report(Error::LaserOff);
        assert!(matches!(reader.next_if_ready(), Some(Err(Error::LaserOff))));
        ring.end(None);
        assert!(reader.next_if_ready().is_none() && reader.is_finished());
    }

    #[test]
    fn freshness_is_the_time_of_the_newest_scan_and_the_error_since() {
        let ring = Ring::new();
        let reader = ring.subscribe(1);
        let error = || reader.freshness().1.map(|error| error.to_string());
        ring.report(Error::LaserOff);
        assert_eq!((reader.freshness().0, error()), (None, Some(Error::LaserOff.to_string())));
        let scan = scan(0);
        ring.push(scan.clone());
        assert_eq!((reader.freshness().0, error()), (Some(scan.received_at()), None));
        ring.report(Error::Loopback { sensor: None });
        assert_eq!(error(), Some(Error::Loopback { sensor: None }.to_string()));
    }

    #[test]
    fn no_reader_ever_sees_the_end_without_its_cause() {
        for _ in 0..1000 {
            let ring = Ring::new();
            let mut reader = ring.subscribe(1);
            let ending =
                std::thread::spawn(move || ring.end(Some(Error::Loopback { sensor: None })));
            let mut items = std::iter::repeat_with(|| take(&mut reader)).flatten();
            assert_eq!(items.next(), Some(Some(Err(Error::Loopback { sensor: None }.to_string()))));
            assert_eq!(items.next(), Some(None));
            assert!(ending.join().is_ok());
        }
    }

    #[test]
    fn a_clone_goes_on_from_the_same_place_and_a_new_reader_from_now() {
        let ring = Ring::new();
        let mut reader = ring.subscribe(8);
        ring.push(scan(0));
        ring.push(scan(1));
        assert_eq!(take(&mut reader), Some(Some(Ok(0))));
        let (mut clone, mut late) = (reader.clone(), ring.subscribe(8));
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
        let ring = Ring::new();
        let readers: Vec<_> = (0..3).map(|_| ring.subscribe(1)).collect();
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

    #[tokio::test]
    async fn a_reader_that_always_finds_a_scan_lets_other_tasks_run() {
        let ring = Ring::new();
        let mut reader = ring.subscribe(1);
        let other = tokio::spawn(async {});
        for sequence in 0..1000 {
            ring.push(scan(sequence));
            poll_fn(|cx| reader.poll_next(cx)).await;
            if other.is_finished() {
                return;
            }
        }
        assert!(other.is_finished(), "a thousand scans in one go");
    }
}
