//! The rate that a schedule reaches, as the statistics report it.

use std::str::FromStr;
use std::time::Duration;

use crate::common::random::Random;
use crate::common::{builder, reply_len, truthful, wire_time};
use tokio::time::sleep;
use tokio_scip::protocol::Protocol;
use tokio_scip::{BaudRate, Rate, ScanStream, Sensor, SensorBuilder, State, Window};
use urg_emulator::{Emulator, Fault, Faults, Firmware, Pace};

/// Opens a sensor, and a stream that reaches its rate.
async fn streaming(builder: SensorBuilder) -> (Emulator, Sensor, ScanStream) {
    let emulator = truthful().build();
    let sensor = builder.connect(emulator.clone()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    assert_eq!(reached(&sensor), None, "before three seconds");
    for _ in 0..40 {
        stream.next().await.unwrap().unwrap();
    }
    assert!(reached(&sensor) > Some(9.0), "{:?}", sensor.stats());
    (emulator, sensor, stream)
}

fn reached(sensor: &Sensor) -> Option<f64> {
    sensor.stats().schedules[0].reached
}

async fn wait_for(sensor: &Sensor, is_state: impl FnMut(&State) -> bool) {
    sensor.watch_state().wait_for(is_state).await.map(drop).unwrap();
}

#[tokio::test(start_paused = true)]
async fn it_is_unknown_while_the_link_is_lost() {
    let (emulator, sensor, _stream) = streaming(builder()).await;
    emulator.unplug();
    wait_for(&sensor, |state| matches!(state, State::Disconnected { .. })).await;
    assert_eq!(reached(&sensor), None);
    emulator.plug_in();
    sleep(Duration::from_secs(10)).await;
    assert!(reached(&sensor) > Some(9.0));
}

#[tokio::test(start_paused = true)]
async fn a_silent_sensor_has_no_known_rate() {
    let (emulator, sensor, _stream) = streaming(builder()).await;
    emulator.set_faults(Faults::none().every(Fault::Lost));
    wait_for(&sensor, |state| matches!(state, State::Recovering)).await;
    assert_eq!(reached(&sensor), None);
}

#[tokio::test(start_paused = true)]
async fn it_is_unknown_after_the_driver_ended() {
    let (emulator, sensor, _stream) = streaming(builder().reconnect(false)).await;
    emulator.unplug();
    wait_for(&sensor, |state| matches!(state, State::Closed { .. })).await;
    assert_eq!(reached(&sensor), None);
}

#[tokio::test(start_paused = true)]
async fn it_is_unknown_after_the_driver_was_closed() {
    let (_emulator, sensor, _stream) = streaming(builder()).await;
    sensor.close().await;
    assert_eq!(reached(&sensor), None);
}

#[tokio::test(start_paused = true)]
async fn it_is_unknown_after_the_driver_was_dropped() {
    let (sensor, driver) = builder().build(truthful().build());
    let driver = tokio::spawn(driver);
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    for _ in 0..40 {
        stream.next().await.unwrap().unwrap();
    }
    driver.abort();
    assert!(driver.await.unwrap_err().is_cancelled());
    assert_eq!(reached(&sensor), None);
}

#[tokio::test(start_paused = true)]
async fn it_is_unknown_while_the_laser_is_off() {
    let (_emulator, sensor, _stream) = streaming(builder()).await;
    sensor.laser_off().await.unwrap();
    assert_eq!(reached(&sensor), None);
    sleep(Duration::from_secs(60)).await;
    sensor.laser_on().await.unwrap();
    sleep(Duration::from_secs(1)).await;
    assert_eq!(reached(&sensor), None, "before three seconds");
    sleep(Duration::from_secs(10)).await;
    assert!(reached(&sensor) > Some(9.0));
}

#[tokio::test(start_paused = true)]
async fn damaged_replies_are_polled_once_a_revolution() {
    let emulator = truthful().usb().pace(Pace::AtOnce).build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    emulator.set_faults(Faults::none().every(Fault::Drop(100..101)));
    let _stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    sleep(Duration::from_secs(20)).await;
    let polls = sensor.stats().polls;
    // 200 revolutions.
    assert!((180..=210).contains(&polls), "{polls}");
}

/// Number of bytes of a poll and its reply.
fn bytes(protocol: Protocol, window: Window) -> usize {
    let lines = |characters: usize| characters + 2 * characters.div_ceil(64);
    match protocol {
        Protocol::Scip1 => 10 + reply_len(window),
        // A request and its echo with a text of eight characters; status, time, values, and an LF.
        Protocol::Scip2 => {
            2 * "GD0044072501;12345678\n".len()
                + lines(2)
                + lines(4)
                + lines(3 * window.points())
                + 1
        }
    }
}

/// Rate that a stream reaches on a line without faults, and why it is not the wanted one.
async fn measured(
    protocol: Protocol,
    (window, rate, baud_rate): (Window, Rate, BaudRate),
) -> (f64, Option<String>) {
    let emulator = truthful().firmware(Firmware::V31).baud_rate(baud_rate).build();
    let sensor = builder().protocol(protocol).connect(emulator).await.unwrap();
    let _stream = sensor.scans(window, rate).await.unwrap();
    sleep(Duration::from_secs(15)).await;
    let schedule = sensor.stats().schedules[0];
    (schedule.reached.unwrap(), schedule.explanation())
}

/// Number that follows or precedes `word` in the sentence that explains a rate.
fn advised<T: FromStr>(why: &str, word: &str) -> Option<T> {
    let words: Vec<_> = why.split([' ', ',']).collect();
    let at = words.iter().rposition(|found| *found == word)?;
    let number = if word == "of" { at + 1 } else { at - 1 };
    words.get(number)?.parse().ok()
}

#[tokio::test(start_paused = true)]
async fn what_a_line_needs_for_a_rate_suffices() {
    let (mut random, mut explained) = (Random::new(1), [0; 2]);
    for (case, protocol) in [Protocol::Scip1, Protocol::Scip2].repeat(60).into_iter().enumerate() {
        let steps = 44 + random.below(300) as u16..=725 - random.below(300) as u16;
        let window =
            Window::new(steps).unwrap().with_cluster_count(1 + random.below(3) as u8).unwrap();
        let baud_rate = *random.pick(&BaudRate::ALL);
        let rate = Rate::hz(0.5 + 0.1 * random.below(96) as f64);
        let took = wire_time(baud_rate, bytes(protocol, window));
        let said = window.wire_time(baud_rate, protocol);
        assert!(said.abs_diff(took) < Duration::from_nanos(10), "{said:?} {took:?}");
        let asked = (window, rate, baud_rate);
        let (reached, why) = measured(protocol, asked).await;
        let why = why.unwrap_or_default();
        if why.is_empty() {
            // One scan in the three seconds of a span may be too much or too little.
            assert!(rate.is_reached_by(reached + 1.0 / 3.0), "{protocol} {asked:?} {reached}");
            continue;
        }
        let beginning = format!("a scan takes {} ms at {baud_rate} baud. ", took.as_millis());
        assert!(why.starts_with(&beginning), "{protocol} {asked:?} {why}");
        explained[case % 2] += 1;
        let advised = [
            advised(&why, "baud").map(|faster| (window, rate, faster)),
            advised(&why, "of")
                .map(|count| (window.with_cluster_count(count).unwrap(), rate, baud_rate)),
        ];
        for asked in advised.into_iter().flatten().filter(|other| *other != asked) {
            let (reached, again) = measured(protocol, asked).await;
            assert_eq!(again, None, "{protocol} {asked:?} {reached}: {why}");
        }
    }
    assert!(explained.iter().all(|count| *count > 5), "{explained:?}");
}

/// The first scan comes at the beginning of the first span.
#[tokio::test(start_paused = true)]
async fn a_slow_stream_is_not_counted_as_faster_than_it_is() {
    for period in [1.0, 3.5, 8.0, 30.0] {
        let sensor = builder().connect(truthful().build()).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::hz(1.0 / period)).await.unwrap();
        for scans in 1..8 {
            stream.next().await.unwrap().unwrap();
            sleep(Duration::from_millis(10)).await;
            let hz = reached(&sensor).unwrap_or(1.0 / period);
            assert!((hz * period - 1.0).abs() < 0.1, "{scans} scans, each {period} s: {hz}");
        }
    }
}
