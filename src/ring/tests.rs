//! Histories of a ring, all short ones and random long ones, compared with readers that own a queue each.
//!
//! Each call takes the lock once, apart from waking tasks: so threads, too, make calls in some order.

use std::cell::Cell;
use std::collections::VecDeque;
use std::future::poll_fn;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll, Wake, Waker};

use proptest::prelude::*;

use super::{Cursor, Ring};
use crate::{Error, ErrorKind, Scan, Window};

thread_local! {
    /// How often this thread has taken the lock of a ring.
    static LOCKS: Cell<usize> = const { Cell::new(0) };
}

/// Counts a lock. Called by each lock of a ring.
pub(super) fn count_lock() {
    LOCKS.set(LOCKS.get() + 1);
}

fn scan() -> Scan {
    scan_with(1000)
}

fn scan_with(value: u32) -> Scan {
    Scan::builder(Window::single(384), [value]).build().unwrap()
}

/// What a reader gets: the number of a scan and whether it repeats the one before, or an error.
type RingItem = Result<(u64, bool), String>;

fn error(kind: usize) -> Error {
    [ErrorKind::LaserOff, ErrorKind::Loopback, ErrorKind::Closed]
        .into_iter()
        .nth(kind)
        .unwrap()
        .into()
}

#[derive(Debug, Clone)]
enum RingStep {
    Push(u32),
    Report(usize),
    End(Option<usize>),
    Subscribe(usize),
    Read(usize),
    Clone(usize),
    Resubscribe(usize),
    Drop(usize),
}

fn step() -> impl Strategy<Value = RingStep> {
    prop_oneof![
        8 => (0_u32..2).prop_map(RingStep::Push),
        2 => (0_usize..3).prop_map(RingStep::Report),
        1 => prop::option::of(0_usize..3).prop_map(RingStep::End),
        2 => (0_usize..5).prop_map(RingStep::Subscribe),
        8 => (0_usize..4).prop_map(RingStep::Read),
        1 => (0_usize..4).prop_map(RingStep::Clone),
        1 => (0_usize..4).prop_map(RingStep::Resubscribe),
        1 => (0_usize..4).prop_map(RingStep::Drop),
    ]
}

/// True while a task runs, or was woken.
#[derive(Debug)]
struct Task(AtomicBool);

impl Wake for Task {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Reader with its task, and what it should read.
#[derive(Debug)]
struct TestReader {
    cursor: Cursor,
    task: Arc<Task>,
    queue: Queue,
    /// True if it found nothing, and nothing has changed since.
    waits: bool,
}

impl TestReader {
    fn new(cursor: Cursor, queue: Queue) -> Self {
        Self { cursor, task: Arc::new(Task(AtomicBool::new(true))), queue, waits: false }
    }

    /// Takes the ready item: `Some(None)` at the end, and `None` if nothing is ready.
    fn take(&mut self) -> Option<Option<RingItem>> {
        self.task.0.store(true, Ordering::Relaxed);
        let waker = Waker::from(Arc::clone(&self.task));
        LOCKS.set(0);
        let item = self.cursor.poll_next(&mut Context::from_waker(&waker));
        assert!(LOCKS.get() <= 1, "another thread may change the ring in between");
        self.waits = item.is_pending();
        self.task.0.store(!self.waits, Ordering::Relaxed);
        let Poll::Ready(item) = item else { return None };
        let number = |scan: Scan| (scan.sequence(), scan.is_repeat());
        Some(item.map(|item| item.map(number).map_err(|error| error.to_string())))
    }

    fn change(&mut self, change: impl FnOnce(&mut Queue)) {
        change(&mut self.queue);
        self.waits = false;
    }
}

/// What a reader has yet to read.
#[derive(Debug, Clone)]
struct Queue {
    depth: usize,
    items: VecDeque<RingItem>,
    missed: u64,
}

impl Queue {
    fn push(&mut self, item: RingItem) {
        self.items.push_back(item);
        let scans = self.items.iter().filter(|item| item.is_ok()).count();
        if scans > self.depth {
            let oldest = self.items.iter().position(Result::is_ok).unwrap();
            self.items.remove(oldest);
            self.missed += 1;
        }
    }

