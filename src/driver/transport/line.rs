//! [`Line`]: the port as the codec reads it. It counts what arrives, gives up
//! under a flood, and never flushes.

use std::future::poll_fn;
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::SystemTime;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::task::coop::unconstrained;
use tokio::time::Instant;

use crate::BaudRate;
use crate::port::Port;

/// How many bytes may arrive between two commands. A sensor answers each with
/// 1,576 at most; a line that always has more to read would keep the driver from
/// ever looking at the clock.
const FLOOD_BYTES: u64 = 64 * 1024;
/// How much is read at once of what is dropped.
pub(super) const SCRATCH_BYTES: usize = 512;

/// A port, and what is known of the bytes that it brought.
pub(super) struct Line {
    port: Box<dyn Port>,
    /// The time when the first byte of a reply arrived, by both clocks; by the
    /// monotonic one only where the port has a baud rate to compare it with.
    arrival: Option<(Option<Instant>, SystemTime)>,
    /// The number of bytes that ever arrived.
    received: u64,
    /// The first two of them.
    first: [u8; 2],
    /// How many of them had arrived when the latest command was written.
    before: u64,
}

impl Line {
    pub(super) fn new(port: Box<dyn Port>) -> Self {
        Self { port, arrival: None, received: 0, first: [0; 2], before: 0 }
    }

    /// Notes that a command is written: what comes from now on counts anew.
    pub(super) fn begin_command(&mut self) {
        self.before = self.received;
        self.begin_reply();
    }

    /// Notes that the next byte is the first of a reply.
    pub(super) fn begin_reply(&mut self) {
        self.arrival = None;
    }

    /// The wall clock when the first byte since [`begin_reply`](Self::begin_reply)
    /// arrived.
    pub(super) fn stamp(&self) -> SystemTime {
        self.arrival.map_or_else(|| self.port.wall_clock(), |(_, stamp)| stamp)
    }

    /// The time when the first byte since [`begin_reply`](Self::begin_reply)
    /// arrived.
    pub(super) fn first_byte(&self) -> Option<Instant> {
        self.arrival.and_then(|(at, _)| at)
    }

    /// The number of bytes that ever arrived.
    pub(super) fn received(&self) -> u64 {
        self.received
    }

    /// Drops what the system has by now, and returns how many bytes that were;
    /// `None` at the end of the stream.
    pub(super) async fn drain(&mut self) -> io::Result<Option<u64>> {
        let before = self.received;
        if let Some(end) = self.drain_now() {
            return end.map(|open| open.then(|| self.received - before));
        }
        // The runtime polls the system for new input while this task yields.
        tokio::task::yield_now().await;
        let drained = poll_fn(|cx| {
            let mut scratch = [0; SCRATCH_BYTES];
            loop {
                let mut buffer = ReadBuf::new(&mut scratch);
                match Pin::new(&mut *self).poll_read(cx, &mut buffer) {
                    Poll::Ready(Ok(())) if buffer.filled().is_empty() => {
                        return Poll::Ready(Ok(None));
                    }
                    Poll::Ready(Ok(())) => {}
                    Poll::Ready(Err(error)) => return Poll::Ready(Err(error)),
                    Poll::Pending => return Poll::Ready(Ok(Some(self.received - before))),
                }
            }
        });
        // Out of budget, a read returns `Pending` whatever is there; that must not
        // pass for a quiet line.
        unconstrained(drained).await
    }

    /// Drops what the system has, where the port can ask it without waiting.
    /// Returns whether the stream is still open; `None` where the port cannot ask.
    fn drain_now(&mut self) -> Option<io::Result<bool>> {
        let mut scratch = [0; SCRATCH_BYTES];
        loop {
            match self.port.try_read(&mut scratch)? {
                Ok(0) => return Some(Ok(false)),
                Ok(read) => {
                    if let Err(flood) = self.count(scratch.get(..read).unwrap_or_default()) {
                        return Some(Err(flood));
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Some(Ok(true)),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Some(Err(error)),
            }
        }
    }

    /// Counts what has come, and fails once it is a flood.
    fn count(&mut self, fresh: &[u8]) -> io::Result<()> {
        if !fresh.is_empty() {
            let seen = self.received.min(2) as usize;
            self.first.iter_mut().skip(seen).zip(fresh).for_each(|(first, byte)| *first = *byte);
            self.received += fresh.len() as u64;
            self.arrival.get_or_insert_with(|| {
                let timed = self.port.baud_rate().is_some();
                (timed.then(Instant::now), self.port.wall_clock())
            });
        }
        if self.received - self.before > FLOOD_BYTES { Err(flood()) } else { Ok(()) }
    }

    /// Whether the first bytes that ever came were a telnet command, as from a
    /// server that begins by negotiating options.
    pub(super) fn began_as_telnet(&self) -> bool {
        matches!(self.first, [0xff, 0xfb..=0xfe])
    }

    pub(super) fn baud_rate(&self) -> Option<BaudRate> {
        self.port.baud_rate()
    }

    pub(super) fn can_die_silently(&self) -> bool {
        self.port.can_die_silently()
    }

    pub(super) fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        self.port.set_baud_rate(baud_rate)
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
        let outcome = again_if_interrupted(outcome, cx);
        self.count(buffer.filled().get(before..).unwrap_or_default())?;
        outcome
    }
}

/// Far more comes than any sensor sends.
pub(super) fn flood() -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, "far more comes than any sensor sends")
}

/// Asks for another poll after a call that a signal interrupted, or that a port
/// refuses for the moment without registering a waker.
fn again_if_interrupted<T>(
    outcome: Poll<io::Result<T>>,
    cx: &mut Context<'_>,
) -> Poll<io::Result<T>> {
    use io::ErrorKind::{Interrupted, WouldBlock};
    match outcome {
        Poll::Ready(Err(error)) if matches!(error.kind(), Interrupted | WouldBlock) => {
            cx.waker().wake_by_ref();
            Poll::Pending
        }
        outcome => outcome,
    }
}

impl AsyncWrite for Line {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let outcome = Pin::new(&mut self.port).poll_write(cx, bytes);
        again_if_interrupted(outcome, cx)
    }

    /// Does nothing. What was written leaves by itself, the reply proves that it
    /// did, and flushing a serial port blocks the thread until it is drained.
    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.poll_flush(cx)
    }
}
