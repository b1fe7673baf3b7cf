//! A lost link comes back with the settings and streams that the service had asked for.

use std::time::Duration;

use crate::common::{Truth, builder, ms, truthful};
use tokio::time::Instant;
use tokio_scip::{BaudRate, ErrorKind, Rate, Sensor, State, Window};
use urg_emulator::{Emulator, Fault, Faults, Pace};

pub(crate) async fn open(emulator: &Emulator) -> Sensor {
    builder().connect(emulator.clone()).await.unwrap()
}

#[tokio::test(start_paused = true)]
async fn a_stream_continues_after_a_replug() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    let state = sensor.watch_state();
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    emulator.unplug();
    let error = loop {
        if let Err(error) = stream.next().await.unwrap() {
            break error;
        }
    };
    assert!(matches!(error.kind(), ErrorKind::Disconnected { .. }), "{error:?}");
    assert!(matches!(state.get(), State::Disconnected { .. }));
    tokio::time::sleep(Duration::from_secs(60)).await;
    let late = sensor.scans(Window::FULL, Rate::hz(1.0)).await;
    let mut late = late.unwrap();
    assert!(matches!(late.next().await, Some(Err(_))), "a new stream does not report the loss");

    emulator.plug_in();
    let start = Instant::now();
    let scan = stream.next().await.unwrap().unwrap();
    assert!(start.elapsed() < Duration::from_secs(2), "{:?}", start.elapsed());
    Truth::from_log(&emulator.log()).check(&scan).unwrap();
    assert!(scan.sequence() >= 1);
    late.next().await.unwrap().unwrap();
    let stats = sensor.stats();
    assert_eq!((stats.disconnects, stats.reconnects), (1, 1));
    assert!(stats.polls_skipped < 10, "a minute without a link counts as skipped polls: {stats:?}");
}

#[tokio::test(start_paused = true)]
async fn a_new_stream_learns_that_the_sensor_is_silent() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    emulator.set_faults(Faults::none().every(Fault::Lost));
    sensor.scan(Window::DETECTION).await.unwrap_err();
    let mut state = sensor.watch_state();
    state.wait_for(|state| matches!(state, State::Recovering)).await.map(drop).unwrap();
    for is_replugged in [false, true] {
        if is_replugged {
            emulator.unplug();
            let lost = |state: &State| matches!(state, State::Disconnected { .. });
            state.wait_for(lost).await.map(drop).unwrap();
            emulator.plug_in();
            while !emulator.is_connected() {
                tokio::time::sleep(ms(1)).await;
            }
        }
        let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
        let item = futures::FutureExt::now_or_never(stream.next());
        assert!(matches!(item, Some(Some(Err(_)))), "{item:?} {is_replugged}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_refused_baud_rate_fails_only_opening() {
    let (slow, fast) = (BaudRate::B19200, BaudRate::B115200);
    let emulator = truthful().baud_rate(slow).build();
    // Five replies precede it: to a fence at the wrong baud rate and to one at the right one, to
    // two `V` and another fence.
    emulator.set_faults(Faults::none().at(5, Fault::Status(b'1')));
    let error = builder().baud_rate(fast).connect(emulator.clone()).await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Refused { .. }), "{error:?}");

    let sensor = builder().baud_rate(fast).connect(emulator.clone()).await.unwrap();
    let mut state = sensor.watch_state();
    emulator.unplug();
    state.wait_for(|state| matches!(state, State::Disconnected { .. })).await.map(drop).unwrap();
    emulator.power_cycle();
    // The serial number is known now: one `V` is enough.
    emulator.set_faults(Faults::none().at(4, Fault::Status(b'1')));
    emulator.plug_in();
    let connected = state.wait_for(|state| matches!(state, State::Connected { .. }));
    assert_eq!(connected.await.unwrap().baud_rate(), Some(slow));
    sensor.scan(Window::DETECTION).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn d03_a10_an_hour_unplugged_costs_little() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    emulator.unplug();
    for _ in 0..10 {
        let start = Instant::now();
        let error = sensor.scan(Window::FULL).await.unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::NoSuchPort { .. }), "{error:?}");
        assert!(start.elapsed() <= ms(5001), "{:?}", start.elapsed());
    }
    tokio::time::sleep(Duration::from_secs(3600)).await;
    emulator.plug_in();
    sensor.scan(Window::FULL).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a10_a_request_survives_a_short_outage() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    emulator.unplug();
    let asked = tokio::spawn({
        let sensor = sensor.clone();
        async move { sensor.scan(Window::FULL).await }
    });
    tokio::time::sleep(ms(2000)).await;
    emulator.plug_in();
    asked.await.unwrap().unwrap();
}

