//! Freshness, depth and late subscription: the needs of an unattended service.

use std::future::ready;
use std::time::Duration;

use futures::{FutureExt, StreamExt};
use tokio::time::{Instant, sleep};
use tokio_scip::{ErrorChain, ErrorKind, Rate, Sensor, State, Window};
use urg_emulator::{Emulator, Fault, Faults};

use crate::common::{builder, reason};

const LIMIT: Duration = Duration::from_millis(500);
const WINDOW: Window = Window::DETECTION;

pub(crate) async fn sensor(emulator: &Emulator) -> Sensor {
    builder().connect(emulator.clone()).await.unwrap()
}

#[tokio::test(start_paused = true)]
async fn malformed_replies_leave_the_state_connected_and_the_scans_stale() {
    let emulator = Emulator::builder().build();
    let sensor = sensor(&emulator).await;
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    let none = sensor.freshness().check(LIMIT).unwrap_err();
    assert_eq!(none.to_string(), "expected a scan within 500.0ms, but none has arrived yet");
    assert!(none.age.is_none());
    let scan = stream.next().await.unwrap().unwrap();
    for freshness in [sensor.freshness(), stream.freshness()] {
        let age = scan.received_at().elapsed();
        assert_eq!(freshness.age(), Some(age));
        assert!(freshness.check(LIMIT).is_ok() && freshness.check(age).is_ok());
        sleep(Duration::from_nanos(1)).await;
        assert!(freshness.check(age).is_err(), "older than the limit");
    }

    emulator.set_faults(Faults::none().every(Fault::Flip(700, 0x80)));
    sleep(Duration::from_secs(5)).await;
    let state = sensor.watch_state().get();
    assert!(matches!(state, State::Connected { .. }), "{state:?}");
    for freshness in [sensor.freshness(), stream.freshness()] {
        let stale = freshness.check(LIMIT).unwrap_err();
        assert!(stale.age.unwrap() > Duration::from_secs(4), "{stale}");
        let text = ErrorChain(&stale).to_string();
        let begins = "expected a scan within 500.0ms, but the last one is 5.0s old: the reply of the \
                      sensor to G";
        assert!(text.starts_with(begins), "{text}");
        assert_eq!(format!("{stale:?}"), text);
    }

    emulator.set_faults(Faults::none());
    sleep(Duration::from_secs(1)).await;
    assert!(sensor.freshness().check(LIMIT).is_ok() && stream.freshness().check(LIMIT).is_ok());
}

#[tokio::test(start_paused = true)]
async fn freshness_says_why_scans_are_missing() {
    let emulator = Emulator::builder().build();
    let sensor = sensor(&emulator).await;
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    sensor.laser_off().await.unwrap();
    sleep(Duration::from_secs(2)).await;
    for freshness in [sensor.freshness(), stream.freshness()] {
        assert!(matches!(reason(&freshness).kind(), ErrorKind::LaserOff), "{freshness:?}");
    }
    sensor.laser_on().await.unwrap();
    sleep(Duration::from_secs(1)).await;
    assert!(stream.freshness().check(LIMIT).is_ok());
    emulator.unplug();
    sleep(Duration::from_secs(2)).await;
    for freshness in [sensor.freshness(), stream.freshness()] {
        let text = ErrorChain(&freshness.check(LIMIT).unwrap_err()).to_string();
        assert!(text.contains("no port") || text.contains("is lost"), "{text}");
    }
    sensor.close().await;
    assert!(matches!(reason(&sensor.freshness()).kind(), ErrorKind::Closed));
}

#[tokio::test(start_paused = true)]
async fn a_recorder_and_a_loop_share_polls() {
    let emulator = Emulator::builder().build();
    let sensor = sensor(&emulator).await;
    let rate = Rate::hz(10.0);
    let mut all = sensor.scans(WINDOW, rate).depth(100).await.unwrap();
    let mut newest = sensor.scans(WINDOW, rate).await.unwrap();
    sleep(Duration::from_secs(5)).await;
    assert_eq!(sensor.stats().schedules.len(), 1);
    let latest = newest.latest().unwrap();
    assert_eq!(newest.next().await.unwrap().unwrap(), latest);
    // It may have been opened after the first scan.
    assert!(newest.missed() + 1 >= latest.sequence(), "{}", newest.missed());
    for sequence in 0..=latest.sequence() {
        assert_eq!(all.next().await.unwrap().unwrap().sequence(), sequence);
    }
    assert_eq!(all.missed(), 0);
    assert!(all.next().now_or_never().is_none(), "nothing is new");
}

