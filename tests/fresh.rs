//! Freshness, depth, late subscription and names: the needs of an unattended service.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::time::{Instant, sleep};
use tokio_scip::emulator::{Emulator, Fault, Faults};
use tokio_scip::{Error, ErrorChain, Rate, Sensor, State, Window};
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Metadata, Subscriber};

use crate::common::builder;

const LIMIT: Duration = Duration::from_millis(500);
const WINDOW: Window = Window::DETECTION;

async fn sensor(emulator: &Emulator) -> Sensor {
    builder().connect(emulator.clone()).await.unwrap()
}

#[tokio::test(start_paused = true)]
async fn malformed_replies_leave_the_state_connected_and_the_scans_stale() {
    let emulator = Emulator::builder().build();
    let sensor = sensor(&emulator).await;
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    assert!(sensor.freshness().check(LIMIT).unwrap_err().age.is_none());
    let scan = stream.next().await.unwrap().unwrap();
    for freshness in [sensor.freshness(), stream.freshness()] {
        assert_eq!(freshness.last_scan(), Some(scan.received_at()));
        assert!(freshness.check(LIMIT).is_ok() && freshness.error().is_none());
    }

    emulator.set_faults(Faults::none().every(Fault::Flip(700, 0x80)));
    sleep(Duration::from_secs(5)).await;
    let state = sensor.state().borrow().clone();
    assert!(matches!(state, State::Connected { .. }), "{state:?}");
    for freshness in [sensor.freshness(), stream.freshness()] {
        let stale = freshness.check(LIMIT).unwrap_err();
        assert!(stale.age.unwrap() > Duration::from_secs(4), "{stale}");
        let text = ErrorChain::new(&stale).to_string();
        assert!(text.contains("the reply to G") && text.contains("expected"), "{text}");
    }

    emulator.set_faults(Faults::none());
    sleep(Duration::from_secs(1)).await;
    assert!(sensor.freshness().check(LIMIT).is_ok() && stream.freshness().check(LIMIT).is_ok());
}

#[tokio::test(start_paused = true)]
async fn freshness_has_the_reason_while_the_laser_is_off_the_link_lost_and_the_driver_gone() {
    let emulator = Emulator::builder().build();
    let sensor = sensor(&emulator).await;
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    sensor.laser_off().await.unwrap();
    sleep(Duration::from_secs(2)).await;
    for freshness in [sensor.freshness(), stream.freshness()] {
        assert!(matches!(freshness.error(), Some(Error::LaserOff)), "{freshness:?}");
    }
    sensor.laser_on().await.unwrap();
    sleep(Duration::from_secs(1)).await;
    assert!(stream.freshness().check(LIMIT).is_ok());
    emulator.unplug();
    sleep(Duration::from_secs(2)).await;
    for freshness in [sensor.freshness(), stream.freshness()] {
        let text = ErrorChain::new(&freshness.check(LIMIT).unwrap_err()).to_string();
        assert!(text.contains("no port") || text.contains("is lost"), "{text}");
    }
    sensor.close().await;
    assert!(matches!(sensor.freshness().error(), Some(Error::Closed)));
}

#[tokio::test(start_paused = true)]
async fn a_recorder_that_wants_all_and_a_loop_that_wants_the_newest_share_the_polls() {
    let emulator = Emulator::builder().build();
    let sensor = sensor(&emulator).await;
    let rate = Rate::hz(10.0);
    let mut all = sensor.stream(WINDOW, rate).depth(100).open().await.unwrap();
    let mut newest = sensor.scans(WINDOW, rate).await.unwrap();
    sleep(Duration::from_secs(5)).await;
    assert_eq!(sensor.stats().schedules.len(), 1);
    let latest = newest.latest().unwrap();
    assert_eq!(newest.next().await.unwrap().unwrap(), latest);
    // It may have been opened after the first scan.
    assert!(newest.missed() + 1 >= latest.sequence(), "{}", newest.missed());
    for sequence in 0..=latest.sequence() {
        assert_eq!(all.next_if_ready().unwrap().unwrap().sequence(), sequence);
    }
    assert_eq!(all.missed(), 0);
    assert!(all.next_if_ready().is_none(), "nothing is new");
}

