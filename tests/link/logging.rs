//! What the driver logs, inside of which span, and how often.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::time::sleep;
use tokio_scip::{BaudRate, ErrorKind, Rate, State, Window};
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Metadata, Subscriber};
use urg_emulator::{Emulator, Fault, Faults};

use crate::common::{ConnectFn, builder};
use crate::polling::fresh::sensor;

const WINDOW: Window = Window::DETECTION;

/// Collects log lines, each with its level and the fields of its spans.
#[derive(Clone, Default)]
struct Log(Arc<Mutex<Logged>>);

#[derive(Default)]
struct Logged {
    spans: Vec<(String, Option<Id>)>,
    entered: Vec<Id>,
    lines: Vec<(Level, String)>,
}

struct LoggedFields<'a>(&'a mut String);

impl Visit for LoggedFields<'_> {
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
        span.record(&mut LoggedFields(&mut text));
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
        event.record(&mut LoggedFields(&mut line));
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
async fn logs_and_errors_name_the_sensor() {
    let log = Log::default();
    let _guard = crate::common::logs::collect(log.clone());
    let emulator = Emulator::builder().build();
    let (sensor, driver) = {
        let _entered = tracing::info_span!("line", number = 7).entered();
        builder().name("left").reconnect(false).build(emulator.clone())
    };
    tokio::spawn(driver);
    sensor.watch_state().connected().await.unwrap();
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    emulator.unplug();
    let error = stream.next().await.unwrap().unwrap_err();
    assert_eq!(error.to_string(), "the link to left is lost");
    let log = log.0.lock().unwrap();
    let connected = log.lines.iter().find(|(_, line)| line.contains("connected")).unwrap();
    assert_eq!(connected.0, Level::INFO);
    assert!(connected.1.starts_with("line number=7:sensor sensor=left:"), "{}", connected.1);
    assert!(
        log.lines.iter().all(|(_, line)| line.contains("sensor sensor=left")),
        "{:?}",
        log.lines
    );
}

#[tokio::test(start_paused = true)]
async fn a_waiting_driver_logs_every_ten_minutes() {
    let log = Log::default();
    let _guard = crate::common::logs::collect(log.clone());
    let emulator = Emulator::builder().build();
    emulator.unplug();
    let (_sensor, driver) = builder().name("left").wait_for_sensor(true).build(emulator.clone());
    tokio::spawn(driver);
    sleep(Duration::from_secs(3600 - 60)).await;
    let log = log.0.lock().unwrap();
    let is_waiting = |(level, line): &&(Level, String)| {
        *level == Level::INFO && line.contains("waiting for the sensor")
    };
    let waiting = log.lines.iter().filter(is_waiting).count();
    // The log collects level debug and above.
    assert_eq!((waiting, log.lines.len()), (6, 6), "once, and every ten minutes: {:?}", log.lines);
}

#[tokio::test(start_paused = true)]
async fn a_lost_link_is_logged_once_a_reason() {
    let log = Log::default();
    let _guard = crate::common::logs::collect(log.clone());
    let emulator = Emulator::builder().build();
    let (port, mut opened) = (emulator.clone(), 0);
    let connect = move || {
        opened += 1;
        let port = port.clone();
        match opened {
            1 => Ok(port.link()),
            n if n % 2 == 0 => Err(ErrorKind::NoSuchPort { port: "left".to_owned() }.into()),
            _ => Err(ErrorKind::PermissionDenied { port: "left".to_owned(), group: None }.into()),
        }
    };
    let sensor = builder().connect(ConnectFn(connect)).await.unwrap();
    emulator.unplug();
    sleep(Duration::from_secs(3600 - 60)).await;
    let state = sensor.watch_state().get();
    assert!(matches!(state, State::Disconnected { .. }));
    let log = log.0.lock().unwrap();
    let warnings = log.lines.iter().filter(|(level, _)| *level == Level::WARN).count();
    // The loss, and each of the two reasons.
    assert_eq!(warnings, 3);
}

/// Pulls the cable of a sensor for 0.2 s in each period, for a while. Returns the lines of the log
/// that say so: the warnings, the infos, and the others.
async fn flap(period: Duration, times: u32) -> [Vec<String>; 3] {
    let log = Log::default();
    let _guard = crate::common::logs::collect(log.clone());
    let emulator = Emulator::builder().build();
    let sensor = sensor(&emulator).await;
    for _ in 0..times {
        sleep(period - Duration::from_millis(200)).await;
        emulator.unplug();
        sleep(Duration::from_millis(200)).await;
        emulator.plug_in();
    }
    sleep(Duration::from_secs(5)).await;
    assert_eq!(sensor.stats().disconnects, u64::from(times));
    let log = log.0.lock().unwrap();
    [Level::WARN, Level::INFO, Level::DEBUG].map(|level| {
        let is_told = |(of, line): &&(Level, String)| {
            *of == level && (line.contains("=connected") || line.contains("is lost"))
        };
        log.lines.iter().filter(is_told).map(|(_, line)| line.clone()).collect()
    })
}

#[tokio::test(start_paused = true)]
async fn ever_fewer_losses_of_a_flapping_link_are_warnings() {
    let [warnings, infos, others] = flap(Duration::from_secs(2), 1800).await;
    // It warns after 0, 10, 30, 70, 150, 310, 630, 1270 and 2550 seconds.
    assert_eq!((warnings.len(), infos.len()), (9, 10), "{warnings:?}");
    assert!(others.len() >= 2 * (1800 - 9), "the others are at level debug");
    let counts = warnings.iter().filter_map(|line| line.split("losses=").nth(1)?.parse().ok());
    let (counts, least): (Vec<u32>, _) = (counts.collect(), (2550 - 30) / 2);
    assert!(counts.iter().sum::<u32>() >= least, "each says how many there were: {warnings:?}");
}

