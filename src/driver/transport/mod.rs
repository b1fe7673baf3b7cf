//! [`Transport`]: sends bytes and receives the frames that are expected until a deadline. It knows
//! a port, a codec and a clock, but no command.
//!
//! The codec finds a frame, and `pause` decides when to sleep while one arrives.

mod budget;
mod discard;
mod greeting;
mod link;
mod pause;
mod received;
#[cfg(test)]
mod tests;
mod timer;

use std::future::poll_fn;
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::{Duration, SystemTime};

use bytes::{BufMut, BytesMut};
use tokio::io::AsyncWrite;
use tokio::task::coop::consume_budget;
use tokio::time::Instant;

use self::budget::poll_read;
use self::greeting::Greeting;
use self::link::FAST;
use self::pause::Pauses;
pub(crate) use self::received::{ReceivedFrame, ReplyTimes};
pub(crate) use self::timer::Timer;
use self::timer::again_if_interrupted;
use super::failure::LinkError;
use crate::codec::{ExpectedReply, Frame, ScipCodec};
use crate::port::{Port, PortHints};

/// Room for any reply of SCIP 1.1; the longest has 1,576 bytes. A little more, because a read that fills
/// the buffer needs a second one to see the end. Garbage can make the buffer grow to 8 KiB. In SCIP 2 it
/// grows to the length of the scans, and a reply may take 16 KiB.
const READ_BUFFER_BYTES: usize = 1600;
/// Room for any command, and the LF before it.
const WRITE_BUFFER_BYTES: usize = 32;
/// Longest time that a timer is late, unless the whole program was stopped: by a signal, or because its
/// container was paused. Afterwards tokio may fire the timer before it learns of the bytes.
const OVERSLEPT: Duration = Duration::from_millis(5);

/// Open port and its buffers. Never flushes the port: bytes leave without it, and the reply proves
/// that they did. Flushing a serial port would block the thread until the port is drained.
pub(crate) struct Transport {
    port: Box<dyn Port>,
    codec: ScipCodec,
    /// Received bytes. Frames are judged in place: a copy of one would be a second allocation a scan.
    input: BytesMut,
    /// Number of bytes received so far.
    pub(crate) received: u64,
    pub(crate) greeting: Greeting,
    /// What may arrive, and how many bytes and frames had arrived when it was expected.
    limits: &'static Limits,
    received_before: u64,
    frames: usize,
    /// When the latest frame arrived.
    pub(crate) latest_at: Option<Instant>,
    /// Latest command, as it is written, and the number of bytes written.
    output: BytesMut,
    written: usize,
    /// When the latest command was written.
    requested: Instant,
    /// Times of the frame that is arriving, once it has begun.
    times: Option<ReplyTimes>,
    /// End of the exchange.
    deadline: Instant,
    /// End of the pause, if there is one now.
    paused_until: Option<Instant>,
    deadline_timer: Timer,
    /// Ends pauses. Separate from the deadline timer, which can then stay registered.
    pause_timer: Timer,
    /// Retries calls that the port refused.
    retry_timer: Timer,
    pauses: Pauses,
    /// True if the sensor may hold part of a command: an LF then goes before the next one.
    pub(crate) interrupted: bool,
    /// True if the port can change its baud rate, as far as known from trying.
    pub(crate) adjustable: bool,
    /// True once a reply arrived faster than the port's baud rate allows, as on a
    /// pseudo-terminal, a USB adapter or a server on a fast line.
    pub(crate) is_baud_rate_disproved: bool,
    /// Speed in bits a second of the fastest reply so far.
    speed: u64,
}

/// What to expect after a command, or next of frames that come unasked.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Expected {
    /// Head and length of the reply, if they are known.
    pub(crate) reply: Option<ExpectedReply>,
    pub(crate) limits: &'static Limits,
}

/// What may arrive until something else is expected. More is a flood: without limits, a line that
/// always has more to read would keep the driver from checking its deadline.
#[derive(Debug)]
pub(crate) struct Limits {
    /// Length of the longest frame in bytes.
    pub(crate) frame: usize,
    pub(crate) frames: usize,
    pub(crate) bytes: u64,
}

/// Why no frame was received.
#[derive(Debug)]
pub(crate) enum NoFrame {
    /// The deadline passed this long after the command.
    Late {
        after: Duration,
    },
    Link(LinkError),
}

impl From<LinkError> for NoFrame {
    fn from(failure: LinkError) -> Self {
        Self::Link(failure)
    }
}

impl Transport {
    /// Takes an open port, on which `limits` apply before the first command. `interrupted` is true
    /// if the sensor may hold part of a command.
    pub(crate) fn new(port: Box<dyn Port>, limits: &'static Limits, interrupted: bool) -> Self {
        let now = Instant::now();
        Self {
            port,
            codec: ScipCodec::default(),
            input: BytesMut::with_capacity(READ_BUFFER_BYTES),
            received: 0,
            greeting: Greeting::default(),
            limits,
            received_before: 0,
            frames: 0,
            latest_at: None,
            output: BytesMut::with_capacity(WRITE_BUFFER_BYTES),
            written: 0,
            requested: now,
            times: None,
            deadline: now,
            paused_until: None,
            deadline_timer: Timer::default(),
            pause_timer: Timer::default(),
            retry_timer: Timer::default(),
            pauses: Pauses::default(),
            interrupted,
            adjustable: false,
            is_baud_rate_disproved: false,
            speed: 0,
        }
    }

