//! [`Transport`]: sends one command and receives frames until a deadline. It knows a port, a
//! codec and a clock, but not which frame answers which command.
//!
//! The codec finds a frame, and `pause` decides when to sleep while one arrives.

mod link;
mod pause;
#[cfg(test)]
pub(super) mod scripted_port;
#[cfg(test)]
mod tests;

use std::future::{Future, poll_fn};
use std::io;
use std::pin::{Pin, pin};
use std::task::{Context, Poll, Waker, ready};
use std::time::{Duration, SystemTime};

use bytes::{Buf, BufMut, BytesMut};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::task::coop::{consume_budget, unconstrained};
use tokio::time::{Instant, Sleep, sleep_until};

use self::pause::Pauses;
use super::failure::ExchangeError;
use crate::codec::{FoundFrame, ScipCodec, TERMINATOR};
use crate::port::{Port, PortHints};
use crate::protocol::Command;
use crate::{BaudRate, ErrorKind};

/// After this many frames for one command, the link counts as flooded.
const MAX_FRAMES: usize = 64;
/// Number of bytes that may arrive between two commands. A sensor answers a command with at
/// most 1,576. Without this limit, a line that always has more to read would keep the driver
/// from checking its deadline.
const FLOOD_BYTES: u64 = 64 * 1024;
/// Room for any reply of a sensor; the longest has 1,576 bytes. A little more, because a
/// read that fills the buffer needs a second one to see the end. Garbage can make the buffer
/// grow to 8 KiB.
const READ_BUFFER_BYTES: usize = 1600;
/// Room for any command, and the LF before it.
const WRITE_BUFFER_BYTES: usize = 32;
/// Number of interrupted reads in a row after which the port counts as quiet.
const MAX_INTERRUPTED: usize = 16;
/// Delay before a refused call is retried.
const RETRY: Duration = Duration::from_millis(5);
/// Length of one read when bytes are dropped.
const SCRATCH_BYTES: usize = 512;

/// Open port and its buffers. Never flushes the port: bytes leave without it, and the reply
/// proves that they did. Flushing a serial port would block the thread until the port is
/// drained.
pub(crate) struct Transport {
    port: PromptPort,
    codec: ScipCodec,
    /// Received bytes. Frames are judged in place: a copy of one would be a second allocation a
    /// scan.
    input: BytesMut,
    /// Number of bytes received so far, and before the latest command was written.
    received: u64,
    received_before: u64,
    /// First two bytes ever received.
    first_bytes: [u8; 2],
    /// Number of frames since the latest command.
    frames: usize,
    /// When the latest frame arrived.
    latest_at: Option<Instant>,
    /// Latest command, as it was written.
    output: BytesMut,
    deadline_timer: Timer,
    /// Ends pauses. Separate from the deadline timer, which can then stay registered.
    pause_timer: Timer,
    /// Retries calls that the port refused.
    retry_timer: Timer,
    pauses: Pauses,
    /// How long the sensor may take to begin its answer, if set.
    latency: Option<Duration>,
    /// True if a command may have been written only in part.
    interrupted: bool,
    /// True if the port can change its baud rate.
    adjustable: bool,
}

/// Absolute deadline of an exchange: the wire time of the command and its reply at the
/// port's baud rate, and a latency.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Deadline {
    command: Command,
    requested: Instant,
    after: Duration,
}

/// Times of a command and its reply.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Timing {
    pub(crate) requested: Instant,
    /// When the first byte was read.
    pub(crate) began: Instant,
    /// When the last byte was read.
    pub(crate) received: Instant,
    /// Wall-clock time when the first byte arrived.
    pub(crate) stamp: SystemTime,
    /// True if the reply comes from a recording: its time tells nothing about the motor.
    pub(crate) is_replayed: bool,
}

/// Frame received after a command. Dropping it removes it from the input.
#[derive(Debug)]
pub(crate) struct ReceivedFrame<'a> {
    input: &'a mut BytesMut,
    frame: FoundFrame,
    pub(crate) timing: Timing,
}

