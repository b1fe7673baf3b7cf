//! [`Transport`]: sends one command and receives frames until a deadline. It knows a port, a
//! codec and a clock, but not which frame answers which command.
//!
//! It also tracks doubt about the link. Unexpected and missing bytes make the link dirty,
//! and only an answered fence makes it clean again.

mod arrivals;
mod link;
mod pause;
#[cfg(test)]
mod scripted_port;
#[cfg(test)]
mod tests;
mod timing;

use std::future::{Future, poll_fn};
use std::io;
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::task::{Context, Poll, Waker, ready};
use std::time::Duration;

use bytes::{Buf, BufMut, BytesMut};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::task::coop::{consume_budget, unconstrained};
use tokio::time::{Instant, Sleep, sleep_until};

use self::arrivals::{Arrivals, flood};
use self::pause::Pauses;
pub(crate) use self::timing::{Deadline, TimedFrame, Timing};
use super::failure::ExchangeError;
use crate::codec::{Frame, ScipCodec, TERMINATOR};
use crate::port::{Port, PortHints};
use crate::protocol::Command;
use crate::state::Telemetry;

/// After this many frames for one command, the link counts as flooded.
const MAX_FRAMES: usize = 64;
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
    arrivals: Arrivals,
    codec: ScipCodec,
    /// Received bytes. Frames are judged in place: copying one out costs a fifth of decoding
    /// a scan (`benches/README.md`, item 1).
    input: BytesMut,
    /// Last returned frame, if it followed the latest command. A reply stays at the front of
    /// the input until the next frame is awaited.
    latest: Option<Frame<usize>>,
    /// Number of frames since the latest command.
    frames: usize,
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
    /// True if a reply older than the next command may be on its way.
    dirty: bool,
    /// True if a command may have been written only in part.
    interrupted: bool,
    /// True if the port can change its baud rate.
    adjustable: bool,
    /// True once a reply arrived faster than the port's baud rate allows, as on a
    /// pseudo-terminal, a USB adapter or a server on a fast line.
    outrun: bool,
    /// When the latest frame arrived.
    latest_at: Option<Instant>,
    telemetry: Arc<Telemetry>,
}

impl Transport {
    pub(crate) fn new(
        port: Box<dyn Port>,
        latency: Option<Duration>,
        telemetry: Arc<Telemetry>,
    ) -> Self {
        telemetry.stats().baud_rate_outrun = false;
        Self {
            port: PromptPort(port),
            arrivals: Arrivals::default(),
            codec: ScipCodec::default(),
            input: BytesMut::with_capacity(READ_BUFFER_BYTES),
            latest: None,
            frames: 0,
            output: BytesMut::with_capacity(WRITE_BUFFER_BYTES),
            deadline_timer: Timer::default(),
            pause_timer: Timer::default(),
            retry_timer: Timer::default(),
            pauses: Pauses::default(),
            latency,
            // The last user of the port may have left bytes behind.
            dirty: true,
            interrupted: true,
            adjustable: false,
            outrun: false,
            latest_at: None,
            telemetry,
        }
    }

    /// Drops the bytes received since the last reply, because they are older than the next
    /// command. Such bytes make the link dirty.
    pub(crate) async fn discard_pending(&mut self) -> Result<(), ExchangeError> {
        self.remove_latest();
        let before = self.received();
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
        let skipped = self.received() - before + self.input.len() as u64;
        if skipped > 0 {
            self.telemetry.stats().bytes_skipped += skipped;
            self.dirty = true;
            self.drop_input();
        }
        // Without this, replies would use up the buffer and need two reads.
        self.input.reserve(READ_BUFFER_BYTES);
        Ok(())
    }

