//! A peer that sends hostile bytes: the wake-ups it costs, and which of its bytes reach
//! a person. `tests/limits/memory.rs` measures the memory.

use std::error::Error as _;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::task::{Context, Poll};
use std::time::Duration;

use tokio_scip::port::Connect;
use tokio_scip::{Driver, Error, Rate, Window};
use tracing::field::{Field, Visit};
use tracing::span;
use urg_emulator::{Emulator, Fault, Faults, Link};

use super::rig::{instant_sensor, open, scans, streaming};
use crate::common::builder;

const WINDOW: Window = Window::DETECTION;

/// A driver that counts its wake-ups.
struct CountedDriver(Driver, Arc<AtomicU64>);

impl Future for CountedDriver {
    type Output = Result<(), Error>;

    fn poll(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Self::Output> {
        self.1.fetch_add(1, Relaxed);
        Pin::new(&mut self.0).poll(cx)
    }
}

/// Connects as a serial port does: elsewhere, which wakes the driver when it is done.
struct ConnectOnAnotherTask(Emulator);

impl Connect for ConnectOnAnotherTask {
    type Port = Link;

    async fn connect(&mut self) -> Result<Link, Error> {
        let mut inner = self.0.clone();
        tokio::spawn(async move { inner.connect().await }).await.unwrap()
    }
}

#[tokio::test(start_paused = true)]
async fn o01_d03_an_hour_unplugged_wakes_rarely() {
    let emulator = instant_sensor().build();
    let wakes = Arc::new(AtomicU64::new(0));
    let (sensor, driver) = builder().build(ConnectOnAnotherTask(emulator.clone()));
    tokio::spawn(CountedDriver(driver, Arc::clone(&wakes)));
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    scans(&mut stream, 10).await;
    emulator.unplug();
    // The first attempts follow each other quickly.
    tokio::time::sleep(Duration::from_secs(2)).await;
    let before = wakes.load(Relaxed);
    tokio::time::sleep(Duration::from_secs(3600)).await;
    let woken = wakes.load(Relaxed) - before;
    assert!((3600..=7200).contains(&woken), "{woken} wake-ups in an hour");
    emulator.plug_in();
    stream.next().await.unwrap().unwrap_err();
    scans(&mut stream, 1).await;
}

/// Collects log lines, an event each.
#[derive(Clone, Default)]
struct ErrorLog(Arc<std::sync::Mutex<Vec<String>>>);

impl tracing::Subscriber for ErrorLog {
    fn enabled(&self, metadata: &tracing::Metadata<'_>) -> bool {
        metadata.target().starts_with("tokio_scip")
    }

    fn new_span(&self, _: &span::Attributes<'_>) -> span::Id {
        span::Id::from_u64(1)
    }

    fn record(&self, _: &span::Id, _: &span::Record<'_>) {}

    fn record_follows_from(&self, _: &span::Id, _: &span::Id) {}

    fn event(&self, event: &tracing::Event<'_>) {
        struct EventText(String);
        impl Visit for EventText {
            fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
                self.0 += &format!(" {field}={value:?}");
            }
        }
        let mut text = EventText(event.metadata().level().to_string());
        event.record(&mut text);
        self.0.lock().unwrap().push(text.0);
    }

    fn enter(&self, _: &span::Id) {}

    fn exit(&self, _: &span::Id) {}
}

/// Returns everything that a person may read of an error.
fn full_text(error: &Error) -> String {
    let mut text = format!("{error} {error:?}");
    let mut source = error.source();
    while let Some(cause) = source {
        text += &format!(" {cause} {cause:?}");
        source = cause.source();
    }
    text
}

#[tokio::test(start_paused = true)]
async fn w23_no_control_character_from_a_sensor_reaches_a_person() {
    let log = ErrorLog::default();
    let _guard = crate::common::logs::collect(log.clone());
    let evil = b"\x1b]0;owned\x07\x1b[2J\r\xff\x9b31m\x00\x7f".to_vec();
    let mut texts = Vec::new();

    // In every line of the reply to `V`, the serial number included.
    let lines = ["VEND:", "PROD:", "FIRM:", "PROT:", "SERI:", "STAT:", ""];
    let lines = lines.map(|name| [name.as_bytes(), &evil].concat());
    let emulator = instant_sensor().version_lines(lines).build();
    let sensor = open(&emulator).await;
    let version = sensor.version().await.unwrap();
    texts.push(format!("{version:?} {} {}", version.vendor, version.serial_number));
    let error = builder()
        .serial_number("H1")
        .connect(instant_sensor().version_lines([&b"SERI:\x1b[2J"[..]]).build());
    texts.push(full_text(&error.await.unwrap_err()));

    // In the status, the echo, the data, and between replies.
    let mut stream = sensor.scans(WINDOW, Rate::hz(10.0)).await.unwrap();
    for at in [0, 10, 12, 500] {
        for byte in &evil {
            for fault in [
                Fault::Insert(at, vec![*byte]),
                Fault::Flip(at, byte ^ b'0'),
                Fault::Garbage(evil.repeat(9)),
                Fault::Garbage([&evil[..], b"\n\n"].concat()),
            ] {
                emulator.set_faults(Faults::none().at(0, fault));
                texts.extend(stream.next().await.unwrap().err().map(|error| full_text(&error)));
                texts.extend(sensor.scan(WINDOW).await.err().map(|error| full_text(&error)));
            }
        }
    }
    texts.push(format!("{:?} {:?}", sensor.stats(), sensor.watch_state().get()));
    assert!(texts.len() > 20, "{}", texts.len());
    texts.extend(log.0.lock().unwrap().drain(..));
    for text in &texts {
        let bad = text.chars().find(|&c| c.is_control() || !c.is_ascii());
        assert_eq!(bad, None, "{}", text.escape_debug());
    }
}

#[tokio::test(start_paused = true)]
async fn d03_hours_of_trouble_log_few_lines() {
    let log = ErrorLog::default();
    let _guard = crate::common::logs::collect(log.clone());
    let loud = || {
        let lines = log.0.lock().unwrap();
        let loud =
            lines.iter().filter(|line| !line.starts_with("DEBUG") && !line.starts_with("TRACE"));
        loud.cloned().collect::<Vec<_>>()
    };
    let emulator = instant_sensor().build();
    let (sensor, mut stream) = streaming(&emulator, WINDOW, Rate::hz(2.0)).await;
    scans(&mut stream, 1).await;
    emulator.set_faults(Faults::none().rate(0.1, Fault::Damaged));
    let start = tokio::time::Instant::now();
    while start.elapsed() < Duration::from_secs(3600) {
        let _ = stream.next().await;
    }
    assert!(sensor.stats().malformed.total() > 200);
    let lines = loud();
    assert!(lines.len() <= 3, "{lines:#?}");
    emulator.set_faults(Faults::none());
    emulator.unplug();
    tokio::time::sleep(Duration::from_secs(3600)).await;
    let lines = &loud()[lines.len()..];
    // The lost link, and the reason why it does not come back.
    assert!((1..=2).contains(&lines.len()), "{lines:#?}");
}