    /// Sends `command` and returns the first frame: [`send`](Self::send) followed by
    /// [`next_frame`](Self::next_frame).
    pub(crate) async fn ask(
        &mut self,
        command: &[u8],
        expected: &Expected,
        within: Duration,
    ) -> Result<ReceivedFrame<'_>, NoFrame> {
        consume_budget().await;
        self.begin_exchange(command, expected, within);
        self.begin_frame()?;
        let frame = poll_fn(|cx| {
            ready!(self.poll_write(cx))?;
            self.poll_frame(cx)
        })
        .await?;
        Ok(self.end_frame(frame))
    }

    /// Writes `command` and an LF, after another LF if the sensor may hold part of a command. What is
    /// expected may arrive for the time `within`.
    ///
    /// # Errors
    ///
    /// [`NoFrame::Late`] at the deadline.
    pub(crate) async fn send(
        &mut self,
        command: &[u8],
        expected: &Expected,
        within: Duration,
    ) -> Result<(), NoFrame> {
        consume_budget().await;
        self.begin_exchange(command, expected, within);
        poll_fn(|cx| self.poll_write(cx)).await
    }

    /// Receives the next frame after a command; no other function receives frames. A frame
    /// that is complete at the deadline wins. Sleeps while the rest of a reply is on its way.
    ///
    /// # Errors
    ///
    /// [`NoFrame::Late`] at the deadline.
    pub(crate) async fn next_frame(&mut self) -> Result<ReceivedFrame<'_>, NoFrame> {
        self.begin_frame()?;
        let frame = poll_fn(|cx| self.poll_frame(cx)).await?;
        Ok(self.end_frame(frame))
    }

    /// Expects frames of unknown length without a command, within this time from now on.
    pub(crate) fn expect_unasked(&mut self, limits: &'static Limits, within: Duration) {
        self.requested = Instant::now();
        self.expect(&Expected { reply: None, limits }, self.requested + within);
        if self.input.iter().all(|byte| *byte == 0) {
            self.times = None;
        } else if self.times.is_none() {
            // Its first bytes came with the last ones of the frame before.
            self.begin_reply();
        }
    }

    /// Receives the frame that [`expect_unasked`](Self::expect_unasked) expects.
    ///
    /// # Errors
    ///
    /// [`NoFrame::Late`] at the deadline.
    pub(crate) fn poll_unasked_frame(
        &mut self,
        cx: &mut Context<'_>,
    ) -> Poll<Result<ReceivedFrame<'_>, NoFrame>> {
        let frame = ready!(self.poll_frame(cx))?;
        Poll::Ready(Ok(self.end_frame(frame)))
    }

    /// Call it after `consume_budget`. The calls on the port take none: if its replies are ready at
    /// once, the driver would never let other tasks run.
    fn begin_exchange(&mut self, command: &[u8], expected: &Expected, within: Duration) {
        self.output.clear();
        if self.interrupted {
            self.output.put_u8(b'\n');
        }
        self.output.put_slice(command);
        self.output.put_u8(b'\n');
        // Stays set if the future is dropped half way.
        self.interrupted = true;
        self.written = 0;
        self.requested = Instant::now();
        self.expect(expected, self.requested + within);
    }

    /// Expects this until `deadline`. Counts what arrives anew.
    fn expect(&mut self, expected: &Expected, deadline: Instant) {
        self.codec.expect(expected.reply, expected.limits.frame);
        (self.limits, self.deadline) = (expected.limits, deadline);
        (self.received_before, self.frames) = (self.received, 0);
    }

    /// Expects one more frame, before the same deadline.
    pub(crate) fn begin_frame(&mut self) -> Result<(), LinkError> {
        if self.frames == self.limits.frames {
            return Err(self.lost(Some(flood(self.limits))));
        }
        self.frames += 1;
        self.pauses.begin_reply();
        self.paused_until = None;
        Ok(())
    }

    fn end_frame(&mut self, frame: Frame<usize>) -> ReceivedFrame<'_> {
        let mut times = match self.times {
            Some(times) => times,
            None => self.begin_reply(),
        };
        self.times = None;
        let received = Instant::now();
        times.received = received;
        self.latest_at = Some(received);
        self.pauses.end_reply(received, frame.wire_len());
        if self.speed < FAST {
            self.measure_speed(&times, frame.wire_len());
        }
        ReceivedFrame { input: &mut self.input, frame, times }
    }

    /// Writes the rest of the command.
    fn poll_write(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), NoFrame>> {
        while let Some(rest @ [_, ..]) = self.output.get(self.written..) {
            let outcome = Pin::new(&mut self.port).poll_write(cx, rest);
            match again_if_interrupted(outcome, &mut self.retry_timer, cx) {
                Poll::Ready(Ok(more @ 1..)) => self.written += more,
                Poll::Ready(Ok(0)) => {
                    return Poll::Ready(Err(self
                        .lost(Some(io::ErrorKind::WriteZero.into()))
                        .into()));
                }
                Poll::Ready(Err(error)) => {
                    // What a server wrote before it closed the connection is still readable.
                    while let Poll::Ready(Ok(1..)) = self.poll_read(cx) {}
                    return Poll::Ready(Err(self.lost(Some(error)).into()));
                }
                Poll::Pending => return self.poll_deadline(cx),
            }
        }
        self.interrupted = false;
        Poll::Ready(Ok(()))
    }

    /// Reads until a frame is at the front of the input, or the deadline. Pauses when worthwhile.
    fn poll_frame(&mut self, cx: &mut Context<'_>) -> Poll<Result<Frame<usize>, NoFrame>> {
        loop {
            if let Some(until) = self.paused_until {
                ready!(self.pause_timer.poll(cx, until));
                self.paused_until = None;
            }
            if !self.input.is_empty()
                && let Some(frame) = self.codec.find(&mut self.input)
            {
                return Poll::Ready(Ok(frame));
            }
            match self.poll_read(cx) {
                Poll::Ready(Ok(0)) => return Poll::Ready(Err(self.lost(None).into())),
                Poll::Ready(Err(error)) => return Poll::Ready(Err(self.lost(Some(error)).into())),
                Poll::Ready(Ok(_)) => {
                    // The codec skips the NULs that a line leaves in front of a reply.
                    if self.times.is_none() && self.input.iter().any(|byte| *byte != 0) {
                        self.begin_reply();
                    }
                    continue;
                }
                Poll::Pending => {}
            }
            let missing = self.codec.missing(&self.input);
            let pause = missing
                .and_then(|missing| self.pauses.next(self.input.len(), missing, self.deadline));
            if pause.is_none() || !self.port.hints().is_some_and(PortHints::suspend_wakeups) {
                return self.poll_deadline(cx);
            }
            self.paused_until = pause;
        }
    }

    /// Returns true if the port replays a recording.
    pub(crate) fn is_replay(&mut self) -> bool {
        self.port.hints().is_some_and(|hints| hints.wall_clock().is_some())
    }

    /// Records that a reply begins now.
    fn begin_reply(&mut self) -> ReplyTimes {
        let began = Instant::now();
        let recorded = self.port.hints().and_then(|hints| hints.wall_clock());
        let (stamp, is_replayed) = (recorded.unwrap_or_else(SystemTime::now), recorded.is_some());
        let (requested, received) = (self.requested, began);
        *self.times.insert(ReplyTimes { requested, began, received, stamp, is_replayed })
    }

    /// Fails at the deadline. Polled last, so that work succeeds if it is done at its deadline.
    fn poll_deadline<T>(&mut self, cx: &mut Context<'_>) -> Poll<Result<T, NoFrame>> {
        ready!(self.deadline_timer.poll(cx, self.deadline));
        let now = Instant::now();
        if now > self.deadline + OVERSLEPT {
            // The program was stopped. What has come meanwhile is seen once tokio has asked the system.
            self.deadline = now + OVERSLEPT;
            return self.poll_deadline(cx);
        }
        Poll::Ready(Err(NoFrame::Late { after: self.deadline - self.requested }))
    }

    /// Reads more bytes into the input, and returns their number.
    fn poll_read(&mut self, cx: &mut Context<'_>) -> Poll<io::Result<usize>> {
        let outcome = poll_read(&mut self.port, cx, &mut self.input);
        let read = ready!(again_if_interrupted(outcome, &mut self.retry_timer, cx))?;
        let before = self.input.len().saturating_sub(read);
        let fresh = self.input.get(before..).unwrap_or_default();
        self.received += read as u64;
        self.greeting.add(fresh);
        Poll::Ready(self.check_flood().map(|()| read))
    }

    /// Fails if more bytes have arrived than may.
    fn check_flood(&self) -> io::Result<()> {
        let received = self.received - self.received_before;
        if received > self.limits.bytes { Err(flood(self.limits)) } else { Ok(()) }
    }
}

impl Drop for Transport {
    fn drop(&mut self) {
        if let Some(hints) = self.port.hints() {
            hints.discard_output();
        }
    }
}

/// Error for a line that sends far more than any sensor does.
#[cold]
fn flood(limits: &Limits) -> io::Error {
    let Limits { frames, bytes, .. } = limits;
    let text = format!(
        "expected at most {} KiB and {frames} replies after a command, found more: check that the port leads to a sensor",
        bytes / 1024
    );
    io::Error::new(io::ErrorKind::InvalidData, text)
}