impl Transport {
    pub(crate) fn new(port: Box<dyn Port>, latency: Option<Duration>) -> Self {
        Self {
            port: PromptPort(port),
            codec: ScipCodec::default(),
            input: BytesMut::with_capacity(READ_BUFFER_BYTES),
            received: 0,
            received_before: 0,
            first_bytes: [0; 2],
            frames: 0,
            latest_at: None,
            output: BytesMut::with_capacity(WRITE_BUFFER_BYTES),
            deadline_timer: Timer::default(),
            pause_timer: Timer::default(),
            retry_timer: Timer::default(),
            pauses: Pauses::default(),
            latency,
            // The last user of the port may have left half a command behind.
            interrupted: true,
            adjustable: false,
        }
    }

    /// Drops the bytes received since the last reply, because they are older than the next
    /// command. Returns their number.
    pub(crate) async fn discard_pending(&mut self) -> Result<u64, ExchangeError> {
        let before = self.received - self.input.len() as u64;
        let is_open = match self.drop_bytes(PromptPort::try_read) {
            Some(is_open) => is_open,
            None => {
                // While this task yields, the runtime polls the system for new input.
                tokio::task::yield_now().await;
                let dropped = poll_fn(|cx| {
                    Poll::Ready(self.drop_bytes(|port, bytes| port.read_if_ready(cx, bytes)))
                });
                dropped.await.unwrap_or(Ok(true))
            }
        };
        if !is_open.map_err(|error| self.lost(Some(error)))? {
            return Err(self.lost(None));
        }
        self.clear_input();
        // Without this, replies would use up the buffer and need two reads.
        self.input.reserve(READ_BUFFER_BYTES);
        Ok(self.received - before)
    }