#[tokio::test(start_paused = true)]
async fn a_kept_stream_passes_on_no_old_error() {
    let emulator = Emulator::builder().build();
    let sensor = sensor(&emulator).await;
    let kept = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    kept.resubscribe().next().await.unwrap().unwrap();
    emulator.unplug();
    sleep(Duration::from_secs(1)).await;
    // The current error is reported, even to a new stream.
    let during = kept.resubscribe().next().await.unwrap().unwrap_err();
    assert!(matches!(during.kind(), ErrorKind::Disconnected { .. }), "{during:?}");
    emulator.plug_in();
    sleep(Duration::from_secs(20)).await;
    let asked = Instant::now();
    let mut late = kept.resubscribe();
    let scan = late.next().await.unwrap().unwrap();
    assert!(scan.received_at() >= asked, "an old scan");
    assert_eq!((late.missed(), sensor.stats().missed), (0, 0));
    assert!(kept.clone().next().await.unwrap().is_err(), "a clone has the place of its original");
}

#[tokio::test(start_paused = true)]
async fn the_first_scan_after_reconnecting_is_marked() {
    let emulator = Emulator::builder().build();
    let sensor = sensor(&emulator).await;
    let stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    let mut stream = stream.filter_map(|item| ready(item.ok()));
    assert_eq!(stream.next().await.unwrap().reconnects(), 0);
    for reconnects in 1..=3 {
        emulator.unplug();
        sleep(Duration::from_secs(2)).await;
        emulator.plug_in();
        // A slow consumer: the very first scan is overwritten.
        sleep(Duration::from_secs(10)).await;
        let scan = stream.next().await.unwrap();
        assert_eq!((scan.reconnects(), sensor.stats().reconnects), (reconnects, reconnects));
        assert_eq!(stream.next().await.unwrap().reconnects(), reconnects);
    }
    assert_eq!(sensor.scan(WINDOW).await.unwrap().reconnects(), 3);
}

#[tokio::test(start_paused = true)]
async fn early_streams_begin_with_a_scan() {
    let emulator = Emulator::builder().build();
    emulator.unplug();
    let (sensor, driver) = builder().wait_for_sensor(true).build(emulator.clone());
    tokio::spawn(driver);
    let mut streams = Vec::new();
    for _ in 0..3 {
        streams.push(sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap());
        sleep(Duration::from_secs(1)).await;
    }
    let error = reason(&streams[0].freshness());
    assert!(matches!(error.kind(), ErrorKind::NoSuchPort { .. }), "{error:?}");
    emulator.plug_in();
    for mut stream in streams {
        let first = stream.next().await.unwrap();
        assert!(first.is_ok(), "{first:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn opening_a_stream_disturbs_no_other() {
    let emulator = Emulator::builder().build();
    let sensor = sensor(&emulator).await;
    let mut first = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    first.next().await.unwrap().unwrap();
    emulator.unplug();
    while first.next().await.unwrap().is_ok() {}
    // The port is gone, which is another error than the loss of the link.
    sleep(Duration::from_secs(5)).await;
    let mut second = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    assert!(second.next().await.unwrap().is_err());
    let item = first.next().now_or_never();
    assert!(item.is_none(), "{item:?}");
}

#[tokio::test(start_paused = true)]
async fn a_laser_switched_on_is_no_reason() {
    let emulator = Emulator::builder().build();
    let sensor = sensor(&emulator).await;
    let slow = sensor.scans(WINDOW, Rate::every(Duration::from_secs(60))).await.unwrap();
    sensor.laser_off().await.unwrap();
    emulator.unplug();
    emulator.plug_in();
    sleep(Duration::from_secs(10)).await;
    for freshness in [sensor.freshness(), slow.freshness()] {
        assert!(matches!(reason(&freshness).kind(), ErrorKind::LaserOff), "{freshness:?}");
    }
    sensor.laser_on().await.unwrap();
    for freshness in [sensor.freshness(), slow.freshness()] {
        assert!(!matches!(reason(&freshness).kind(), ErrorKind::LaserOff), "{freshness:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_stream_reports_only_its_own_timeouts() {
    let emulator = Emulator::builder().build();
    let sensor = sensor(&emulator).await;
    let mut slow = sensor.scans(WINDOW, Rate::every(Duration::from_secs(60))).await.unwrap();
    slow.next().await.unwrap().unwrap();
    let mut fast = sensor.scans(Window::FULL, Rate::hz(5.0)).await.unwrap();
    fast.next().await.unwrap().unwrap();
    emulator.set_faults(Faults::none().at(0, Fault::Lost));
    let lost = fast.next().await.unwrap().unwrap_err();
    assert!(matches!(lost.kind(), ErrorKind::Timeout { .. }), "{lost:?}");
    assert!(matches!(reason(&sensor.freshness()).kind(), ErrorKind::Timeout { .. }));
    let late = slow.freshness().check(Duration::ZERO).unwrap_err();
    assert!(late.source.is_none(), "{late:?}");
}

#[tokio::test(start_paused = true)]
async fn the_debug_text_of_a_deep_stream_is_short() {
    let emulator = Emulator::builder().build();
    let sensor = sensor(&emulator).await;
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).depth(100).await.unwrap();
    stream.next().await.unwrap().unwrap();
    sleep(Duration::from_secs(15)).await;
    for text in [format!("{stream:?}"), format!("{sensor:?}")] {
        assert!(text.len() < 6000, "{}", text.len());
    }
}
