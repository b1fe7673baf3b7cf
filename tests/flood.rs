//! A line that brings far more than any sensor sends, and always has more.
#![cfg(feature = "emulator")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};

use common::{builder, ms, truthful};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::timeout;
use tokio_scip::emulator::Link;
use tokio_scip::{Error, Rate, Window};

/// A link to a sensor, until it is opened: then `pattern` comes without end,
/// and reading never has to wait.
struct Hose {
    link: Link,
    open: Arc<AtomicBool>,
    pattern: &'static [u8],
}

impl AsyncRead for Hose {
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

impl AsyncWrite for Hose {
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

/// Without an end of a reply, with nothing but ends, and with replies.
const PATTERNS: [&[u8]; 4] = [b"x", b"\0", b"\n\n", b"L1\n0\n\n"];

#[tokio::test(start_paused = true)]
async fn a_flood_from_the_beginning_is_no_sensor() {
    for pattern in PATTERNS {
        let emulator = truthful().build();
        let open = Arc::new(AtomicBool::new(true));
        let hose = Hose { link: emulator.link(), open, pattern };
        let error = builder().attach(hose).await.unwrap_err();
        assert!(matches!(error, Error::Disconnected { .. }), "{error:?}");
        assert!(!emulator.is_connected());
    }
}

#[tokio::test(start_paused = true)]
async fn a_flood_on_an_idle_line_holds_up_neither_requests_nor_the_end() {
    for pattern in PATTERNS {
        let emulator = truthful().build();
        let open = Arc::new(AtomicBool::new(false));
        let hose = Hose { link: emulator.link(), open: Arc::clone(&open), pattern };
        let sensor = builder().attach(hose).await.unwrap();
        open.store(true, Ordering::Relaxed);
        // Wakes the reader.
        emulator.inject(b"x".as_slice());
        let answer = timeout(ms(60_000), sensor.scan(Window::FULL)).await.unwrap();
        assert!(matches!(answer, Err(Error::Disconnected { .. })), "{answer:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_flood_under_a_stream_ends_it() {
    for pattern in PATTERNS {
        let emulator = truthful().build();
        let open = Arc::new(AtomicBool::new(false));
        let hose = Hose { link: emulator.link(), open: Arc::clone(&open), pattern };
        let sensor = builder().attach(hose).await.unwrap();
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

#[tokio::test(start_paused = true)]
async fn a_sensor_that_answers_at_once_leaves_time_for_others() {
    let emulator = truthful().pace(tokio_scip::emulator::Pace::AtOnce).build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    let mut stream = sensor.scans(Window::new(384..=384).unwrap(), Rate::MAX).await.unwrap();
    stream.next().await.unwrap().unwrap();
    for _ in 0..100 {
        let before = emulator.counts().scans;
        tokio::task::yield_now().await;
        assert!(emulator.counts().scans - before < 100);
    }
}
