//! [`Line`]: the port as the codec reads it. It counts the bytes that arrive, fails
//! after too many, and never flushes.

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

/// The number of bytes that may arrive between two commands. A sensor answers each with
/// 1,576 at most. Without this limit, a line that always has more to read would keep the
/// driver from ever checking its deadline.
const FLOOD_BYTES: u64 = 64 * 1024;
/// The length of one read of bytes that are dropped.
pub(super) const SCRATCH_BYTES: usize = 512;

/// A port, and counters of the bytes that came from it.
pub(super) struct Line {
    port: Box<dyn Port>,
    /// The time when the first byte of a reply arrived, by both clocks; by the
    /// monotonic one only where the port has a baud rate to compare it with.
    arrival: Option<(Option<Instant>, SystemTime)>,
    /// The number of bytes that ever arrived.
    received: u64,
    /// The first two of them.
    first: [u8; 2],
    /// The number of them that had arrived when the latest command was written.
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

    /// Returns the wall-clock time when the first byte since
    /// [`begin_reply`](Self::begin_reply) arrived.
    pub(super) fn stamp(&self) -> SystemTime {
        self.arrival.map_or_else(|| self.port.wall_clock(), |(_, stamp)| stamp)
    }

    /// Returns the time when the first byte since [`begin_reply`](Self::begin_reply)
    /// arrived, on a port with a baud rate.
    pub(super) fn first_byte(&self) -> Option<Instant> {
        self.arrival.and_then(|(at, _)| at)
    }

    /// Returns the number of bytes that ever arrived.
    pub(super) fn received(&self) -> u64 {
        self.received
    }

    /// Drops the bytes that the system has by now, and returns their number, or `None` at
    /// the end of the stream.
    pub(super) async fn drain(&mut self) -> io::Result<Option<u64>> {
        let before = self.received;
        let is_open = match self.drop_bytes(|port, bytes| port.try_read(bytes)) {
            Some(is_open) => is_open?,
            None => {
                // The runtime polls the system for new input while this task yields.
                tokio::task::yield_now().await;
                let dropped = poll_fn(|cx| {
                    Poll::Ready(self.drop_bytes(|port, bytes| read_if_ready(port, cx, bytes)))
                });
                // Out of budget, a read returns `Pending` even if there are bytes; that must
                // not pass for a quiet line.
                unconstrained(dropped).await.unwrap_or(Ok(true))?
            }
        };
        Ok(is_open.then(|| self.received - before))
    }

