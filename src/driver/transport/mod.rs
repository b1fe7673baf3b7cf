//! [`Transport`]: one command out, frames in, until a deadline. It knows a port,
//! a codec and a clock, and nothing of which frame answers what.
//!
//! It also keeps the doubt about the link: whatever arrives or fails to arrive
//! against expectation makes it dirty, and only an answered fence makes it clean
//! again.

mod deadline;
mod line;
mod pause;
#[cfg(test)]
mod scripted_port;
#[cfg(test)]
mod tests;

use std::future::{Future, pending, poll_fn};
use std::io;
use std::pin::pin;
use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use bytes::{Buf, BufMut, BytesMut};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::Instant;
use tokio_util::codec::Encoder;

use self::deadline::DeadlineTimer;
use self::line::{Line, SCRATCH_BYTES, flood};
use self::pause::Pauses;
use super::exchange::{ExchangeError, Judge, Timing};
use crate::codec::{Frame, ScipCodec, TERMINATOR};
use crate::port::Port;
use crate::protocol::{Command, Status};
use crate::state::Telemetry;
use crate::{BaudRate, Error};

/// Frames that may follow one command before the link counts as flooded.
const MAX_FRAMES: usize = 64;
/// The time after a reply within which a faulty line may deliver a copy of it.
const QUIET_TIME: Duration = Duration::from_millis(20);
/// Room for any reply of a sensor, the longest of which has 1,576 bytes: a read that fills
/// it would need another one to see the end. Under garbage the buffer grows to 8 KiB.
const READ_BUFFER_BYTES: usize = 1600;
/// Room for any command, and the LF before it.
const WRITE_BUFFER_BYTES: usize = 32;

/// An open port, and the buffers in front of it.
pub(crate) struct Transport {
    line: Line,
    codec: ScipCodec,
    /// The bytes that have arrived and were not judged yet. A frame is judged where it lies:
    /// to copy it out costs a fifth of decoding a scan (`benches/README.md`, item 1).
    input: BytesMut,
    /// The latest command as it was written.
    output: BytesMut,
    deadline_timer: DeadlineTimer,
    /// Ends pauses. A timer of its own: that of the deadline keeps its place.
    pause_timer: DeadlineTimer,
    pauses: Pauses,
    /// The time that a sensor may take to begin its answer, where it was set.
    latency: Option<Duration>,
    /// Something older than the next command may be on its way.
    dirty: bool,
    /// A command may have been written in part.
    interrupted: bool,
    /// True if the port can change its baud rate.
    adjustable: bool,
    /// True after a reply came faster than the port's baud rate can carry: a
    /// pseudo-terminal, a USB adapter, a server on a fast line.
    outrun: bool,
    /// The time when the latest frame came.
    latest: Option<Instant>,
    telemetry: Arc<Telemetry>,
}

impl Transport {
    pub(crate) fn new(
        port: Box<dyn Port>,
        latency: Option<Duration>,
        telemetry: Arc<Telemetry>,
    ) -> Self {
        Self {
            line: Line::new(port),
            codec: ScipCodec::default(),
            input: BytesMut::with_capacity(READ_BUFFER_BYTES),
            output: BytesMut::with_capacity(WRITE_BUFFER_BYTES),
            deadline_timer: DeadlineTimer::default(),
            pause_timer: DeadlineTimer::default(),
            pauses: Pauses::default(),
            latency,
            // Whatever the last user of the port left behind.
            dirty: true,
            interrupted: true,
            adjustable: false,
            outrun: false,
            latest: None,
            telemetry,
        }
    }

    pub(crate) fn baud_rate(&self) -> Option<BaudRate> {
        self.line.baud_rate()
    }

    pub(crate) fn can_die_silently(&self) -> bool {
        self.line.can_die_silently()
    }

