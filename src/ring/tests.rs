//! Random histories of a ring, compared with readers that each have a queue of their own.

use std::collections::VecDeque;
use std::future::poll_fn;

use futures::FutureExt;
use proptest::prelude::*;

use super::{Cursor, Ring};
use crate::{Error, ErrorKind, Scan, Window};

pub(super) fn scan() -> Scan {
    scan_with(1000)
}

fn scan_with(value: u32) -> Scan {
    Scan::builder(Window::single(384), [value]).build().unwrap()
}

/// What a reader gets: the number of a scan and whether it repeats the one before, or an error.
type RingItem = Result<(u64, bool), String>;

/// Takes the ready item: `Some(None)` at the end, and `None` if nothing is ready.
fn take(cursor: &mut Cursor) -> Option<Option<RingItem>> {
    let item = poll_fn(|cx| cursor.poll_next(cx)).now_or_never()?;
    let number = |scan: Scan| (scan.sequence(), scan.is_repeat());
    Some(item.map(|item| item.map(number).map_err(|error| error.to_string())))
}

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

proptest! {
    #[test]
    fn each_reader_gets_its_newest_scans_and_the_latest_error(
        steps in prop::collection::vec(step(), 1..80),
    ) {
        let ring = Ring::new();
        let mut readers: Vec<(Cursor, Queue)> = Vec::new();
        let (mut scans, mut latest, mut news) = (0, None, None::<String>);
        let (mut has_ended, mut all_missed) = (false, 0);
        for step in steps {
            match step {
                // The driver neither pushes nor reports after the end.
                RingStep::Push(_) | RingStep::Report(_) if has_ended => {}
                RingStep::Push(value) => {
                    let (repeats, missed) = ring.push(scan_with(value));
                    prop_assert_eq!((repeats, missed), (latest == Some(value), all_missed));
                    readers.iter_mut().for_each(|(_, queue)| queue.push(Ok((scans, repeats))));
                    (scans, latest, news) = (scans + 1, Some(value), None);
                }
                RingStep::Report(kind) => {
                    ring.report(error(kind));
                    news = Some(error(kind).to_string());
                    readers.iter_mut().for_each(|(_, queue)| queue.report(&error(kind).to_string()));
                }
                RingStep::End(kind) => {
                    ring.end(kind.map(error));
                    if let Some(text) = kind.map(|kind| error(kind).to_string()).filter(|_| !has_ended) {
                        readers.iter_mut().for_each(|(_, queue)| queue.report(&text));
                        news = Some(text);
                    }
                    has_ended = true;
                }
                RingStep::Subscribe(depth) => {
                    let items = news.clone().map(Err).into_iter().collect();
                    let queue = Queue { depth: depth.max(1), items, missed: 0 };
                    readers.push((ring.subscribe(depth), queue));
                }
                RingStep::Read(n) => {
                    let Some((cursor, queue)) = readers.get_mut(n) else { continue };
                    let (before, is_error) = (cursor.missed(), matches!(queue.items.front(), Some(Err(_))));
                    let expected = queue.items.pop_front().map(Some);
                    prop_assert_eq!(take(cursor), expected.clone().or(has_ended.then_some(None)));
                    prop_assert_eq!(cursor.is_finished(), has_ended && expected.is_none());
                    prop_assert!(is_error || cursor.missed() == queue.missed);
                    all_missed += cursor.missed() - before;
                }
                RingStep::Clone(n) => {
                    let Some((cursor, queue)) = readers.get(n) else { continue };
                    readers.push((cursor.clone(), queue.clone()));
                }
                RingStep::Resubscribe(n) => {
                    let Some((cursor, queue)) = readers.get(n) else { continue };
                    let items = news.clone().map(Err).into_iter().collect();
                    let queue = Queue { items, missed: 0, ..*queue };
                    readers.push((cursor.resubscribe(), queue));
                }
                RingStep::Drop(n) if n < readers.len() => drop(readers.remove(n)),
                RingStep::Drop(_) => {}
            }
            prop_assert_eq!((ring.readers(), ring.missed()), (readers.len(), all_missed));
            // Deep readers that are gone leave no scans behind.
            let depth = readers.iter().map(|(_, queue)| queue.depth).max().unwrap_or(1);
            prop_assert!(ring.lock().scans.len() <= depth);
            for (cursor, _) in &readers {
                let newest = cursor.latest().and_then(|scan| scan.raw_values().next());
                prop_assert_eq!(newest, latest);
                let (received_at, error) = cursor.freshness();
                prop_assert_eq!(received_at.is_some(), latest.is_some());
                prop_assert_eq!(error.map(|error| error.to_string()), news.clone());
            }
        }
    }
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

#[test]
fn a_repeat_has_all_bits_of_the_values() {
    let ring = Ring::new();
    let _reader = ring.subscribe(1);
    let long = |value: u32| {
        let like = scan();
        Scan::new(like.window(), std::sync::Arc::<[u32]>::from([value, 7]), 0, like.meta)
    };
    let scans = [(scan(), false), (long(1000), true), (long(1000), true)];
    let higher = [(long(1000 + 65_536), false), (long(1000 + 65_536), true), (scan(), false)];
    for (number, (scan, repeats)) in scans.into_iter().chain(higher).enumerate() {
        assert_eq!(ring.push(scan).0, repeats, "{number}");
    }
}
