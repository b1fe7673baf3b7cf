//! A port that delivers far more than any sensor sends, and always has more.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};

use crate::common::instant_sensor::InstantSensor;
use crate::common::test_port::{FarEnd, TestPort};
use crate::common::{builder, ms, truthful};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::timeout;
use tokio_scip::port::{Connect, PortHints};
use tokio_scip::{Error, ErrorKind, Rate, Window};
use urg_emulator::{Emulator, Link};

/// A link to a sensor. Once `open` is set, it delivers `pattern` without an end, and
/// reading never waits.
struct FloodingPort {
    link: Link,
    open: Arc<AtomicBool>,
    pattern: &'static [u8],
}

impl FarEnd for FloodingPort {
    fn read(&mut self, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        if !self.open.load(Ordering::Relaxed) {
            return Pin::new(&mut self.link).poll_read(cx, buffer);
        }
        while buffer.remaining() >= self.pattern.len() {
            buffer.put_slice(self.pattern);
        }
        Poll::Ready(Ok(()))
    }

    fn write(&mut self, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.link).poll_write(cx, bytes)
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        Some(self)
    }
}

impl PortHints for FloodingPort {
    fn try_read(&mut self, buffer: &mut [u8]) -> Option<io::Result<usize>> {
        let open = self.open.load(Ordering::Relaxed);
        open.then(|| {
            buffer.iter_mut().zip(self.pattern.iter().cycle()).for_each(|(to, from)| *to = *from);
            Ok(buffer.len())
        })
    }
}

/// Connects once.
struct ConnectOnce(Option<TestPort<FloodingPort>>);

impl Connect for ConnectOnce {
    type Port = TestPort<FloodingPort>;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        Ok(self.0.take().ok_or(ErrorKind::NoSuchPort { port: "endless".to_owned() })?)
    }
}

/// Returns an endless port of a sensor, and its switch.
fn flooding_port(pattern: &'static [u8]) -> (Emulator, Arc<AtomicBool>, TestPort<FloodingPort>) {
    let emulator = truthful().build();
    let open = Arc::new(AtomicBool::new(false));
    let flooding_port = FloodingPort { link: emulator.link(), open: Arc::clone(&open), pattern };
    (emulator, open, TestPort(flooding_port))
}

/// Bytes without an end of a reply, with ends only, and with replies.
const PATTERNS: [&[u8]; 4] = [b"x", b"\0", b"\n\n", b"L1\n0\n\n"];

#[tokio::test(start_paused = true)]
async fn a_flood_at_opening_is_an_error() {
    for pattern in PATTERNS {
        let (emulator, open, flooding_port) = flooding_port(pattern);
        open.store(true, Ordering::Relaxed);
        let error = builder().attach(flooding_port).await.unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::Disconnected { .. }), "{error:?}");
        assert!(!emulator.is_connected());
    }
}

#[tokio::test(start_paused = true)]
async fn a_flood_on_an_idle_link_fails_the_next_request() {
    for pattern in PATTERNS {
        let (emulator, open, flooding_port) = flooding_port(pattern);
        let sensor = builder().attach(flooding_port).await.unwrap();
        open.store(true, Ordering::Relaxed);
        // Wakes the reader.
        emulator.inject(b"x".as_slice());
        let answer = timeout(ms(60_000), sensor.scan(Window::FULL)).await.unwrap();
        let error = answer.unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::Disconnected { .. }), "{error:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_flood_through_try_read_ends_the_session() {
    for pattern in PATTERNS {
        let (_emulator, open, flooding_port) = flooding_port(pattern);
        let sensor =
            builder().reconnect(false).connect(ConnectOnce(Some(flooding_port))).await.unwrap();
        // The driver does not read before the next command.
        open.store(true, Ordering::Relaxed);
        let answer = timeout(ms(60_000), sensor.scan(Window::FULL)).await.unwrap();
        let error = answer.unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::Disconnected { .. }), "{error:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_flood_under_a_stream_ends_it() {
    for pattern in PATTERNS {
        let (_emulator, open, flooding_port) = flooding_port(pattern);
        let sensor = builder().attach(flooding_port).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        stream.next().await.unwrap().unwrap();
        open.store(true, Ordering::Relaxed);
        let mut last = None;
        while let Some(item) = timeout(ms(60_000), stream.next()).await.unwrap() {
            last = item.err();
        }
        let error = last.unwrap();
        assert!(matches!(error.kind(), ErrorKind::Disconnected { .. }), "{error:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_sensor_that_answers_at_once_leaves_time_for_others() {
    // It never wakes the driver, so that only a driver that yields lets others run.
    let sensor = builder().attach(InstantSensor::without_wakeups()).await.unwrap();
    let mut stream = sensor.scans(Window::new(384..=390).unwrap(), Rate::UNLIMITED).await.unwrap();
    stream.next().await.unwrap().unwrap();
    let start = sensor.stats().polls;
    for turns in 1..1000 {
        tokio::task::yield_now().await;
        let polled = sensor.stats().polls - start;
        assert!(polled <= turns + 1, "{polled} polls while others had {turns} turns");
    }
    assert!(sensor.stats().polls > start + 100);
}
