//! Order, depth, ends and wake-ups of a ring, as one thread sees them.

use futures::FutureExt;
use std::future::poll_fn;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::task::{Context, Wake, Waker};

use super::*;
use crate::{ErrorKind, Window};

pub(super) fn scan() -> Scan {
    Scan::builder(Window::single(384), [1000]).build().unwrap()
}

fn push(ring: &Ring, scans: usize) {
    for _ in 0..scans {
        ring.push(scan());
    }
}

/// Returns the next item if it is ready.
fn next_if_ready(cursor: &mut Cursor) -> Option<Result<Scan, Error>> {
    poll_fn(|cx| cursor.poll_next(cx)).now_or_never().flatten()
}

/// Takes the ready item: `Some(None)` at the end, and `None` if nothing is ready.
fn take(cursor: &mut Cursor) -> Option<Option<Result<u64, String>>> {
    let item = poll_fn(|cx| cursor.poll_next(cx)).now_or_never()?;
    Some(item.map(|item| item.map(|scan| scan.sequence()).map_err(|error| error.to_string())))
}

#[test]
fn a_slow_reader_gets_the_newest_and_knows_what_it_missed() {
    let ring = Ring::new();
    let mut reader = ring.subscribe(2);
    push(&ring, 5);
    assert_eq!(take(&mut reader), Some(Some(Ok(3))));
    assert_eq!(take(&mut reader), Some(Some(Ok(4))));
    assert_eq!(take(&mut reader), None);
    assert_eq!((reader.missed(), ring.missed()), (3, 3));
}

#[test]
fn an_error_comes_before_the_next_scan_and_is_pushed_out_by_none() {
    let ring = Ring::new();
    let mut reader = ring.subscribe(1);
    ring.report(ErrorKind::LaserOff.into());
    push(&ring, 5);
    assert_eq!(take(&mut reader), Some(Some(Err(ErrorKind::LaserOff.to_string()))));
    assert_eq!(take(&mut reader), Some(Some(Ok(4))));
    assert_eq!(take(&mut reader), None);
}

#[test]
fn an_error_comes_behind_the_scans_from_before_it() {
    let ring = Ring::new();
    let (mut reader, mut slow) = (ring.subscribe(2), ring.subscribe(2));
    push(&ring, 3);
    ring.report(ErrorKind::LaserOff.into());
    assert_eq!(take(&mut reader), Some(Some(Ok(1))));
    assert_eq!(take(&mut reader), Some(Some(Ok(2))));
    assert_eq!(take(&mut reader), Some(Some(Err(ErrorKind::LaserOff.to_string()))));
    assert_eq!(take(&mut reader), None);
    ring.push(scan());
    assert_eq!(take(&mut reader), Some(Some(Ok(3))));
    // One of the two kept scans is from before the error.
    assert_eq!(take(&mut slow), Some(Some(Ok(2))));
    assert_eq!(take(&mut slow), Some(Some(Err(ErrorKind::LaserOff.to_string()))));
    assert_eq!(take(&mut slow), Some(Some(Ok(3))));
    assert_eq!((take(&mut slow), slow.missed()), (None, 2));
}

#[test]
fn the_end_comes_after_what_is_left_and_its_cause() {
    let ring = Ring::new();
    let (mut reader, mut other) = (ring.subscribe(1), ring.subscribe(1));
    ring.push(scan());
    ring.end(Some(ErrorKind::Loopback.into()));
    ring.end(Some(ErrorKind::Closed.into()));
    for reader in [&mut reader, &mut other] {
        assert_eq!(take(reader), Some(Some(Ok(0))));
        assert_eq!(take(reader), Some(Some(Err(ErrorKind::Loopback.to_string()))));
        assert!(!reader.is_finished());
        assert_eq!(take(reader), Some(None));
        assert_eq!(take(reader), Some(None));
        assert!(reader.is_finished());
    }
}

#[test]
fn a_reader_that_comes_late_begins_with_an_error_only_if_no_scan_has_come_since() {
    let ring = Ring::new();
    ring.report(ErrorKind::Loopback.into());
    let (mut during, kept) = (ring.subscribe(1), ring.subscribe(1));
    assert_eq!(take(&mut during), Some(Some(Err(ErrorKind::Loopback.to_string()))));
    assert_eq!(take(&mut during), None);
    push(&ring, 5);
    let mut after = kept.resubscribe();
    assert_eq!(take(&mut after), None);
    ring.push(scan());
    assert_eq!(take(&mut after), Some(Some(Ok(5))));
    // Nor does it count earlier scans as missed. `during` never read them.
    assert_eq!((after.missed(), kept.missed(), ring.missed()), (0, 0, 0));
    assert_eq!(take(&mut kept.clone()), Some(Some(Err(ErrorKind::Loopback.to_string()))));
}