#[tokio::test(start_paused = true)]
async fn each_loss_of_a_steady_link_is_a_warning() {
    let [warnings, infos, others] = flap(Duration::from_secs(700), 10).await;
    assert_eq!((warnings.len(), infos.len(), others.len()), (10, 11, 0), "{others:?}");
    assert!(warnings.iter().all(|line| !line.contains("losses")), "{warnings:?}");
}

#[tokio::test(start_paused = true)]
async fn the_log_counts_bytes_of_one_search() {
    let log = Log::default();
    let _guard = crate::common::logs::collect(log.clone());
    let emulator = Emulator::builder().build();
    let sensor = sensor(&emulator).await;
    sensor.scan(WINDOW).await.unwrap();
    let mut state = sensor.watch_state();
    emulator.set_faults(Faults::none().every(Fault::Lost));
    drop(sensor.scan(WINDOW).await);
    state.wait_for(|state| matches!(state, State::Disconnected { .. })).await.map(drop).unwrap();
    let log = log.0.lock().unwrap();
    let search = log.lines.iter().find(|(_, line)| line.contains("was not found")).unwrap();
    assert!(!search.1.contains("bytes"), "the scan before it is counted: {}", search.1);
}

#[tokio::test(start_paused = true)]
async fn a_rate_that_is_not_reached_is_logged_with_its_reason() {
    let usb = || Emulator::builder().revolution(Duration::from_millis(200));
    let serial = || Emulator::builder().baud_rate(BaudRate::B19200);
    for (emulator, hz, faults, reason) in [
        (usb(), 10.0, Faults::none(), "the sensor answers no faster"),
        (usb(), 10.0, Faults::none().rate(0.5, Fault::Lost).seed(1), "polls brought no scan"),
        (
            serial(),
            10.0,
            Faults::none(),
            "a scan takes 733 ms at 19200 baud. What helps: fewer scans or steps, clusters of 9, \
             250000 baud",
        ),
        // No baud rate is fast enough.
        (serial(), 1000.0, Faults::none(), "What helps: fewer scans or steps "),
    ] {
        let log = Log::default();
        let _guard = crate::common::logs::collect(log.clone());
        let emulator = emulator.build();
        let sensor = sensor(&emulator).await;
        emulator.set_faults(faults);
        let _stream = sensor.scans(WINDOW, Rate::hz(hz)).await.unwrap();
        sleep(Duration::from_secs(20)).await;
        let log = log.0.lock().unwrap();
        let is_warning = |(level, _): &&(Level, String)| *level == Level::WARN;
        let warnings: Vec<_> = log.lines.iter().filter(is_warning).collect();
        assert!(matches!(warnings[..], [(_, line)] if line.contains(reason)), "{warnings:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_line_that_two_windows_share_is_the_reason() {
    let log = Log::default();
    let _guard = crate::common::logs::collect(log.clone());
    let sensor = sensor(&Emulator::builder().baud_rate(BaudRate::B19200).build()).await;
    let ahead = Window::degrees(-30.0..=30.0).unwrap();
    let _ahead = sensor.scans(ahead, Rate::hz(10.0)).await.unwrap();
    let all = sensor.scans(WINDOW, Rate::hz(2.0)).await.unwrap();
    let is_shared = || {
        let schedules = sensor.stats().schedules;
        let ahead = schedules.iter().find(|schedule| schedule.window.is_same_wish(&ahead));
        let why = ahead.unwrap().explanation().unwrap();
        assert!(why.starts_with("a scan takes 193 ms at 19200 baud"), "{why}");
        why.contains(", and other polls share the line. What helps: ")
    };
    sleep(Duration::from_secs(20)).await;
    assert!(is_shared());
    let shared =
        log.0.lock().unwrap().lines.iter().filter(|(_, line)| line.contains("share")).count();
    assert_eq!(shared, 1, "the larger window is the reason, and has none");
    drop(all);
    sleep(Duration::from_secs(20)).await;
    assert!(!is_shared());
}

#[tokio::test(start_paused = true)]
async fn a_rate_that_falls_short_again_is_logged_after_a_good_minute() {
    let log = Log::default();
    let _guard = crate::common::logs::collect(log.clone());
    let emulator = Emulator::default();
    let sensor = sensor(&emulator).await;
    let _stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    let mut warnings = Vec::new();
    for good_seconds in [30, 75, 0] {
        emulator.set_faults(Faults::none().rate(0.5, Fault::Lost).seed(1));
        sleep(Duration::from_secs(10)).await;
        let is_warning = |(level, _): &&(Level, String)| *level == Level::WARN;
        warnings.push(log.0.lock().unwrap().lines.iter().filter(is_warning).count());
        emulator.set_faults(Faults::none());
        sleep(Duration::from_secs(good_seconds)).await;
    }
    assert_eq!(warnings, [1, 1, 2]);
}

#[tokio::test(start_paused = true)]
async fn a_spare_sensor_is_logged_and_the_same_sensor_is_not() {
    let log = Log::default();
    let _guard = crate::common::logs::collect(log.clone());
    let emulator = Emulator::builder().serial_number("H0000001").build();
    let sensor = builder().any_sensor(true).connect(emulator.clone()).await.unwrap();
    let mut state = sensor.watch_state();
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
