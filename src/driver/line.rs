//! The port as a session sees it: it notes what arrives, takes no more than a
//! sensor can have meant, and never flushes.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::SystemTime;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use crate::BaudRate;
use crate::port::Port;

/// Bytes that may come after one command before the line counts as flooded; the
/// longest reply has 1,576.
const MAX_BYTES: u64 = 64 * 1024;

/// Wraps a port for `Framed`.
pub(crate) struct Line {
    port: Box<dyn Port>,
    /// The wall clock when the first byte of a reply arrived.
    arrival: Option<SystemTime>,
    received: u64,
    /// How many bytes had arrived when a reply was last expected.
    expected_at: u64,
}

impl Line {
    pub(crate) fn new(port: Box<dyn Port>) -> Self {
        Self { port, arrival: None, received: 0, expected_at: 0 }
    }

    /// Expects a reply: the next byte counts as its first.
    pub(crate) fn expect(&mut self) {
        self.arrival = None;
        self.expected_at = self.received;
    }

    /// When the first byte since then arrived.
    pub(crate) fn arrival(&self) -> Option<SystemTime> {
        self.arrival
    }

    /// How many bytes ever arrived.
    pub(crate) fn received(&self) -> u64 {
        self.received
    }

    pub(crate) fn line_speed(&self) -> Option<BaudRate> {
        self.port.line_speed()
    }

    pub(crate) fn set_line_speed(&mut self, speed: BaudRate) -> io::Result<()> {
        self.port.set_line_speed(speed)
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        self.port.discard_output();
    }
}

impl AsyncRead for Line {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        // A port that always has bytes must let other tasks run, too.
        let budget = ready!(tokio::task::coop::poll_proceed(cx));
        if self.received - self.expected_at > MAX_BYTES {
            return Poll::Ready(Err(flooded()));
        }
        let before = buffer.filled().len();
        let outcome = ready!(retried(cx, |cx| Pin::new(&mut self.port).poll_read(cx, buffer)));
        budget.made_progress();
        let read = buffer.filled().len() - before;
        if read > 0 {
            self.received += read as u64;
            self.arrival.get_or_insert_with(SystemTime::now);
        }
        Poll::Ready(outcome)
    }
}

impl AsyncWrite for Line {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        retried(cx, |cx| Pin::new(&mut self.port).poll_write(cx, bytes))
    }

    /// Does nothing. What was written leaves by itself, the reply proves that it
    /// did, and draining a serial port blocks the thread.
    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.poll_flush(cx)
    }
}

/// What a line is lost with on which far more comes than any sensor sends.
pub(crate) fn flooded() -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, "far more comes than any sensor sends")
}

/// A call that a signal interrupted, or that a port refuses for the moment
/// without saying when to come back, is made again a little later.
fn retried<T>(
    cx: &mut Context<'_>,
    call: impl FnOnce(&mut Context<'_>) -> Poll<io::Result<T>>,
) -> Poll<io::Result<T>> {
    match call(cx) {
        Poll::Ready(Err(error))
            if matches!(error.kind(), io::ErrorKind::Interrupted | io::ErrorKind::WouldBlock) =>
        {
            cx.waker().wake_by_ref();
            Poll::Pending
        }
        outcome => outcome,
    }
}
