//! Tests of schedules: which poll is due when, and what its end changes.

use std::future::poll_fn;

use futures::FutureExt;

use super::*;

const HUNDRED_MS: Duration = Duration::from_millis(100);

fn schedules(rates: &[(Window, Rate)]) -> (Schedules, Vec<Cursor>) {
    let mut schedules = Schedules::default();
    let readers = rates
        .iter()
        .map(|&(window, rate)| schedules.subscribe(window, rate, 1, None, None))
        .collect();
    (schedules, readers)
}

#[tokio::test(start_paused = true)]
async fn a_late_poll_goes_out_at_once_and_the_next_one_is_on_the_grid_again() {
    let start = Instant::now();
    let (mut schedules, _readers) = schedules(&[(Window::FULL, Rate::hz(10.0))]);
    let mut take = |at: u64| {
        let (_, skipped) = schedules.take_due(start + Duration::from_millis(at))?;
        let due = schedules.next_due()?;
        Some((skipped, (due - start).as_millis()))
    };
    assert_eq!(take(0), Some((0, 100)));
    assert_eq!(take(99), None);
    assert_eq!(take(100), Some((0, 200)));
    assert_eq!(take(260), Some((0, 300)));
    assert_eq!(take(650), Some((3, 700)));
    assert_eq!(take(700), Some((0, 800)));
}

#[tokio::test(start_paused = true)]
async fn a_rate_in_step_with_the_motor_loses_no_scan() {
    let start = Instant::now();
    for turns in 1..=4 {
        let rate = Rate::hz(10.0 / f64::from(turns));
        let (mut schedules, _readers) = schedules(&[(Window::FULL, rate)]);
        schedules.begin_stream(HUNDRED_MS);
        // Each scan comes up to 2 ms before or after a point of the grid.
        let mut random = 1_u64;
        let taken = (1..1000).filter(|turn| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let late = Duration::from_micros((random >> 33) % 4000);
            let now = start + HUNDRED_MS * *turn + late - Duration::from_millis(2);
            !schedules.take_streamed(now, HUNDRED_MS).is_empty()
        });
        // The first point is due at once.
        let taken: Vec<_> = taken.skip(1).collect();
        assert!(taken.windows(2).all(|pair| pair[1] - pair[0] == turns), "{turns}: {taken:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn each_scan_of_a_fast_motor_is_taken_and_the_grid_stays() {
    let start = Instant::now();
    let (mut schedules, _readers) = schedules(&[(Window::FULL, Rate::hz(10.0))]);
    schedules.begin_stream(HUNDRED_MS);
    let turn = Duration::from_micros(99_760);
    assert!((0..10_000).all(|n| !schedules.take_streamed(start + turn * n, HUNDRED_MS).is_empty()));
    schedules.end_stream();
    let ahead = schedules.next_due().unwrap() - (start + turn * 9_999);
    assert!(ahead <= HUNDRED_MS * 3 / 2, "{ahead:?}");
}

#[tokio::test(start_paused = true)]
async fn what_has_been_due_for_longest_goes_first() {
    let start = Instant::now();
    let fast = (Window::FULL, Rate::hz(20.0));
    let slow = (Window::FULL, Rate::hz(10.0));
    let narrow = (Window::DETECTION, Rate::hz(10.0));
    let (mut schedules, _readers) = schedules(&[fast, slow, narrow]);
    let take = || schedules.take_due(start + HUNDRED_MS).map(|(poll, _)| (poll.window, poll.rate));
    let order: Vec<_> = std::iter::repeat_with(take).take(4).collect();
    assert_eq!(order, [Some(fast), Some(slow), Some(narrow), None]);
}

#[tokio::test(start_paused = true)]
async fn equal_schedules_are_one_and_one_without_readers_ends() {
    let same = (Window::FULL, Rate::UNLIMITED);
    let (mut schedules, readers) = schedules(&[same, same]);
    let counters = Counters::default();
    schedules.publish(&counters);
    assert_eq!(counters.snapshot().schedules.len(), 1);
    assert!(schedules.take_due(Instant::now()).is_some());
    drop(readers);
    assert_eq!(counters.snapshot().schedules, [], "before the driver has noticed");
    assert!(schedules.take_due(Instant::now()).is_none());
    assert!(schedules.is_empty());
}

/// On another sensor, equal windows may differ.
#[tokio::test(start_paused = true)]
async fn schedules_tell_apart_how_a_window_was_asked_for() {
    let steps = Window::new(44..=725).unwrap();
    let degrees = |to| Window::degrees(-119.6..=to).unwrap();
    let windows = [Window::DETECTION, steps, degrees(119.9), degrees(119.95)];
    assert_eq!(windows, [steps; 4]);
    let again = [degrees(119.9), steps, Window::DETECTION];
    let all = windows.into_iter().chain(again).map(|window| (window, Rate::UNLIMITED));
    let (mut schedules, _readers) = schedules(&all.collect::<Vec<_>>());
    let counters = Counters::default();
    schedules.publish(&counters);
    assert_eq!(counters.snapshot().schedules.len(), 4);
}

fn scan() -> Scan {
    Scan::builder(Window::single(384), [1000]).build().unwrap()
}

#[tokio::test(start_paused = true)]
async fn missed_scans_are_counted_once_and_stay_counted_after_their_reader_is_gone() {
    let (window, rate) = (Window::single(384), Rate::UNLIMITED);
    let (mut schedules, mut readers) = schedules(&[(window, rate)]);
    let poll = DuePoll { window, rate, is_measured: true };
    let mut deliver_three_and_read_one = |schedules: &mut Schedules| {
        for _ in 0..3 {
            schedules.deliver(poll, scan(), None);
        }
        assert!(readers.iter_mut().all(|reader| {
            poll_fn(|cx| reader.poll_next(cx)).now_or_never().flatten().is_some()
        }));
        schedules.missed()
    };
    // Known at the next poll.
    assert_eq!(deliver_three_and_read_one(&mut schedules), 0);
    assert_eq!(deliver_three_and_read_one(&mut schedules), 2);
    assert_eq!(deliver_three_and_read_one(&mut schedules), 4);
    drop(readers);
    assert!(schedules.take_due(Instant::now()).is_none());
    assert_eq!(schedules.missed(), 6);
}

#[tokio::test(start_paused = true)]
async fn a_condition_is_reported_once_until_it_changes_or_a_scan_comes() {
    let (window, rate) = (Window::single(384), Rate::UNLIMITED);
    let (mut schedules, mut readers) = schedules(&[(window, rate)]);
    let poll = DuePoll { window, rate, is_measured: true };
    let mut errors = 0;
    let mut count = |schedules: &mut Schedules, error: Option<Error>| {
        match error {
            Some(error) => drop(schedules.fail(poll, &error, Instant::now())),
            None => drop(schedules.deliver(poll, scan(), None)),
        }
        let next = readers.iter_mut().map(|reader| poll_fn(|cx| reader.poll_next(cx)));
        let items = next.filter_map(FutureExt::now_or_never);
        errors += items.filter(|item| matches!(item, Some(Err(_)))).count();
        errors
    };
    assert_eq!(count(&mut schedules, Some(ErrorKind::LaserOff.into())), 1);
    assert_eq!(count(&mut schedules, Some(ErrorKind::LaserOff.into())), 1);
    assert_eq!(count(&mut schedules, Some(ErrorKind::Loopback.into())), 2);
    assert_eq!(count(&mut schedules, None), 2);
    assert_eq!(count(&mut schedules, Some(ErrorKind::Loopback.into())), 3);
}