    fn report(&mut self, error: &str) {
        self.items.retain(Result::is_ok);
        self.items.push_back(Err(error.to_owned()));
    }
}

fn check(steps: impl IntoIterator<Item = RingStep>) {
    let ring = Ring::new();
    let mut readers: Vec<TestReader> = Vec::new();
    let (mut scans, mut latest, mut news) = (0, None, None::<String>);
    let (mut has_ended, mut all_missed) = (false, 0);
    for step in steps {
        match step {
            // The driver neither pushes nor reports after the end.
            RingStep::Push(_) | RingStep::Report(_) if has_ended => {}
            RingStep::Push(value) => {
                let (repeats, missed) = ring.push(scan_with(value));
                assert_eq!((repeats, missed), (latest == Some(value), all_missed));
                let push = |queue: &mut Queue| queue.push(Ok((scans, repeats)));
                readers.iter_mut().for_each(|reader| reader.change(push));
                (scans, latest, news) = (scans + 1, Some(value), None);
            }
            RingStep::Report(kind) => {
                ring.report(error(kind));
                let text = error(kind).to_string();
                readers.iter_mut().for_each(|reader| reader.change(|queue| queue.report(&text)));
                news = Some(text);
            }
            RingStep::End(kind) => {
                ring.end(kind.map(error));
                let text = kind.map(|kind| error(kind).to_string()).filter(|_| !has_ended);
                let report = |queue: &mut Queue| text.iter().for_each(|text| queue.report(text));
                readers.iter_mut().for_each(|reader| reader.change(report));
                (has_ended, news) = (true, text.or(news));
            }
            RingStep::Subscribe(depth) => {
                let items = news.clone().map(Err).into_iter().collect();
                let queue = Queue { depth: depth.max(1), items, missed: 0 };
                readers.push(TestReader::new(ring.subscribe(depth), queue));
            }
            RingStep::Read(n) => {
                let Some(reader) = readers.get_mut(n) else { continue };
                let before = reader.cursor.missed();
                let expected = reader.queue.items.pop_front();
                let item = expected.clone().map(Some).or(has_ended.then_some(None));
                assert_eq!(reader.take(), item);
                assert_eq!(reader.cursor.is_finished(), item == Some(None));
                let missed = reader.cursor.missed();
                assert!(matches!(expected, Some(Err(_))) || missed == reader.queue.missed);
                all_missed += missed - before;
            }
            RingStep::Clone(n) => {
                let Some(TestReader { cursor, queue, .. }) = readers.get(n) else { continue };
                readers.push(TestReader::new(cursor.clone(), queue.clone()));
            }
            RingStep::Resubscribe(n) => {
                let Some(TestReader { cursor, queue, .. }) = readers.get(n) else { continue };
                let items = news.clone().map(Err).into_iter().collect();
                let queue = Queue { items, missed: 0, ..*queue };
                readers.push(TestReader::new(cursor.resubscribe(), queue));
            }
            RingStep::Drop(n) if n < readers.len() => drop(readers.remove(n)),
            RingStep::Drop(_) => {}
        }
        assert_eq!((ring.readers(), ring.missed()), (readers.len(), all_missed));
        // Deep readers that are gone leave no scans behind.
        let depth = readers.iter().map(|reader| reader.queue.depth).max().unwrap_or(1);
        assert!(ring.lock().scans.len() <= depth);
        for TestReader { cursor, task, waits, .. } in &readers {
            assert_eq!(task.0.load(Ordering::Relaxed), !waits, "each change wakes each reader");
            let newest = cursor.latest().and_then(|scan| scan.raw_values().next());
            assert_eq!(newest, latest);
            let (received_at, error) = cursor.freshness();
            assert_eq!(received_at.is_some(), latest.is_some());
            assert_eq!(error.map(|error| error.to_string()), news);
        }
    }
}

proptest! {
    #[test]
    fn each_reader_gets_its_newest_scans_and_the_latest_error(
        steps in prop::collection::vec(step(), 1..80),
    ) {
        check(steps);
    }
}

/// Histories of five steps, or the number in `SCIP_RING_STEPS`.
#[test]
fn every_short_history_of_two_readers() {
    const STEPS: [RingStep; 11] = [
        RingStep::Push(0),
        RingStep::Report(0),
        RingStep::End(Some(1)),
        RingStep::Subscribe(2),
        RingStep::Read(0),
        RingStep::Read(1),
        RingStep::Read(2),
        RingStep::Clone(0),
        RingStep::Resubscribe(1),
        RingStep::Drop(0),
        RingStep::Drop(1),
    ];
    let setting = std::env::var("SCIP_RING_STEPS").ok();
    let length = setting.and_then(|text| text.parse().ok()).unwrap_or(5);
    let count = STEPS.len().pow(length);
    for history in 0..count {
        let digits = (0..length).map(|place| history / STEPS.len().pow(place) % STEPS.len());
        let steps = digits.map(|digit| STEPS[digit].clone());
        check([RingStep::Subscribe(1), RingStep::Subscribe(2)].into_iter().chain(steps));
    }
    println!("{count} histories");
}

#[tokio::test]
async fn a_busy_reader_lets_other_tasks_run() {
    let ring = Ring::new();
    let mut reader = ring.subscribe(1);
    let other = tokio::spawn(async {});
    for _ in 0..1000 {
        ring.push(scan());
        poll_fn(|cx| reader.poll_next(cx)).await;
        if other.is_finished() {
            return;
        }
    }
    assert!(other.is_finished(), "a thousand scans in one go");
}

/// Waker of a task that owns a reader.
struct Owner(#[expect(dead_code, reason = "dropped with the waker")] Cursor);

impl Wake for Owner {
    fn wake(self: Arc<Self>) {}
}

#[test]
fn a_waker_may_drop_a_reader() {
    let ring = Ring::new();
    let mut reader = ring.subscribe(1);
    let mut wait = || {
        let waker = Waker::from(Arc::new(Owner(ring.subscribe(1))));
        while reader.poll_next(&mut Context::from_waker(&waker)).is_ready() {}
        ring.readers()
    };
    assert_eq!((wait(), wait()), (2, 2), "the first is replaced");
    ring.push(scan());
    assert_eq!((ring.readers(), wait()), (1, 2), "woken");
    drop(reader);
    assert_eq!(ring.readers(), 0);
}
