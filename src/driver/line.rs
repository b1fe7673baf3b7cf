//! The port as a session sees it: it notes what arrives, gives up under a
//! flood, and never flushes.

use std::future::poll_fn;
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::SystemTime;

use bytes::BytesMut;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::task::coop::unconstrained;
use tokio::time::Instant;
use tokio_util::codec::Framed;

use super::intake::Intake;
use crate::BaudRate;
use crate::observer::{RawReply, ReplyObserver};
use crate::port::Port;
use crate::protocol::Command;

/// How many bytes may arrive between two commands. A sensor answers each with
/// 1,576 at most; a line that always has more to read would never let anybody
/// look at the clock.
const FLOOD: u64 = 64 * 1024;

/// Room for any reply of a sensor; the buffer grows to twice that under
/// garbage.
pub(super) const READ_BUFFER: usize = 4096;
/// How much is read at once of what is thrown away.
pub(super) const SCRATCH: usize = 512;
/// Room for any command, and the LF before it.
const WRITE_BUFFER: usize = 32;

/// A port, framed, with buffers no larger than SCIP 1.1 needs.
pub(super) fn framed(port: Box<dyn Port>, observer: ReplyObserver) -> Framed<Line, Intake> {
    let intake = Intake::new(observer.is_some());
    let line = Line { port, arrival: None, received: 0, first: [0; 2], before: 0, observer };
    let mut framed = Framed::with_capacity(line, intake, READ_BUFFER);
    // The capacity above is that of both.
    *framed.write_buffer_mut() = BytesMut::with_capacity(WRITE_BUFFER);
    framed
}

/// Wraps a port for `Framed`.
pub(crate) struct Line {
    port: Box<dyn Port>,
    /// The wall clock when the first byte of a reply arrived.
    arrival: Option<SystemTime>,
    /// How many bytes ever arrived.
    received: u64,
    /// The first two of them.
    first: [u8; 2],
    /// How many of them had arrived when the latest command was written.
    before: u64,
    observer: ReplyObserver,
}

impl Line {
    /// A command is written: what comes from now on counts anew.
    pub(crate) fn begin_command(&mut self) {
        self.before = self.received;
        self.begin_reply();
    }

    /// Expects a reply: the next byte counts as its first.
    pub(crate) fn begin_reply(&mut self) {
        self.arrival = None;
    }

    /// When the first byte since [`begin_reply`](Self::begin_reply) arrived.
    pub(crate) fn stamp(&self) -> SystemTime {
        self.arrival.unwrap_or_else(|| self.port.wall_clock())
    }

    /// Lets the observer hear a frame that answers `command`, which is `None` for the
    /// answer to a fence and for what nobody asked for.
    pub(crate) fn hear(&self, command: Option<Command>, bytes: &[u8]) {
        self.observer.observe(|| {
            let received_at = Instant::now();
            RawReply { command, bytes, received_at, stamp: self.stamp() }
        });
    }

    /// How many bytes ever arrived.
    pub(crate) fn received(&self) -> u64 {
        self.received
    }

    /// Throws away what the system has by now, and gives how many bytes that were;
    /// `None` at the end of the stream.
    pub(super) async fn drain(&mut self) -> io::Result<Option<u64>> {
        let before = self.received;
        if let Some(end) = self.drain_now() {
            return end.map(|open| open.then(|| self.received - before));
        }
        // Lets the runtime see what the system has.
        tokio::task::yield_now().await;
        let drained = poll_fn(|cx| {
            let mut scratch = [0; SCRATCH];
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
        // A task that has used up its budget must not take that for a quiet line.
        unconstrained(drained).await
    }

    /// Throws away what the system has, where the port can ask it; whether there is
    /// more to come.
    fn drain_now(&mut self) -> Option<io::Result<bool>> {
        let mut scratch = [0; SCRATCH];
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

    /// Notes what has come, and fails once it is a flood.
    fn count(&mut self, fresh: &[u8]) -> io::Result<()> {
        if !fresh.is_empty() {
            let seen = self.received.min(2) as usize;
            self.first.iter_mut().skip(seen).zip(fresh).for_each(|(first, byte)| *first = *byte);
            self.received += fresh.len() as u64;
            self.arrival.get_or_insert_with(|| self.port.wall_clock());
        }
        if self.received - self.before > FLOOD { Err(flood()) } else { Ok(()) }
    }

    /// Whether the first thing that ever came was a telnet command, as from a
    /// server that begins by settling its options.
    pub(crate) fn began_as_telnet(&self) -> bool {
        matches!(self.first, [0xff, 0xfb..=0xfe])
    }

    pub(crate) fn baud_rate(&self) -> Option<BaudRate> {
        self.port.baud_rate()
    }

    pub(crate) fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
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
pub(crate) fn flood() -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, "far more comes than any sensor sends")
}

/// A call that a signal interrupted, or that a port refuses for the moment
/// without saying when to come back, is to be made again.
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
    /// did, and draining a serial port blocks the thread.
    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.poll_flush(cx)
    }
}
