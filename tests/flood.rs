//! A port that delivers far more than any sensor sends, and always has more.

use std::collections::VecDeque;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::task::{Context, Poll};

use crate::common::{builder, ms, truthful};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::timeout;
use tokio_scip::emulator::{Emulator, Link};
use tokio_scip::{Connect, Error, Port, Rate, Window};

/// A link to a sensor. Once `open` is set, it delivers `pattern` without an end, and
/// reading never waits.
struct FloodingPort {
    link: Link,
    open: Arc<AtomicBool>,
    pattern: &'static [u8],
}

impl AsyncRead for FloodingPort {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<std::io::Result<()>> {
        if !self.open.load(Ordering::Relaxed) {
            return Pin::new(&mut self.link).poll_read(cx, buffer);
        }
        while buffer.remaining() >= self.pattern.len() {
            buffer.put_slice(self.pattern);
        }
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for FloodingPort {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<std::io::Result<usize>> {
        Pin::new(&mut self.link).poll_write(cx, bytes)
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

impl Port for FloodingPort {
    fn try_read(&mut self, buffer: &mut [u8]) -> Option<std::io::Result<usize>> {
        let open = self.open.load(Ordering::Relaxed);
        open.then(|| {
            buffer.iter_mut().zip(self.pattern.iter().cycle()).for_each(|(to, from)| *to = *from);
            Ok(buffer.len())
        })
    }
}

/// Connects once.
struct ConnectOnce(Option<FloodingPort>);

impl Connect for ConnectOnce {
    type Port = FloodingPort;

    async fn connect(&mut self) -> Result<FloodingPort, Error> {
        self.0.take().ok_or(Error::NoSuchPort { port: "endless".to_owned() })
    }
}

/// Returns an endless port with the sensor behind it, and its switch.
fn flooding_port(pattern: &'static [u8]) -> (Emulator, Arc<AtomicBool>, FloodingPort) {
    let emulator = truthful().build();
    let open = Arc::new(AtomicBool::new(false));
    let flooding_port = FloodingPort { link: emulator.link(), open: Arc::clone(&open), pattern };
    (emulator, open, flooding_port)
}

/// Bytes without an end of a reply, with ends only, and with replies.
const PATTERNS: [&[u8]; 4] = [b"x", b"\0", b"\n\n", b"L1\n0\n\n"];

#[tokio::test(start_paused = true)]
async fn a_flood_at_opening_is_an_error() {
    for pattern in PATTERNS {
        let (emulator, open, flooding_port) = flooding_port(pattern);
        open.store(true, Ordering::Relaxed);
        let error = builder().attach(flooding_port).await.unwrap_err();
        assert!(matches!(error, Error::Disconnected { .. }), "{error:?}");
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
        assert!(matches!(answer, Err(Error::Disconnected { .. })), "{answer:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_flood_from_a_port_with_try_read_ends_the_session() {
    for pattern in PATTERNS {
        let (_emulator, open, flooding_port) = flooding_port(pattern);
        let sensor =
            builder().reconnect(false).connect(ConnectOnce(Some(flooding_port))).await.unwrap();
        // The driver does not read before the next command.
        open.store(true, Ordering::Relaxed);
        let answer = timeout(ms(60_000), sensor.scan(Window::FULL)).await.unwrap();
        assert!(matches!(answer, Err(Error::Disconnected { .. })), "{answer:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_flood_under_a_stream_ends_it() {
    for pattern in PATTERNS {
        let (_emulator, open, flooding_port) = flooding_port(pattern);
        let sensor = builder().attach(flooding_port).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::MAX).await.unwrap();
        stream.next().await.unwrap().unwrap();
        open.store(true, Ordering::Relaxed);
        let mut last = None;
        while let Some(item) = timeout(ms(60_000), stream.next()).await.unwrap() {
            last = item.err();
        }
        assert!(matches!(last, Some(Error::Disconnected { .. })), "{last:?}");
    }
}

/// A sensor whose replies are complete as soon as the command is written. Unlike
/// `InstantSensor` it never wakes the driver, so that only a driver that yields lets others
/// run.
#[derive(Default)]
struct ReadyReplies {
    replies: VecDeque<u8>,
    polls: Arc<AtomicUsize>,
}

impl AsyncRead for ReadyReplies {
    fn poll_read(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<std::io::Result<()>> {
        if self.replies.is_empty() {
            return Poll::Pending;
        }
        let count = self.replies.len().min(buffer.remaining());
        self.replies.drain(..count).for_each(|byte| buffer.put_slice(&[byte]));
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for ReadyReplies {
    fn poll_write(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<std::io::Result<usize>> {
        for command in bytes.split(|&byte| byte == b'\n').filter(|line| !line.is_empty()) {
            self.replies.extend(command);
            self.replies.extend(b"\n0\n");
            if command[0] == b'G' {
                self.polls.fetch_add(1, Ordering::Relaxed);
                let step =
                    |at| std::str::from_utf8(&command[at]).unwrap().parse::<usize>().unwrap();
                let points = step(4..7) - step(1..4) + 1;
                self.replies.extend(std::iter::repeat_n(b'5', points * 2));
            } else {
                self.replies.extend(b"SERI:H0000001");
            }
            self.replies.extend(b"\n\n");
        }
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

#[tokio::test(start_paused = true)]
async fn a_sensor_that_answers_at_once_leaves_time_for_others() {
    let polls = Arc::new(AtomicUsize::new(0));
    let port = ReadyReplies { polls: Arc::clone(&polls), ..ReadyReplies::default() };
    let sensor = builder().attach(port).await.unwrap();
    let mut stream = sensor.scans(Window::new(384..=390).unwrap(), Rate::MAX).await.unwrap();
    stream.next().await.unwrap().unwrap();
    let start = polls.load(Ordering::Relaxed);
    for turns in 1..1000 {
        tokio::task::yield_now().await;
        let polled = polls.load(Ordering::Relaxed) - start;
        assert!(polled <= turns + 1, "{polled} polls while others had {turns} turns");
    }
    assert!(polls.load(Ordering::Relaxed) > start + 100);
}
