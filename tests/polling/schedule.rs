//! Polls on a grid, and the scans that streams deliver from them.

use std::future::ready;
use std::time::Duration;

use crate::common::{builder, ms, request_of, truthful};
use futures::StreamExt;
use futures::stream::FusedStream;
use tokio::time::{Instant, advance, timeout};
use tokio_scip::protocol::Protocol;
use tokio_scip::{BaudRate, ErrorKind, Rate, Scan, ScanStream, Sensor, State, Window};
use urg_emulator::{Emulator, Fault, Faults, Pace};

async fn take(stream: &mut ScanStream, count: usize) -> Vec<Scan> {
    let mut scans = Vec::new();
    while scans.len() < count {
        scans.push(stream.next().await.unwrap().unwrap());
    }
    scans
}

/// Returns whether the stream yields nothing for a minute.
async fn is_silent(stream: &mut ScanStream) -> bool {
    timeout(Duration::from_secs(60), stream.next()).await.is_err()
}

async fn open(emulator: &Emulator) -> Sensor {
    builder().connect(emulator.clone()).await.unwrap()
}

#[tokio::test(start_paused = true)]
async fn a_motor_a_little_slow_or_fast_is_polled_every_revolution() {
    for revolution in [99_500, 100_000, 100_500].map(Duration::from_micros) {
        let emulator = truthful().revolution(revolution).build();
        let sensor = open(&emulator).await;
        let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
        take(&mut stream, 1).await;
        let start = Instant::now();
        let scans = take(&mut stream, 2000).await.len();
        let rate = scans as f64 / start.elapsed().as_secs_f64();
        assert!(rate >= 9.9, "{rate} scans a second at a revolution of {revolution:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_late_poll_goes_out_at_once_and_leaves_the_grid() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let start = take(&mut stream, 1).await[0].times().requested_at;
    emulator.set_faults(Faults::none().at(0, Fault::Late(ms(150))));
    let scans = take(&mut stream, 4).await;
    let polls: Vec<_> = scans.iter().map(|scan| scan.times().requested_at - start).collect();
    assert!((ms(250)..ms(260)).contains(&polls[1]), "{polls:?}");
    assert_eq!([polls[0], polls[2], polls[3]], [ms(100), ms(300), ms(400)]);
}

#[tokio::test(start_paused = true)]
async fn t06_a_slow_line_is_reported_once() {
    let emulator = truthful().baud_rate(BaudRate::B19200).pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let start = Instant::now();
    take(&mut stream, 20).await;
    let wire = Window::DETECTION.wire_time(BaudRate::B19200, Protocol::Scip1);
    assert!(start.elapsed() < wire.mul_f64(21.5), "{:?}", start.elapsed());
    let stats = sensor.stats();
    assert!(stats.polls_skipped > 100, "{stats:?}");
    let [schedule] = &stats.schedules[..] else { panic!("{stats:?}") };
    assert_eq!(schedule.rate, Rate::hz(10.0));
    assert!((1.2..1.5).contains(&schedule.reached.unwrap()), "{stats:?}");
}

#[tokio::test(start_paused = true)]
async fn a02_a_slow_consumer_gets_the_newest_scan_and_sees_the_gap() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let first = take(&mut stream, 1).await.remove(0);
    // Sixty scans later.
    tokio::time::sleep(Duration::from_secs(6)).await;
    let now = Instant::now();
    let next = take(&mut stream, 1).await.remove(0);
    assert!(now - next.received_at() <= ms(100), "an old scan");
    assert_eq!(next.sequence() - first.sequence() - 1, stream.missed());
    assert!((58..=60).contains(&stream.missed()));
    assert!(request_of(&next) > request_of(&first));
    take(&mut stream, 1).await;
    assert_eq!(sensor.stats().missed, stream.missed());
    tokio::time::sleep(ms(1050)).await;
    take(&mut stream, 1).await;
    let missed = stream.missed();
    drop(stream);
    sensor.scan(Window::DETECTION).await.unwrap();
    assert_eq!(sensor.stats().missed, missed, "after its reader is gone");
}

#[tokio::test(start_paused = true)]
async fn a02_no_error_is_lost_to_a_slow_consumer() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    take(&mut stream, 1).await;
    emulator.set_faults(Faults::none().at(0, Fault::Lost));
    tokio::time::sleep(Duration::from_secs(60)).await;
    assert!(matches!(stream.next().await.unwrap().unwrap_err().kind(), ErrorKind::Timeout { .. }));
    let scan = take(&mut stream, 1).await.remove(0);
    assert!(scan.sequence() > 500);
}