#[test]
fn a_reader_that_comes_late_begins_with_the_latest_of_two_errors() {
    let ring = Ring::new();
    ring.report(ErrorKind::LaserOff.into());
    let mut reader = ring.subscribe(1);
    ring.report(ErrorKind::Loopback.into());
    let latest = ErrorKind::Loopback.to_string();
    assert_eq!((take(&mut reader), take(&mut reader)), (Some(Some(Err(latest))), None));
}

#[test]
fn each_reader_has_a_depth_of_its_own() {
    let ring = Ring::new();
    let (mut newest, mut all) = (ring.subscribe(1), ring.subscribe(4));
    push(&ring, 6);
    assert_eq!((take(&mut newest), take(&mut newest)), (Some(Some(Ok(5))), None));
    for sequence in 2..6 {
        assert_eq!(take(&mut all), Some(Some(Ok(sequence))));
    }
    assert_eq!((take(&mut all), newest.missed(), all.missed()), (None, 5, 2));
    // Once the deepest reader is gone, the ring drops the scans that only it could read.
    drop(all);
    assert_eq!(ring.lock().scans.len(), 1);
    push(&ring, 3);
    assert_eq!(ring.lock().scans.len(), 1);
    assert_eq!(take(&mut newest), Some(Some(Ok(8))));
}

#[test]
fn the_newest_scan_is_there_without_reading_it_and_without_waiting() {
    let ring = Ring::new();
    let mut reader = ring.subscribe(2);
    assert!(reader.latest().is_none() && next_if_ready(&mut reader).is_none());
    push(&ring, 3);
    assert_eq!(reader.latest().map(|scan| scan.sequence()), Some(2));
    let mut next = || next_if_ready(&mut reader).and_then(Result::ok).map(|scan| scan.sequence());
    assert_eq!([next(), next(), next()], [Some(1), Some(2), None]);
    assert_eq!(reader.latest().map(|scan| scan.sequence()), Some(2));
    ring.report(ErrorKind::LaserOff.into());
    let error = next_if_ready(&mut reader).unwrap().unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::LaserOff));
    ring.end(None);
    assert!(next_if_ready(&mut reader).is_none() && reader.is_finished());
}

#[test]
fn freshness_is_the_time_of_the_newest_scan_and_the_error_since() {
    let ring = Ring::new();
    let reader = ring.subscribe(1);
    let error = || reader.freshness().1.map(|error| error.to_string());
    ring.report(ErrorKind::LaserOff.into());
    assert_eq!((reader.freshness().0, error()), (None, Some(ErrorKind::LaserOff.to_string())));
    let scan = scan();
    ring.push(scan.clone());
    assert_eq!((reader.freshness().0, error()), (Some(scan.received_at()), None));
    ring.report(ErrorKind::Loopback.into());
    assert_eq!(error(), Some(ErrorKind::Loopback.to_string()));
}

#[test]
fn a_clone_goes_on_from_the_same_place_and_a_new_reader_from_now() {
    let ring = Ring::new();
    let mut reader = ring.subscribe(8);
    ring.push(scan());
    ring.push(scan());
    assert_eq!(take(&mut reader), Some(Some(Ok(0))));
    let (mut clone, mut late) = (reader.clone(), ring.subscribe(8));
    assert_eq!(take(&mut late), None);
    for reader in [&mut reader, &mut clone] {
        assert_eq!(take(reader), Some(Some(Ok(1))));
    }
    assert_eq!(ring.readers(), 3);
    drop((reader, late));
    assert_eq!(ring.readers(), 1);
    drop(clone);
    assert_eq!(ring.readers(), 0);
}

#[test]
fn a_reader_that_moves_to_another_task_is_woken_there_and_not_where_it_was() {
    #[derive(Default)]
    struct WokenFlag(AtomicBool);

    impl Wake for WokenFlag {
        fn wake(self: Arc<Self>) {
            self.0.store(true, Relaxed);
        }
    }

    let ring = Ring::new();
    let mut reader = ring.subscribe(1);
    let [former, latter] = [(); 2].map(|()| Arc::new(WokenFlag::default()));
    for task in [&former, &latter] {
        let waker = Waker::from(Arc::clone(task));
        assert!(reader.poll_next(&mut Context::from_waker(&waker)).is_pending());
    }
    ring.push(scan());
    assert_eq!([former, latter].map(|task| task.0.load(Relaxed)), [false, true]);
}

#[tokio::test]
async fn a_reader_that_always_finds_a_scan_lets_other_tasks_run() {
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