    /// Sends `command` and returns the first frame: [`send`](Self::send) followed by
    /// [`next_frame`](Self::next_frame).
    pub(crate) async fn ask(
        &mut self,
        command: &Command,
        latency: Duration,
    ) -> Result<TimedFrame<'_>, ExchangeError> {
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
        // The calls on the port take none: if its replies are ready at once, the driver would
        // never let other tasks run.
        consume_budget().await;
        self.remove_latest();
        self.frames = 0;
        self.arrivals.begin_command();
        self.pauses.begin_reply();
        self.codec.expect(command);
        self.output.clear();
        self.output.put_slice(if self.interrupted { b"\n" } else { b"" });
        self.output.put_slice(&command.bytes());
        self.output.put_u8(b'\n');
        // Stays set if this future is dropped half way.
        self.interrupted = true;
        let deadline = Deadline::new(*command, self.baud_rate(), latency);
        let mut written = 0;
        self.until(deadline, |transport, cx| transport.poll_write(cx, &mut written)).await?;
        self.interrupted = false;
        Ok(deadline)
    }

    /// Receives the next frame after a command; no other function receives frames. A frame
    /// that is complete at the deadline wins. Any earlier frame was not the answer, so the
    /// link is dirty. Sleeps while the rest of a reply is on its way.
    ///
    /// # Errors
    ///
    /// [`Timeout`](crate::ErrorKind::Timeout) at the deadline.
    pub(crate) async fn next_frame(
        &mut self,
        deadline: Deadline,
    ) -> Result<TimedFrame<'_>, ExchangeError> {
        if let Some(unwanted) = self.remove_latest() {
            self.dirty = true;
            self.arrivals.begin_reply();
            self.pauses.begin_reply();
            self.telemetry.stats().bytes_skipped += unwanted.wire_len();
        }
        if self.frames == MAX_FRAMES {
            return Err(self.lost(Some(flood())));
        }
        let found = loop {
            match self.until(deadline, |transport, cx| transport.poll_frame(cx, deadline)).await? {
                FrameStep::Frame(frame) => break frame,
                FrameStep::Pause(until) => poll_fn(|cx| self.pause_timer.poll(cx, until)).await,
                FrameStep::End => return Err(self.lost(None)),
            }
        };
        let received = Instant::now();
        self.frames += 1;
        self.latest = Some(found);
        self.latest_at = Some(received);
        let wire_len = found.wire_len();
        self.pauses.end_reply(received, wire_len);
        let first_byte = self.arrivals.first_byte(&mut self.port);
        let timing = Timing {
            requested: deadline.requested,
            began: first_byte.at,
            received,
            stamp: first_byte.stamp,
            is_replayed: first_byte.is_replayed,
            baud_rate: self.believed_baud_rate(),
        };
        let frame = match found {
            Frame::Reply(length) => Frame::Reply(self.input.get(..length).unwrap_or_default()),
            Frame::Overlong { bytes } => Frame::Overlong { bytes },
        };
        Ok(TimedFrame { frame, wire_len, timing })
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

    /// Reads until a frame is at the front of the input, or until a pause is worthwhile.
    fn poll_frame(
        &mut self,
        cx: &mut Context<'_>,
        deadline: Deadline,
    ) -> Poll<io::Result<FrameStep>> {
        let Self { port, arrivals, codec, input, retry_timer, pauses, .. } = self;
        loop {
            if !input.is_empty()
                && let Some(frame) = codec.find(input)
            {
                return Poll::Ready(Ok(FrameStep::Frame(frame)));
            }
            let outcome = port.poll_read(cx, input);
            match again_if_interrupted(outcome, retry_timer, cx) {
                Poll::Ready(Ok(0)) => return Poll::Ready(Ok(FrameStep::End)),
                Poll::Ready(Ok(read)) => {
                    let fresh = input.len().saturating_sub(read);
                    arrivals.count(input.get(fresh..).unwrap_or_default(), port)?;
                }
                Poll::Ready(Err(error)) => return Poll::Ready(Err(error)),
                Poll::Pending => break,
            }
        }
        let missing = codec.missing(input);
        match missing.and_then(|missing| pauses.next(input.len(), missing, deadline.at())) {
            Some(until) if port.hints().is_some_and(PortHints::suspend_wakeups) => {
                Poll::Ready(Ok(FrameStep::Pause(until)))
            }
            _ => Poll::Pending,
        }
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
                    if let Err(flood) = self.arrivals.count(fresh, &mut self.port) {
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

    /// Awaits `work` until the deadline, and marks the link dirty if it is missed. Polls
    /// `work` first, so that it succeeds if it is done at its deadline.
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
            self.dirty = true;
            Poll::Ready(Err(ExchangeError::Command(deadline.error())))
        })
        .await
    }

    /// Removes the last returned frame from the front of the input.
    fn remove_latest(&mut self) -> Option<Frame<usize>> {
        let latest = self.latest.take()?;
        if let Frame::Reply(length) = latest {
            let end = length + TERMINATOR;
            if end < self.input.len() {
                self.input.advance(end);
            } else {
                // Cheaper than `advance`, and the next reply starts at the front of the
                // buffer again.
                self.input.clear();
            }
        }
        Some(latest)
    }
}

impl Drop for Transport {
    fn drop(&mut self) {
        if let Some(hints) = self.port.hints() {
            hints.discard_output();
        }
    }
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
    Frame(Frame<usize>),
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