#[tokio::test(start_paused = true)]
async fn an_error_is_reported_once_for_each_change_of_condition() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    // Ten polls in a row are damaged; the fences between them are not.
    let mut faults = Faults::none();
    for reply in (0..20).step_by(2) {
        faults = faults.at(reply, Fault::Drop(100..101));
    }
    take(&mut stream, 1).await;
    emulator.set_faults(faults);
    let mut errors = 0;
    for _ in 0..20 {
        errors += usize::from(stream.next().await.unwrap().is_err());
    }
    assert_eq!(errors, 1);
    assert_eq!(sensor.stats().malformed.length, 10);
    // After a scan, the same condition again and then another one.
    emulator.set_faults(Faults::none().at(0, Fault::Drop(100..101)).at(2, Fault::Lost));
    let malformed = stream.next().await.unwrap().unwrap_err();
    assert!(matches!(malformed.kind(), ErrorKind::Malformed { .. }), "{malformed}");
    let late = stream.next().await.unwrap().unwrap_err();
    assert!(matches!(late.kind(), ErrorKind::Timeout { .. }), "{late}");
}

#[tokio::test(start_paused = true)]
async fn equal_streams_share_their_polls() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    let mut one = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let mut two = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let mut three = one.clone();
    // The first poll may have been sent before the second stream existed.
    take(&mut two, 1).await;
    take(&mut one, 1).await;
    take(&mut three, 1).await;
    let before = emulator.counts().scans;
    for _ in 0..100 {
        let scans = [take(&mut one, 1).await, take(&mut two, 1).await, take(&mut three, 1).await];
        assert_eq!(request_of(&scans[0][0]), request_of(&scans[1][0]));
        assert_eq!(request_of(&scans[0][0]), request_of(&scans[2][0]));
    }
    assert_eq!(emulator.counts().scans - before, 100);
}

#[tokio::test(start_paused = true)]
async fn a03_polling_stops_within_a_period_of_the_last_streams_end() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    let mut one = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let two = one.clone();
    drop(two);
    take(&mut one, 10).await;
    drop(one);
    let before = emulator.counts().commands;
    tokio::time::sleep(Duration::from_secs(60)).await;
    assert_eq!(emulator.counts().commands, before);
    assert!(emulator.is_connected());
}

#[tokio::test(start_paused = true)]
async fn streams_of_different_windows_share_the_sensor_fairly() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    let narrow = Window::new(300..=400).unwrap();
    let mut one = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let mut two = sensor.scans(narrow, Rate::UNLIMITED).await.unwrap();
    let count = async |stream: &mut ScanStream| {
        let mut count = 0;
        let end = Instant::now() + Duration::from_secs(20);
        while tokio::time::timeout_at(end, stream.next()).await.is_ok() {
            count += 1;
        }
        count
    };
    let (one, two) = tokio::join!(count(&mut one), count(&mut two));
    // Ten revolutions a second for both.
    assert!((98..=102).contains(&one) && (98..=102).contains(&two), "{one} and {two}");
}

#[tokio::test(start_paused = true)]
async fn a07_requests_and_polls_alternate_however_many_requests_there_are() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    take(&mut stream, 1).await;
    let window = Window::new(100..=120).unwrap();
    let asked: Vec<_> = (0..1000)
        .map(|_| {
            let sensor = sensor.clone();
            tokio::spawn(async move { sensor.scan(window).await.unwrap() })
        })
        .collect();
    let before = sensor.stats().scans;
    let mut answers = Vec::new();
    for answer in asked {
        answers.push(request_of(&answer.await.unwrap()).unwrap());
    }
    // Requests in order, with a poll of the stream between any two.
    assert!(answers.windows(2).all(|pair| pair[0] < pair[1]));
    let polled = sensor.stats().scans - before - 1000;
    assert!((998..=1002).contains(&polled), "{polled} polls between 1000 requests");
}

#[tokio::test(start_paused = true)]
async fn a_stream_ends_with_none_after_close_and_stays_ended() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    take(&mut stream, 1).await;
    sensor.close().await;
    assert!(!emulator.is_connected());
    // Scans received before the end are still delivered.
    while let Some(item) = stream.next().await {
        item.unwrap();
    }
    assert!(stream.is_terminated());
    assert!(stream.next().await.is_none());
    assert!(matches!(sensor.scan(Window::FULL).await.unwrap_err().kind(), ErrorKind::Closed));
    assert!(matches!(
        sensor.scans(Window::FULL, Rate::UNLIMITED).await.unwrap_err().kind(),
        ErrorKind::Closed
    ));
    sensor.close().await;
}