#[tokio::test(start_paused = true)]
async fn d01_d02_baud_rate_and_laser_are_restored_after_a_reset() {
    let emulator = truthful().baud_rate(BaudRate::B19200).boot_time(Duration::from_secs(2)).build();
    let sensor = open(&emulator).await;
    sensor.set_baud_rate(BaudRate::B115200).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(5.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    emulator.power_cycle();
    let start = Instant::now();
    let mut errors = Vec::new();
    let scan = loop {
        match stream.next().await.unwrap() {
            Ok(scan) if scan.times().requested_at > start => break scan,
            Ok(_) => {}
            Err(error) => errors.push(error),
        }
    };
    assert_eq!(scan.len(), 682);
    assert!(!errors.is_empty());
    assert_eq!(emulator.baud_rate(), Some(BaudRate::B115200));
    // Two seconds of boot, and at most five until it is found.
    assert!(start.elapsed() < Duration::from_secs(7), "{:?}", start.elapsed());

    sensor.laser_off().await.unwrap();
    emulator.power_cycle();
    assert!(emulator.is_laser_on());
    // Nothing is polled, so the loss is detected at the next request.
    tokio::time::sleep(Duration::from_secs(10)).await;
    let _ = sensor.set_baud_rate(BaudRate::B57600).await;
    sensor.set_baud_rate(BaudRate::B57600).await.unwrap();
    assert!(!emulator.is_laser_on());
}

#[tokio::test(start_paused = true)]
async fn d02_a_laser_that_was_switched_off_stays_off_after_a_replug() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    sensor.laser_off().await.unwrap();
    emulator.unplug();
    emulator.power_cycle();
    assert!(emulator.is_laser_on());
    emulator.plug_in();
    let mut state = sensor.watch_state();
    state.wait_for(|state| matches!(state, State::Disconnected { .. })).await.unwrap();
    state.wait_for(|state| matches!(state, State::Connected { .. })).await.unwrap();
    assert!(!emulator.is_laser_on());
    let scans = emulator.counts().scans;
    tokio::time::sleep(Duration::from_secs(10)).await;
    assert_eq!(emulator.counts().scans, scans);
    sensor.laser_on().await.unwrap();
    while stream.next().await.unwrap().is_err() {}
}

#[tokio::test(start_paused = true)]
async fn without_reconnecting_a_lost_link_ends_the_driver() {
    let emulator = truthful().build();
    let sensor = builder().reconnect(false).connect(emulator.clone()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    emulator.unplug();
    let mut last = None;
    while let Some(item) = stream.next().await {
        assert!(last.is_none());
        last = item.err();
    }
    assert!(matches!(last.unwrap().kind(), ErrorKind::Disconnected { .. }));
    assert!(matches!(
        sensor.scan(Window::FULL).await.unwrap_err().kind(),
        ErrorKind::Disconnected { .. }
    ));
    let State::Closed { error: Some(error) } = sensor.watch_state().get() else {
        panic!("no cause")
    };
    assert!(matches!(error.kind(), ErrorKind::Disconnected { .. }), "{error:?}");
}

#[tokio::test(start_paused = true)]
async fn the_end_of_an_attached_stream_ends_the_driver() {
    let emulator = truthful().build();
    let sensor = builder().attach(emulator.link()).await.unwrap();
    sensor.scan(Window::FULL).await.unwrap();
    emulator.unplug();
    let error = sensor.scan(Window::FULL).await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Disconnected { .. }), "{error:?}");
}

#[tokio::test(start_paused = true)]
async fn a_silent_sensor_is_found_on_its_port() {
    for speed in [None, Some(BaudRate::B115200)] {
        let mut sensor_builder = truthful();
        if let Some(speed) = speed {
            sensor_builder = sensor_builder.baud_rate(speed);
        }
        let emulator = sensor_builder.build();
        let sensor = open(&emulator).await;
        let mut stream = sensor.scans(Window::DETECTION, Rate::hz(5.0)).await.unwrap();
        stream.next().await.unwrap().unwrap();
        emulator.set_faults(Faults::none().every(Fault::CommandLost));
        tokio::time::sleep(Duration::from_secs(30)).await;
        emulator.set_faults(Faults::none());
        let start = Instant::now();
        while stream.next().await.unwrap().is_err() {}
        let limit = if speed.is_some() { 5 } else { 2 };
        assert!(start.elapsed() < Duration::from_secs(limit), "{speed:?}: {:?}", start.elapsed());
    }
}

#[tokio::test(start_paused = true)]
async fn a_stream_that_joins_another_without_a_link_reports_the_loss() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    let mut first = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    first.next().await.unwrap().unwrap();
    emulator.unplug();
    while first.next().await.unwrap().is_ok() {}
    let mut second = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let item = tokio::time::timeout(ms(100), second.next()).await;
    let error = item.unwrap().unwrap().unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Disconnected { .. }), "{error:?}");
    // The first stream has reported the loss before.
    assert!(tokio::time::timeout(Duration::from_secs(60), first.next()).await.is_err());
}

#[tokio::test(start_paused = true)]
async fn version_fails_while_there_is_no_sensor() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    emulator.unplug();
    let mut state = sensor.watch_state();
    state.wait_for(|state| matches!(state, State::Disconnected { .. })).await.unwrap();
    // It answers the fence and `V`, but is not the sensor.
    emulator.set_serial_number("H0000002");
    emulator.plug_in();
    tokio::time::sleep(Duration::from_secs(10)).await;
    assert!(matches!(state.get(), State::Disconnected { .. }));
    assert!(sensor.version().await.is_err());
}