#[tokio::test(start_paused = true)]
async fn a_stream_kept_for_resubscribing_passes_on_no_old_error_and_misses_nothing() {
    let emulator = Emulator::builder().build();
    let sensor = sensor(&emulator).await;
    let kept = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    kept.resubscribe().next().await.unwrap().unwrap();
    emulator.unplug();
    sleep(Duration::from_secs(1)).await;
    // The current error is reported, even to a new stream.
    let during = kept.resubscribe().next().await.unwrap();
    assert!(matches!(during, Err(Error::Disconnected { .. })), "{during:?}");
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
async fn the_first_scan_after_a_reconnect_is_marked_also_if_scans_were_missed() {
    let emulator = Emulator::builder().build();
    let sensor = sensor(&emulator).await;
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap().only_scans();
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
async fn a_stream_opened_before_the_first_link_begins_with_the_reason_why_there_is_none() {
    let emulator = Emulator::builder().build();
    emulator.unplug();
    let (sensor, driver) = builder().wait_for_sensor().build(emulator.clone());
    tokio::spawn(driver);
    sleep(Duration::from_secs(1)).await;
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    let first = stream.next().await.unwrap();
    assert!(matches!(first, Err(Error::NoSuchPort { .. })), "{first:?}");
    emulator.plug_in();
    assert!(stream.next().await.unwrap().is_ok());
}

/// Collects log lines, each with its level and the fields of its spans.
#[derive(Clone, Default)]
struct Log(Arc<Mutex<Logged>>);

#[derive(Default)]
struct Logged {
    spans: Vec<(String, Option<Id>)>,
    entered: Vec<Id>,
    lines: Vec<(Level, String)>,
}

struct Text<'a>(&'a mut String);

impl Visit for Text<'_> {
    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        *self.0 += &format!(" {}={value:?}", field.name());
    }
}

impl Subscriber for Log {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        *metadata.level() <= Level::DEBUG
    }

    fn new_span(&self, span: &Attributes<'_>) -> Id {
        let mut text = span.metadata().name().to_owned();
        span.record(&mut Text(&mut text));
        let mut log = self.0.lock().unwrap();
        let parent = span
            .parent()
            .cloned()
            .or_else(|| log.entered.last().filter(|_| span.is_contextual()).cloned());
        log.spans.push((text, parent));
        Id::from_u64(log.spans.len() as u64)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn event(&self, event: &Event<'_>) {
        let mut log = self.0.lock().unwrap();
        let mut line = String::new();
        let mut span = log.entered.last().cloned();
        while let Some(id) = span {
            let (text, parent) = &log.spans[id.into_u64() as usize - 1];
            line = format!("{text}:{line}");
            span = parent.clone();
        }
        event.record(&mut Text(&mut line));
        log.lines.push((*event.metadata().level(), line));
    }

    fn enter(&self, span: &Id) {
        self.0.lock().unwrap().entered.push(span.clone());
    }

    fn exit(&self, _: &Id) {
        self.0.lock().unwrap().entered.pop();
    }
}

#[tokio::test(start_paused = true)]
async fn logs_and_errors_name_the_sensor_inside_the_span_of_its_user() {
    let log = Log::default();
    let _guard = crate::common::logs::collect(log.clone());
    let emulator = Emulator::builder().build();
    let (sensor, driver) = {
        let _entered = tracing::info_span!("line", number = 7).entered();
        builder().name("left").reconnect(false).build(emulator.clone())
    };
    tokio::spawn(driver);
    sensor.opened().await.unwrap();
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    emulator.unplug();
    let error = stream.next().await.unwrap().unwrap_err();
    assert_eq!(error.to_string(), "the link to left is lost");
    let log = log.0.lock().unwrap();
    let connected = log.lines.iter().find(|(_, line)| line.contains("connected")).unwrap();
    assert_eq!(connected.0, Level::INFO);
    assert!(connected.1.starts_with("line number=7:sensor name=left:"), "{}", connected.1);
    assert!(log.lines.iter().all(|(_, line)| line.contains("sensor name=left")), "{:?}", log.lines);
}