    /// Sends `command` and returns the first frame: [`send`](Self::send) followed by
    /// [`next_frame`](Self::next_frame).
    pub(crate) async fn ask(
        &mut self,
        command: &Command,
        latency: Duration,
    ) -> Result<ReceivedFrame<'_>, ExchangeError> {
        let deadline = self.send(command, latency).await?;
        self.next_frame(deadline).await
    }

    /// Writes `command`, after an LF if the sensor may hold part of another one. Returns the
    /// deadline of the reply, which may take `latency` to begin.
    ///
    /// # Errors
    ///
    /// [`Timeout`](crate::ErrorKind::Timeout) at the deadline.
    pub(crate) async fn send(
        &mut self,
        command: &Command,
        latency: Duration,
    ) -> Result<Deadline, ExchangeError> {
        self.send_after(b"", command, latency).await
    }

    /// Writes other bytes, and `command` as [`send`](Self::send) does.
    pub(crate) async fn send_after(
        &mut self,
        bytes: &[u8],
        command: &Command,
        latency: Duration,
    ) -> Result<Deadline, ExchangeError> {
        // The calls on the port take none: if its replies are ready at once, the driver would
        // never let other tasks run.
        consume_budget().await;
        self.frames = 0;
        self.received_before = self.received;
        self.output.clear();
        self.output.put_slice(if self.interrupted { b"\n" } else { b"" });
        self.output.put_slice(bytes);
        self.codec.write(command, &mut self.output);
        // Stays set if this future is dropped half way.
        self.interrupted = true;
        let deadline = Deadline::new(*command, self.baud_rate(), latency);
        let mut written = 0;
        self.until(deadline, |transport, cx| transport.poll_write(cx, &mut written)).await?;
        self.interrupted = false;
        Ok(deadline)
    }

    /// Receives the next frame after a command; no other function receives frames. A frame
    /// that is complete at the deadline wins. Sleeps while the rest of a reply is on its way.
    ///
    /// # Errors
    ///
    /// [`Timeout`](crate::ErrorKind::Timeout) at the deadline.
    pub(crate) async fn next_frame(
        &mut self,
        deadline: Deadline,
    ) -> Result<ReceivedFrame<'_>, ExchangeError> {
        if self.frames == MAX_FRAMES {
            return Err(self.lost(Some(flood())));
        }
        self.frames += 1;
        self.pauses.begin_reply();
        let mut first_byte = None;
        let frame = loop {
            let step = self.until(deadline, |transport, cx| {
                transport.poll_frame(cx, deadline, &mut first_byte)
            });
            match step.await? {
                FrameStep::Frame(frame) => break frame,
                FrameStep::Pause(until) => poll_fn(|cx| self.pause_timer.poll(cx, until)).await,
                FrameStep::End => return Err(self.lost(None)),
            }
        };
        let received = Instant::now();
        self.latest_at = Some(received);
        self.pauses.end_reply(received, frame.wire_len());
        let Arrival { at: began, stamp, is_replayed } =
            first_byte.unwrap_or_else(|| Arrival::now(&mut self.port));
        let timing = Timing { requested: deadline.requested, began, received, stamp, is_replayed };
        Ok(ReceivedFrame { input: &mut self.input, frame, timing })
    }

    /// Writes the output from `written` on.
    fn poll_write(&mut self, cx: &mut Context<'_>, written: &mut usize) -> Poll<io::Result<()>> {
        while let Some(rest @ [_, ..]) = self.output.get(*written..) {
            let outcome = self.port.poll_write(cx, rest);
            match ready!(again_if_interrupted(outcome, &mut self.retry_timer, cx))? {
                0 => return Poll::Ready(Err(io::ErrorKind::WriteZero.into())),
                more => *written += more,
            }
        }
        Poll::Ready(Ok(()))
    }

    /// Reads until a frame is at the front of the input, or until a pause is worthwhile. Stores
    /// when its first byte arrived.
    fn poll_frame(
        &mut self,
        cx: &mut Context<'_>,
        deadline: Deadline,
        first_byte: &mut Option<Arrival>,
    ) -> Poll<io::Result<FrameStep>> {
        loop {
            if !self.input.is_empty()
                && let Some(frame) = self.codec.find(&mut self.input)
            {
                return Poll::Ready(Ok(FrameStep::Frame(frame)));
            }
            match self.poll_read(cx)? {
                Poll::Ready(0) => return Poll::Ready(Ok(FrameStep::End)),
                Poll::Ready(read) => {
                    let fresh = self.input.len().saturating_sub(read);
                    let mut fresh = self.input.iter().skip(fresh);
                    // The codec skips the NULs that a line leaves in front of a reply when it
                    // changes its speed or breaks.
                    if first_byte.is_none() && fresh.any(|byte| *byte != 0) {
                        *first_byte = Some(Arrival::now(&mut self.port));
                    }
                }
                Poll::Pending => break,
            }
        }
        let pause = self
            .codec
            .missing(&self.input)
            .and_then(|missing| self.pauses.next(self.input.len(), missing, deadline.at()));
        match pause {
            Some(until) if self.port.hints().is_some_and(PortHints::suspend_wakeups) => {
                Poll::Ready(Ok(FrameStep::Pause(until)))
            }
            _ => Poll::Pending,
        }
    }

    /// Reads more bytes into the input, and returns their number.
    fn poll_read(&mut self, cx: &mut Context<'_>) -> Poll<io::Result<usize>> {
        let outcome = self.port.poll_read(cx, &mut self.input);
        let read = ready!(again_if_interrupted(outcome, &mut self.retry_timer, cx))?;
        let before = self.input.len().saturating_sub(read);
        let fresh = self.input.get(before..).unwrap_or_default();
        count(fresh, &mut self.received, &mut self.first_bytes);
        Poll::Ready(self.check_flood().map(|()| read))
    }

    /// Drops the bytes that `read` returns until it would block. Repeats an interrupted
    /// read. Returns whether the stream is still open, or `None` as soon as `read` returns
    /// `None`.
    fn drop_bytes(
        &mut self,
        mut read: impl FnMut(&mut PromptPort, &mut [u8]) -> Option<io::Result<usize>>,
    ) -> Option<io::Result<bool>> {
        let mut scratch = [0; SCRATCH_BYTES];
        let mut interrupted = 0;
        loop {
            match read(&mut self.port, &mut scratch)? {
                Ok(0) => return Some(Ok(false)),
                Ok(read) => {
                    let fresh = scratch.get(..read).unwrap_or_default();
                    count(fresh, &mut self.received, &mut self.first_bytes);
                    if let Err(flood) = self.check_flood() {
                        return Some(Err(flood));
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Some(Ok(true)),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {
                    interrupted += 1;
                    if interrupted == MAX_INTERRUPTED {
                        return Some(Ok(true));
                    }
                }
                Err(error) => return Some(Err(error)),
            }
        }
    }

    /// Fails if too many bytes have arrived since the latest command.
    fn check_flood(&self) -> io::Result<()> {
        if self.received - self.received_before > FLOOD_BYTES { Err(flood()) } else { Ok(()) }
    }

    /// Awaits `work` until the deadline. Polls `work` first, so that it succeeds if it is done
    /// at its deadline.
    async fn until<T>(
        &mut self,
        deadline: Deadline,
        mut work: impl FnMut(&mut Self, &mut Context<'_>) -> Poll<io::Result<T>>,
    ) -> Result<T, ExchangeError> {
        poll_fn(|cx| {
            if let Poll::Ready(outcome) = work(self, cx) {
                return Poll::Ready(outcome.map_err(|error| self.lost(Some(error))));
            }
            ready!(self.deadline_timer.poll(cx, deadline.at()));
            Poll::Ready(Err(ExchangeError::Command(deadline.error())))
        })
        .await
    }

    fn clear_input(&mut self) {
        self.input.clear();
        self.codec.reset();
    }
}

impl Drop for Transport {
    fn drop(&mut self) {
        if let Some(hints) = self.port.hints() {
            hints.discard_output();
        }
    }
}

impl Deadline {
    fn new(command: Command, baud_rate: Option<BaudRate>, latency: Duration) -> Self {
        let bytes = command.bytes().len() + 1 + command.reply_len();
        let wire = baud_rate.map_or(Duration::ZERO, |rate| rate.wire_time(bytes));
        Self { command, requested: Instant::now(), after: wire + latency }
    }

    fn at(&self) -> Instant {
        self.requested + self.after
    }

    /// Error of an exchange that has reached its deadline.
    fn error(&self) -> ErrorKind {
        ErrorKind::Timeout { command: self.command, after: self.after }
    }
}

impl ReceivedFrame<'_> {
    pub(crate) fn frame(&self) -> FoundFrame<&[u8]> {
        match self.frame {
            FoundFrame::Reply(length) => {
                FoundFrame::Reply(self.input.get(..length).unwrap_or_default())
            }
            FoundFrame::Overlong { bytes } => FoundFrame::Overlong { bytes },
        }
    }

    /// Number of its bytes on the wire.
    pub(crate) fn wire_len(&self) -> u64 {
        self.frame.wire_len()
    }
}

impl Drop for ReceivedFrame<'_> {
    fn drop(&mut self) {
        let FoundFrame::Reply(length) = self.frame else { return };
        let end = length + TERMINATOR;
        if end < self.input.len() {
            self.input.advance(end);
        } else {
            // Cheaper than `advance`, and the next reply starts at the front of the buffer
            // again.
            self.input.clear();
        }
    }
}