#[tokio::test(start_paused = true)]
async fn a04_the_driver_lives_as_long_as_the_last_handle_or_stream() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    let mut state = sensor.watch_state();
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    drop(sensor);
    take(&mut stream, 10).await;
    let clone = stream.clone();
    drop(stream);
    assert!(emulator.is_connected());
    drop(clone);
    state
        .wait_for(|state| matches!(state, tokio_scip::State::Closed { error: None }))
        .await
        .unwrap();
    assert!(!emulator.is_connected());
}

#[tokio::test(start_paused = true)]
async fn a_stream_outlives_errors_until_closed() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    let stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let mut scans = stream.filter_map(|item| ready(item.ok()));
    assert_eq!(scans.next().await.unwrap().sequence(), 0);
    emulator.unplug();
    let lost = timeout(Duration::from_secs(60), scans.next()).await;
    assert!(lost.is_err(), "an error is not the end");
    emulator.plug_in();
    assert!(scans.next().await.is_some());
    assert!(!scans.is_terminated());
    sensor.close().await;
    assert!(scans.next().await.is_none());
    assert!(scans.is_terminated());
}

#[tokio::test(start_paused = true)]
async fn the_time_that_replies_take_is_reported() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let patient = builder().reply_latency(Duration::from_secs(3600));
    let sensor = patient.connect(emulator.clone()).await.unwrap();
    assert_eq!(sensor.stats().reply_latency.quantile(0.5), Duration::ZERO);
    let mut latencies = Vec::new();
    // From a millisecond to a minute.
    for late in (0..225).map(|n| Duration::from_millis(1).mul_f64(1.05_f64.powi(n))) {
        emulator.set_faults(Faults::none().at(0, Fault::Late(late)));
        sensor.scan(Window::new(384..=384).unwrap()).await.unwrap();
        let last = sensor.stats().reply_latency.last;
        assert!((late..=late + ms(2)).contains(&last), "{late:?}: {last:?}");
        latencies.push(last);
    }
    let (stats, count) = (sensor.stats().reply_latency, latencies.len() as f64);
    let ends = (stats.min, stats.max, stats.total);
    assert_eq!(ends, (latencies[0], latencies[224], latencies.iter().sum()));
    for (rank, exact) in latencies.into_iter().enumerate() {
        let found = stats.quantile((rank as f64 + 0.5) / count);
        let most = exact.mul_f64(1.125) + Duration::from_micros(64);
        let most = if exact > Duration::from_secs(16) { stats.max } else { most };
        assert!((exact..=most).contains(&found), "{exact:?}: {found:?}");
    }
    assert_eq!((stats.quantile(1.0), stats.quantile(7.0)), (stats.max, stats.max));
    assert!(stats.quantile(f64::NAN) >= stats.min);
}

#[tokio::test(start_paused = true)]
async fn t11_the_same_data_again_is_marked_as_a_repeat() {
    use urg_emulator::Fixed;
    let emulator = Emulator::builder().world(Fixed::filled(1234)).pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let repeats: Vec<bool> = take(&mut stream, 3).await.iter().map(Scan::is_repeat).collect();
    assert_eq!(repeats, [false, true, true]);
    assert_eq!(sensor.stats().repeats, 2);
}

#[tokio::test(start_paused = true)]
async fn o21_hours_of_suspend_cause_no_burst() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    take(&mut stream, 3).await;
    let before = emulator.counts().scans;
    advance(Duration::from_secs(8 * 3600)).await;
    take(&mut stream, 2).await;
    assert!(emulator.counts().scans - before <= 4);
}

#[tokio::test(start_paused = true)]
async fn a09_polls_rest_while_the_laser_is_off_by_request() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    take(&mut stream, 3).await;
    sensor.laser_off().await.unwrap();
    let before = emulator.counts().scans;
    while let Ok(Some(item)) = timeout(ms(500), stream.next()).await {
        item.unwrap();
    }
    assert!(is_silent(&mut stream).await);
    assert_eq!(emulator.counts().scans, before);
    assert!(matches!(sensor.scan(Window::FULL).await.unwrap_err().kind(), ErrorKind::LaserOff));
    sensor.laser_on().await.unwrap();
    take(&mut stream, 3).await;
}