#[tokio::test(start_paused = true)]
async fn a_driver_that_waits_for_its_sensor_logs_once_and_then_every_ten_minutes() {
    let log = Log::default();
    let _guard = crate::common::logs::collect(log.clone());
    let emulator = Emulator::builder().build();
    emulator.unplug();
    let (_sensor, driver) = builder().name("left").wait_for_sensor().build(emulator.clone());
    tokio::spawn(driver);
    sleep(Duration::from_secs(3600 - 60)).await;
    let log = log.0.lock().unwrap();
    let is_waiting = |(level, line): &&(Level, String)| {
        *level == Level::INFO && line.contains("waiting for the sensor")
    };
    let waiting = log.lines.iter().filter(is_waiting).count();
    // Only at level debug and above, which the log collects.
    assert_eq!((waiting, log.lines.len()), (6, 6), "once, and every ten minutes: {:?}", log.lines);
}

#[tokio::test(start_paused = true)]
async fn the_log_of_a_search_on_an_open_port_counts_the_bytes_of_that_search_only() {
    let log = Log::default();
    let _guard = crate::common::logs::collect(log.clone());
    let emulator = Emulator::builder().build();
    let sensor = sensor(&emulator).await;
    sensor.scan(WINDOW).await.unwrap();
    let mut state = sensor.state();
    emulator.set_faults(Faults::none().every(Fault::Lost));
    drop(sensor.scan(WINDOW).await);
    state.wait_for(|state| matches!(state, State::Disconnected { .. })).await.map(drop).unwrap();
    let log = log.0.lock().unwrap();
    let search = log.lines.iter().find(|(_, line)| line.contains("was not found")).unwrap();
    assert!(!search.1.contains("bytes"), "the scan before it is counted: {}", search.1);
}

#[tokio::test(start_paused = true)]
async fn a_rate_that_is_not_reached_is_logged_with_its_reason() {
    for (faults, reason) in [
        (Faults::none(), "the line or the sensor cannot keep up"),
        (Faults::none().rate(0.5, Fault::Lost).seed(1), "replies are lost"),
    ] {
        let log = Log::default();
        let _guard = crate::common::logs::collect(log.clone());
        let emulator = Emulator::builder().revolution(Duration::from_millis(200)).build();
        let sensor = sensor(&emulator).await;
        emulator.set_faults(faults);
        let _stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
        sleep(Duration::from_secs(20)).await;
        let log = log.0.lock().unwrap();
        let is_warning = |(level, _): &&(Level, String)| *level == Level::WARN;
        let warnings: Vec<_> = log.lines.iter().filter(is_warning).collect();
        assert!(matches!(warnings[..], [(_, line)] if line.contains(reason)), "{warnings:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_spare_sensor_is_logged_and_the_same_sensor_is_not() {
    let log = Log::default();
    let _guard = crate::common::logs::collect(log.clone());
    let emulator = Emulator::builder().serial_number("H0000001").build();
    let sensor = builder().any_sensor().connect(emulator.clone()).await.unwrap();
    let mut state = sensor.state();
    let mut replug = async |serial_number: &str| {
        emulator.unplug();
        state
            .wait_for(|state| matches!(state, State::Disconnected { .. }))
            .await
            .map(drop)
            .unwrap();
        emulator.set_serial_number(serial_number);
        emulator.plug_in();
        state.wait_for(|state| matches!(state, State::Connected { .. })).await.map(drop).unwrap();
        let log = log.0.lock().unwrap();
        log.lines.iter().filter(|(_, line)| line.contains("another sensor")).count()
    };
    assert_eq!((replug("H0000001").await, replug("H0000002").await), (0, 1));
}