#[tokio::test(start_paused = true)]
async fn queued_requests_survive_two_short_outages() {
    let emulator = truthful().baud_rate(BaudRate::B19200).build();
    let sensor = open(&emulator).await;
    let requests = (0..120).map(|_| {
        let sensor = sensor.clone();
        tokio::spawn(async move { sensor.scan(Window::DETECTION).await })
    });
    let requests: Vec<_> = requests.collect();
    // Half of them are answered, and the others have waited for longer than the request timeout.
    for seconds in [45, 10] {
        tokio::time::sleep(Duration::from_secs(seconds)).await;
        emulator.unplug();
        tokio::time::sleep(ms(20)).await;
        emulator.plug_in();
    }
    let mut failed = 0;
    for request in requests {
        failed += usize::from(request.await.unwrap().is_err());
    }
    assert_eq!(failed, 2, "all but the two on the wire succeed");
}

#[tokio::test(start_paused = true)]
async fn a_flapping_link_is_reopened_with_pauses() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    let mut state = sensor.watch_state();
    let (end, mut times) = (Instant::now() + Duration::from_secs(60), 0);
    let connected = |state: &State| matches!(state, State::Connected { .. });
    while tokio::time::timeout_at(end, state.wait_for(connected)).await.is_ok() {
        times += 1;
        emulator.unplug();
        emulator.plug_in();
        let _ = tokio::time::timeout_at(end, state.wait_for(|state| !connected(state))).await;
    }
    assert!((50..=100).contains(&times), "{times} times a minute");
    // After a link that has lasted for a while, the wait is the shortest again.
    emulator.plug_in();
    tokio::time::sleep(Duration::from_secs(10)).await;
    let start = Instant::now();
    emulator.unplug();
    emulator.plug_in();
    sensor.scan(Window::FULL).await.unwrap();
    assert!(start.elapsed() < ms(400), "{:?}", start.elapsed());
}

#[tokio::test(start_paused = true)]
async fn closing_and_subscribing_need_no_link_and_never_expire() {
    let emulator = truthful().build();
    let sensor = builder().request_timeout(Duration::ZERO).connect(emulator.clone()).await.unwrap();
    emulator.unplug();
    let error = sensor.scan(Window::FULL).await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Disconnected { .. }), "{error:?}");
    let mut stream = sensor.scans(Window::FULL, Rate::UNLIMITED).await.unwrap();
    assert!(matches!(
        stream.next().await.unwrap().unwrap_err().kind(),
        ErrorKind::Disconnected { .. }
    ));
    sensor.close().await;
    assert!(matches!(sensor.watch_state().get(), State::Closed { error: None }));
    assert!(stream.next().await.is_none());
}

#[tokio::test(start_paused = true)]
async fn an_abandoned_close_closes_nothing() {
    let emulator = truthful().build();
    let sensor = open(&emulator).await;
    emulator.unplug();
    let mut state = sensor.watch_state();
    state.wait_for(|state| matches!(state, State::Disconnected { .. })).await.unwrap();
    // Dropped while it is queued.
    assert!(futures::FutureExt::now_or_never(sensor.close()).is_none());
    tokio::time::sleep(ms(5000)).await;
    emulator.plug_in();
    sensor.scan(Window::FULL).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_visible_reset_leaves_no_laser_on() {
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    let _stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    sensor.laser_off().await.unwrap();
    let scans = emulator.counts().scans;
    emulator.power_cycle();
    assert!(emulator.is_laser_on());
    // Powering up leaves a break on the line; no command is sent.
    emulator.inject(b"\0".as_slice());
    tokio::time::sleep(ms(1000)).await;
    assert!(!emulator.is_laser_on());
    // Fences count as scans: one follows the break, others confirm the laser.
    assert!(emulator.counts().scans - scans <= 2);
}

#[tokio::test(start_paused = true)]
async fn t12_no_fence_is_sent_again_after_a_reconnect() {
    // The system keeps what arrives while a port is closed: a reply to a fence of the last
    // session must not match one of the next session.
    let emulator = truthful().pace(Pace::AtOnce).build();
    let sensor = open(&emulator).await;
    for _ in 0..3 {
        emulator.set_faults(Faults::none().every(Fault::Lost).at(0, Fault::HangUp(9)));
        let _ = sensor.scan(Window::FULL).await;
        emulator.set_faults(Faults::none());
        sensor.scan(Window::FULL).await.unwrap();
    }
    assert!(sensor.stats().disconnects >= 3, "{:?}", sensor.stats());
    let fences: Vec<Vec<u8>> = emulator.log().into_iter().map(|line| line.line).collect();
    let fences: Vec<_> =
        fences.iter().filter(|line| line.len() == 9 && line[1..4] == line[4..7]).collect();
    let different: std::collections::HashSet<_> = fences.iter().collect();
    assert!(fences.len() >= 4, "{fences:?}");
    assert_eq!(different.len(), fences.len());
}
