//! The port as a session sees it: it notes what arrives, and never flushes.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::SystemTime;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use crate::BaudRate;
use crate::port::Port;

/// Wraps a port for `Framed`.
pub(crate) struct Line {
    port: Box<dyn Port>,
    /// The wall clock when the first byte of a reply arrived.
    arrival: Option<SystemTime>,
    received: u64,
}

impl Line {
    pub(crate) fn new(port: Box<dyn Port>) -> Self {
        Self { port, arrival: None, received: 0 }
    }

    /// Expects a reply: the next byte counts as its first.
    pub(crate) fn expect(&mut self) {
        self.arrival = None;
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
        let before = buffer.filled().len();
        let outcome = Pin::new(&mut self.port).poll_read(cx, buffer);
        let read = buffer.filled().len() - before;
        if read > 0 {
            self.received += read as u64;
            self.arrival.get_or_insert_with(SystemTime::now);
        }
        outcome
    }
}

impl AsyncWrite for Line {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.port).poll_write(cx, bytes)
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