    /// Sets this side's baud rate, and drops what arrived at another one.
    pub(crate) fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        self.dirty = true;
        self.interrupted = true;
        self.drop_input();
        self.outrun = false;
        self.pauses = Pauses::default();
        let outcome = self.line.set_baud_rate(baud_rate);
        let unsupported = |error: &io::Error| error.kind() == io::ErrorKind::Unsupported;
        self.adjustable = !outcome.as_ref().is_err_and(unsupported);
        outcome
    }

    /// Returns the shortest time that so many bytes take on the wire, or zero if the
    /// port has no baud rate or a reply has disproved it.
    pub(crate) fn least_wire_time(&self, bytes: usize) -> Duration {
        let baud_rate = self.baud_rate().filter(|_| !self.outrun);
        baud_rate.map_or(Duration::ZERO, |baud_rate| baud_rate.wire_time(bytes))
    }

    /// Returns true if a copy of the latest frame may still be on its way: if that frame
    /// came less than [`QUIET_TIME`] ago, over a serial line.
    pub(crate) fn may_echo(&self) -> bool {
        // Last: a look at the clock costs more than the rest.
        self.least_wire_time(1) > Duration::ZERO
            && self.latest.is_some_and(|latest| latest.elapsed() < QUIET_TIME)
    }

    /// Notes when the reply to a command with a unique echo came, which cannot be
    /// an older one. Sooner than its bytes and those of `command` take, it disproves
    /// the baud rate.
    pub(crate) fn note_unique_reply(&mut self, command: &Command, status: Status, timing: Timing) {
        let echo = command.bytes().len() + 1;
        let bytes = echo + if status.is_ok() { command.reply_len() } else { echo + 3 };
        if timing.received.saturating_duration_since(timing.requested) < self.least_wire_time(bytes)
        {
            self.outrun = true;
            self.telemetry.stats().baud_rate_outrun = true;
            tracing::debug!("replies come faster than the baud rate can carry");
        }
    }

    /// Returns whether the port can change its baud rate, as far as was tried.
    pub(crate) fn is_adjustable(&self) -> bool {
        self.adjustable
    }

    /// Returns the time that the sensor may take to begin its answer.
    pub(crate) fn latency(&self, command: &Command) -> Duration {
        let usual = match command {
            Command::Distances(_) => Duration::from_millis(500),
            _ => Duration::from_secs(1),
        };
        self.latency.unwrap_or(usual)
    }

    /// Returns the number of bytes that ever arrived.
    pub(crate) fn received(&self) -> u64 {
        self.line.received()
    }

    /// Returns true if the first bytes that ever came were a telnet command.
    pub(crate) fn began_as_telnet(&self) -> bool {
        self.line.began_as_telnet()
    }

    /// Returns the bytes of a frame whose end has not arrived.
    pub(crate) fn unfinished_frame(&self) -> &[u8] {
        &self.input
    }

    /// Returns true if a fence is needed before the next command.
    pub(crate) fn is_dirty(&self) -> bool {
        self.dirty
    }

    /// Requires a fence before the next command.
    pub(crate) fn mark_dirty(&mut self) {
        self.dirty = true;
    }

    /// Ends the doubt about the link: a fence was answered, so nothing older follows.
    pub(crate) fn mark_clean(&mut self) {
        self.dirty = false;
    }

    /// Returns the bytes that [`exchange`](Self::exchange) would write for `command`.
    pub(crate) fn outgoing(&self, command: &Command) -> BytesMut {
        let mut bytes = BytesMut::from(self.leading_line_feed());
        bytes.put_slice(&command.bytes());
        bytes.put_u8(b'\n');
        bytes
    }

    /// Returns the LF that ends a command of which the sensor may have a part, or nothing.
    fn leading_line_feed(&self) -> &'static [u8] {
        if self.interrupted { b"\n" } else { b"" }
    }

    /// Waits while no command is outstanding until bytes arrive, and drops them.
    /// Cancel-safe.
    pub(crate) async fn idle(&mut self) -> Result<(), ExchangeError> {
        // A part of a frame at most: the driver's other work has its turn
        // between two reads.
        let outcome = self.line.read(&mut [0; SCRATCH_BYTES]).await;
        let read = outcome.map_err(|error| self.lost(Some(error)))?;
        if read == 0 {
            return Err(self.lost(None));
        }
        self.telemetry.stats().bytes_skipped += read as u64;
        self.dirty = true;
        Ok(())
    }

    /// Drops the bytes that came since the last reply: they are older than the next
    /// command. Any such byte makes the link dirty.
    pub(crate) async fn discard_pending(&mut self) -> Result<(), ExchangeError> {
        let outcome = self.line.drain().await;
        let drained = outcome.map_err(|error| self.lost(Some(error)))?;
        let fresh = drained.ok_or_else(|| self.lost(None))?;
        let skipped = fresh + self.input.len() as u64;
        if skipped > 0 {
            self.telemetry.stats().bytes_skipped += skipped;
            self.dirty = true;
            self.drop_input();
        }
        // Without it replies would use up the buffer, and come in two reads.
        self.input.reserve(READ_BUFFER_BYTES);
        Ok(())
    }

    /// Writes `command`, and passes each frame that comes to `judge` until that
    /// returns something: this is the only place that receives frames. A frame
    /// that `judge` passes over is counted, and makes the link dirty. Returns the status of
    /// the answer, and its times.
    ///
    /// The deadline is absolute: the bytes of the command and its reply at the
    /// port's baud rate, and `latency`.
    ///
    /// # Errors
    ///
    /// [`Error::Timeout`] at the deadline, and those of `judge`.
    pub(crate) async fn exchange(
        &mut self,
        command: &Command,
        latency: Duration,
        judge: &mut Judge<'_>,
    ) -> Result<(Status, Timing), ExchangeError> {
        let requested = Instant::now();
        let bytes = command.bytes().len() + 1 + command.reply_len();
        let wire = self.baud_rate().map_or(Duration::ZERO, |rate| rate.wire_time(bytes));
        let (deadline, after) = (requested + wire + latency, wire + latency);
        let timeout = Err(ExchangeError::Command(Error::Timeout { command: *command, after }));
        if !self.send(command, deadline).await? {
            return timeout;
        }
        for _ in 0..MAX_FRAMES {
            let Some(found) = self.receive(deadline).await? else { return timeout };
            let received = Instant::now();
            self.latest = Some(received);
            let frame = match found {
                Frame::Reply(length) => Frame::Reply(self.input.get(..length).unwrap_or_default()),
                Frame::Overlong { bytes } => Frame::Overlong { bytes },
            };
            let wire_len = frame.wire_len();
            self.pauses.end_reply(received, wire_len);
            let (began, stamp) = (self.line.first_byte().unwrap_or(received), self.line.stamp());
            let timing = Timing { requested, began, received, stamp };
            let verdict = judge(frame, timing);
            if let Frame::Reply(length) = found {
                self.remove_reply(length);
            }
            if let Some(verdict) = verdict {
                return verdict.map(|status| (status, timing));
            }
            self.dirty = true;
            self.line.begin_reply();
            self.pauses.begin_reply();
            self.telemetry.stats().bytes_skipped += wire_len;
        }
        Err(self.lost(Some(flood())))
    }

    /// Writes `command`, after an LF where one is due. Returns `false` if that
    /// took too long.
    async fn send(&mut self, command: &Command, deadline: Instant) -> Result<bool, ExchangeError> {
        self.output.clear();
        self.output.put_slice(self.leading_line_feed());
        // Cannot fail: there is always room.
        let _ = self.codec.encode(command, &mut self.output);
        self.line.begin_command();
        self.pauses.begin_reply();
        // Stays set if this future is dropped half way.
        self.interrupted = true;
        let sent = self.line.write_all(&self.output);
        match self.deadline_timer.run(deadline, sent).await {
            Some(outcome) => outcome.map_err(|error| self.lost(Some(error)))?,
            None => {
                self.dirty = true;
                return Ok(false);
            }
        }
        self.interrupted = false;
        Ok(true)
    }

    /// Waits for a frame at the front of the input, or returns `None` at the deadline. A
    /// frame that is there at the deadline wins. Pauses while the rest of a reply takes its
    /// time.
    async fn receive(&mut self, deadline: Instant) -> Result<Option<Frame<usize>>, ExchangeError> {
        loop {
            let Self { line, codec, input, deadline_timer, pause_timer, pauses, .. } = self;
            let next = poll_fn(|cx| {
                loop {
                    if let Some(frame) = codec.find(input) {
                        return Poll::Ready(Ok(Received::Frame(frame)));
                    }
                    match pin!(line.read_buf(input)).poll(cx) {
                        Poll::Ready(Ok(0)) => return Poll::Ready(Ok(Received::End)),
                        Poll::Ready(Ok(_)) => {}
                        Poll::Ready(Err(error)) => return Poll::Ready(Err(error)),
                        Poll::Pending => break,
                    }
                }
                let missing = codec.missing(input);
                match missing.and_then(|missing| pauses.next(input.len(), missing, deadline)) {
                    Some(until) if line.suspend_wakeups() => {
                        Poll::Ready(Ok(Received::Pause(until)))
                    }
                    _ => Poll::Pending,
                }
            });
            match deadline_timer.run(deadline, next).await {
                Some(Ok(Received::Pause(until))) => {
                    pause_timer.run(until, pending::<()>()).await;
                }
                Some(Ok(Received::Frame(frame))) => return Ok(Some(frame)),
                Some(Ok(Received::End)) => return Err(self.lost(None)),
                Some(Err(error)) => return Err(self.lost(Some(error))),
                None => {
                    self.dirty = true;
                    return Ok(None);
                }
            }
        }
    }

    /// Removes a reply of this length from the front of the input.
    fn remove_reply(&mut self, length: usize) {
        let end = length + TERMINATOR;
        if end < self.input.len() {
            self.input.advance(end);
        } else {
            // Cheaper, and the next reply begins at the front of the buffer again.
            self.input.clear();
        }
    }

    fn drop_input(&mut self) {
        self.input.clear();
        self.codec.reset();
    }

    /// Returns the outcome of an exchange on a port that has failed with `error`, or
    /// without one at the end of its stream.
    fn lost(&self, error: Option<io::Error>) -> ExchangeError {
        match (self.line.is_over(), error) {
            (false, error) => ExchangeError::Lost(Error::disconnected(error)),
            (true, None) => ExchangeError::Ended(Error::Closed),
            (true, error) => ExchangeError::Ended(Error::disconnected(error)),
        }
    }
}

/// The next event of a link on which [`Transport::receive`] waits.
enum Received {
    Frame(Frame<usize>),
    /// The end of the stream.
    End,
    /// The rest of the reply comes at this time at the earliest.
    Pause(Instant),
}