/// Arrival of a byte, by both clocks.
#[derive(Debug, Clone, Copy)]
struct Arrival {
    at: Instant,
    stamp: SystemTime,
    /// True if the wall clock is a recording's.
    is_replayed: bool,
}

impl Arrival {
    fn now(port: &mut PromptPort) -> Self {
        let at = Instant::now();
        let recorded = port.hints().and_then(|hints| hints.wall_clock());
        let stamp = recorded.unwrap_or_else(SystemTime::now);
        Self { at, stamp, is_replayed: recorded.is_some() }
    }
}

/// Counts received bytes, and keeps the `first` two.
fn count(fresh: &[u8], received: &mut u64, first: &mut [u8; 2]) {
    let unset = first.iter_mut().skip((*received).min(2) as usize);
    unset.zip(fresh).for_each(|(first, byte)| *first = *byte);
    *received += fresh.len() as u64;
}

/// Error for a line that sends far more than any sensor does.
fn flood() -> io::Error {
    io::Error::new(
        io::ErrorKind::InvalidData,
        "expected at most 64 KiB and 64 replies after a command, found more: check that the port leads to a sensor",
    )
}

/// Port whose calls have no part in tokio's budget. Without budget, a port that takes part returns
/// `Pending` or `WouldBlock` even if it has bytes. The driver would take a flood for a quiet line,
/// and a reply that is there for a missed deadline.
struct PromptPort(Box<dyn Port>);