#[tokio::test(start_paused = true)]
async fn a_stream_that_is_opened_again_polls_at_once() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    let rate = Rate::every(Duration::from_secs(3600));
    let mut stream = sensor.scans(Window::DETECTION, rate).await.unwrap();
    take(&mut stream, 1).await;
    drop(stream);
    let start = Instant::now();
    let mut again = sensor.scans(Window::DETECTION, rate).await.unwrap();
    assert_eq!(take(&mut again, 1).await[0].sequence(), 0);
    assert!(start.elapsed() < ms(1000), "{:?}", start.elapsed());
}

#[tokio::test(start_paused = true)]
async fn a_pause_of_polling_is_no_low_rate() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    take(&mut stream, 35).await;
    sensor.laser_off().await.unwrap();
    tokio::time::sleep(Duration::from_secs(60)).await;
    sensor.laser_on().await.unwrap();
    take(&mut stream, 1).await;
    let skipped = sensor.stats().polls_skipped;
    assert!(skipped < 3, "{skipped}");
    take(&mut stream, 40).await;
    let reached = sensor.stats().schedules[0].reached.unwrap();
    assert!(reached > 9.5, "{reached}");
}

#[tokio::test(start_paused = true)]
async fn the_rate_that_is_reached_falls_when_no_scans_come() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    take(&mut stream, 40).await;
    let mut faults = Faults::none();
    for reply in (1..2000).step_by(2) {
        faults = faults.at(reply, Fault::Drop(100..101));
    }
    emulator.set_faults(faults.at(0, Fault::Drop(100..101)));
    tokio::time::sleep(Duration::from_secs(10)).await;
    let stats = sensor.stats();
    assert!(stats.schedules[0].reached.unwrap() < 6.0, "{stats:?}");
    assert!(stats.schedules[0].failed > 10, "{stats:?}");
    drop(stream);
    assert_eq!(sensor.stats().schedules, [], "the schedule of a stream that is gone");
}

#[tokio::test(start_paused = true)]
async fn the_state_reports_whether_scans_are_polled() {
    let emulator = truthful().build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    let mut state = sensor.watch_state();
    let streaming = |state: &State| matches!(state, State::Connected { streaming: true, .. });
    assert!(!streaming(&state.get()));
    let stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    state.wait_for(streaming).await.unwrap();
    drop(stream);
    state.wait_for(|state| !streaming(state)).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn dropping_the_last_stream_ends_streaming() {
    // The queue of requests is empty, then full, then full of requests without a caller.
    for (requests, is_abandoned) in [(0, false), (100, false), (100, true)] {
        let sensor = builder().connect(Emulator::default()).await.unwrap();
        let stream = sensor.scans(Window::FULL, Rate::hz(0.001)).await.unwrap();
        let mut state = sensor.watch_state();
        let is_streaming =
            |state: &State| matches!(state, State::Connected { streaming: true, .. });
        state.wait_for(is_streaming).await.unwrap();
        let mut callers = Vec::new();
        for _ in 0..requests {
            let sensor = sensor.clone();
            callers.push(tokio::spawn(async move { sensor.scan(Window::FULL).await }));
        }
        tokio::task::yield_now().await;
        drop(stream);
        callers.iter().filter(|_| is_abandoned).for_each(|caller| caller.abort());
        let ended = state.wait_for(|state| !is_streaming(state));
        let ended = tokio::time::timeout(Duration::from_secs(15), ended).await;
        assert!(ended.is_ok(), "{requests} requests, abandoned: {is_abandoned}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_replaced_stream_continues_at_once() {
    let sensor = builder().connect(Emulator::default()).await.unwrap();
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    scans.next().await.unwrap().unwrap();
    let (start, ahead) = (Instant::now(), Window::new(299..=469).unwrap());
    scans = sensor.scans(ahead, Rate::hz(5.0)).await.unwrap();
    let scan = scans.next().await.unwrap().unwrap();
    assert_eq!((scan.window(), scan.sequence()), (ahead, 0));
    assert!(start.elapsed() <= ms(300), "{:?}", start.elapsed());
    let before = sensor.stats().polls;
    tokio::time::sleep(ms(2000)).await;
    // The old stream would add 20.
    let polls = sensor.stats().polls - before;
    assert!((5..=12).contains(&polls), "{polls}");
}