    /// Drops the bytes that `read` returns until it would block, and again after a signal
    /// has interrupted it. Returns whether the stream is still open, or `None` when `read`
    /// returns that.
    fn drop_bytes(
        &mut self,
        mut read: impl FnMut(&mut dyn Port, &mut [u8]) -> Option<io::Result<usize>>,
    ) -> Option<io::Result<bool>> {
        let mut scratch = [0; SCRATCH_BYTES];
        loop {
            match read(&mut *self.port, &mut scratch)? {
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

    /// Counts bytes that have come, and fails after too many.
    fn count(&mut self, fresh: &[u8]) -> io::Result<()> {
        if !fresh.is_empty() {
            if self.received < 2 {
                let unset = self.first.iter_mut().skip(self.received as usize);
                unset.zip(fresh).for_each(|(first, byte)| *first = *byte);
            }
            self.received += fresh.len() as u64;
            self.arrival.get_or_insert_with(|| {
                let timed = self.port.baud_rate().is_some();
                (timed.then(Instant::now), self.port.wall_clock())
            });
        }
        if self.received - self.before > FLOOD_BYTES { Err(flood()) } else { Ok(()) }
    }

    /// Returns true if the first bytes that ever came were a telnet command, as from a
    /// server that begins by negotiating options.
    pub(super) fn began_as_telnet(&self) -> bool {
        matches!(self.first, [0xff, 0xfb..=0xfe])
    }

    pub(super) fn baud_rate(&self) -> Option<BaudRate> {
        self.port.baud_rate()
    }

    /// Stops waking the driver for bytes that arrive, until the next read. Returns whether
    /// the port can do this.
    pub(super) fn suspend_wakeups(&mut self) -> bool {
        self.port.suspend_wakeups()
    }

    pub(super) fn can_die_silently(&self) -> bool {
        self.port.can_die_silently()
    }

    pub(super) fn is_over(&self) -> bool {
        self.port.is_over()
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

/// Returns the error for a line that sends far more than any sensor does.
pub(super) fn flood() -> io::Error {
    io::Error::new(
        io::ErrorKind::InvalidData,
        "expected at most 64 KiB and 64 replies after a command, found more: check that the port leads to a sensor",
    )
}

/// Reads the bytes that the port has, or returns `None` if it has none.
fn read_if_ready(
    port: &mut dyn Port,
    cx: &mut Context<'_>,
    bytes: &mut [u8],
) -> Option<io::Result<usize>> {
    let mut buffer = ReadBuf::new(bytes);
    match Pin::new(port).poll_read(cx, &mut buffer) {
        Poll::Ready(outcome) => Some(outcome.map(|()| buffer.filled().len())),
        Poll::Pending => None,
    }
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

    /// Does nothing. Written bytes leave without it, the reply proves that they did, and
    /// flushing a serial port blocks the thread until it is drained.
    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.poll_flush(cx)
    }
}

#[cfg(test)]
mod tests {
    use std::io::ErrorKind;

    use super::super::scripted_port::ScriptedPort;
    use super::*;

    /// Returns two lines with reads of these lengths: one whose port can be read without
    /// waiting, and one whose port cannot.
    fn lines(reads: &[Result<usize, ErrorKind>]) -> [Line; 2] {
        [true, false].map(|has_try_read| {
            let reads = reads.iter().map(|read| read.map(|length| vec![0; length])).collect();
            Line::new(Box::new(ScriptedPort { reads, has_try_read, ..ScriptedPort::default() }))
        })
    }

    #[tokio::test]
    async fn o15_bytes_behind_an_interrupted_read_are_dropped_and_each_time_counted_anew() {
        let quiet = Err(ErrorKind::WouldBlock);
        let interrupted = Err(ErrorKind::Interrupted);
        let reads = [Ok(100), interrupted, Ok(20), quiet, Ok(7), quiet, interrupted, Ok(0)];
        for mut line in lines(&reads) {
            assert_eq!(line.drain().await.unwrap(), Some(120));
            assert_eq!(line.drain().await.unwrap(), Some(7));
            assert_eq!(line.drain().await.unwrap(), None);
            assert_eq!(line.received(), 127);
        }
    }

    #[tokio::test]
    async fn a_read_that_fails_ends_the_dropping_of_bytes_with_its_error() {
        for mut line in lines(&[Ok(100), Err(ErrorKind::BrokenPipe), Ok(20)]) {
            assert_eq!(line.drain().await.unwrap_err().kind(), ErrorKind::BrokenPipe);
        }
    }

    #[tokio::test]
    async fn one_byte_more_than_64_kib_after_a_command_is_a_flood() {
        let all_but_one: Vec<_> = (0..127).map(|_| Ok(512)).chain([Ok(511)]).collect();
        let quiet = Err(ErrorKind::WouldBlock);
        let reads = [all_but_one.as_slice(), &[Ok(1), quiet]].concat();
        for mut line in lines(&reads) {
            assert_eq!(line.drain().await.unwrap(), Some(FLOOD_BYTES));
        }
        let reads = [all_but_one.as_slice(), &[Ok(2), quiet]].concat();
        for mut line in lines(&reads) {
            assert_eq!(line.drain().await.unwrap_err().kind(), ErrorKind::InvalidData);
        }
    }
}