impl PromptPort {
    fn poll_read(
        &mut self,
        cx: &mut Context<'_>,
        buffer: &mut impl BufMut,
    ) -> Poll<io::Result<usize>> {
        pin!(unconstrained(self.0.read_buf(buffer))).poll(cx)
    }

    fn poll_write(&mut self, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        pin!(unconstrained(self.0.write(bytes))).poll(cx)
    }

    /// Reads the bytes that the port has, or returns `None` if it has no bytes.
    fn read_if_ready(
        &mut self,
        cx: &mut Context<'_>,
        mut bytes: &mut [u8],
    ) -> Option<io::Result<usize>> {
        match self.poll_read(cx, &mut bytes) {
            Poll::Ready(outcome) => Some(outcome),
            Poll::Pending => None,
        }
    }

    /// Reads without waiting, or returns `None` if the port cannot.
    fn try_read(&mut self, bytes: &mut [u8]) -> Option<io::Result<usize>> {
        let hints = self.0.hints()?;
        let read = pin!(unconstrained(poll_fn(|_| Poll::Ready(hints.try_read(bytes)))));
        match read.poll(&mut Context::from_waker(Waker::noop())) {
            Poll::Ready(outcome) => outcome,
            Poll::Pending => None,
        }
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        self.0.hints()
    }
}

/// Step towards a frame.
enum FrameStep {
    Frame(FoundFrame),
    /// The reply cannot be complete before this time.
    Pause(Instant),
    /// End of the stream.
    End,
}

/// Timer that is kept from one exchange to the next. With a new timer each time, tokio
/// wakes its I/O driver by a system call, even from its own thread. Moving a timer to a
/// later time costs next to nothing.
#[derive(Debug, Default)]
struct Timer(Option<Pin<Box<Sleep>>>);

impl Timer {
    /// Waits until `at`, even if the task has used up its budget.
    fn poll(&mut self, cx: &mut Context<'_>, at: Instant) -> Poll<()> {
        let timer = self.0.get_or_insert_with(|| Box::pin(sleep_until(at)));
        if timer.deadline() != at {
            timer.as_mut().reset(at);
        }
        pin!(unconstrained(timer.as_mut())).poll(cx)
    }
}

/// Returns `Pending` after a call that a signal interrupted or that the port refused for
/// now, and polls again after [`RETRY`]. Such a port has registered no waker, and may
/// refuse forever.
fn again_if_interrupted<T>(
    outcome: Poll<io::Result<T>>,
    timer: &mut Timer,
    cx: &mut Context<'_>,
) -> Poll<io::Result<T>> {
    use io::ErrorKind::{Interrupted, WouldBlock};
    match outcome {
        Poll::Ready(Err(error)) if matches!(error.kind(), Interrupted | WouldBlock) => {
            ready!(timer.poll(cx, Instant::now() + RETRY));
            cx.waker().wake_by_ref();
            Poll::Pending
        }
        outcome => outcome,
    }
}
