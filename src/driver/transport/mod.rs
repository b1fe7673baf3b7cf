//! [`Transport`]: one command out, frames in, until a deadline. It knows a port,
//! a codec and a clock, and nothing of which frame answers what.
//!
//! It also keeps the doubt about the link: whatever arrives or fails to arrive
//! against expectation makes it dirty, and only an answered fence makes it clean
//! again.

mod deadline;
mod line;
mod pause;

use std::future::{pending, poll_fn};
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::Poll;
use std::time::{Duration, SystemTime};

use bytes::{BufMut, BytesMut};
use futures_core::Stream;
use futures_sink::Sink;
use tokio::io::AsyncReadExt;
use tokio::time::Instant;
use tokio_util::codec::Framed;

use self::deadline::DeadlineTimer;
use self::line::{Line, SCRATCH_BYTES, flood};
use self::pause::Pauses;
use super::exchange::ExchangeError;
use crate::codec::{Frame, ScipCodec};
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

/// The times of a command and its reply.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Timing {
    pub(crate) requested: Instant,
    /// The time when the first byte was read.
    pub(crate) began: Instant,
    /// The time when the last byte was read.
    pub(crate) received: Instant,
    /// The wall-clock time when the first byte arrived.
    pub(crate) stamp: SystemTime,
}

/// An open port, framed.
pub(crate) struct Transport {
    framed: Framed<Line, ScipCodec>,
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
        let line = Line::new(port);
        let mut framed = Framed::with_capacity(line, ScipCodec::default(), READ_BUFFER_BYTES);
        // The capacity above is that of both buffers.
        *framed.write_buffer_mut() = BytesMut::with_capacity(WRITE_BUFFER_BYTES);
        Self {
            framed,
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
        self.framed.get_ref().baud_rate()
    }

    pub(crate) fn can_die_silently(&self) -> bool {
        self.framed.get_ref().can_die_silently()
    }

    /// Sets this side's baud rate, and drops what arrived at another one.
    pub(crate) fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        self.dirty = true;
        self.interrupted = true;
        self.drop_input();
        self.outrun = false;
        self.pauses = Pauses::default();
        let outcome = self.framed.get_mut().set_baud_rate(baud_rate);
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
        self.framed.get_ref().received()
    }

    /// Returns true if the first bytes that ever came were a telnet command.
    pub(crate) fn began_as_telnet(&self) -> bool {
        self.framed.get_ref().began_as_telnet()
    }

    /// Returns the bytes of a frame whose end has not arrived.
    pub(crate) fn unfinished_frame(&self) -> &[u8] {
        self.framed.read_buffer()
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
        let mut bytes = BytesMut::with_capacity(WRITE_BUFFER_BYTES);
        if self.interrupted {
            // Ends a command that the sensor may have in part.
            bytes.put_u8(b'\n');
        }
        bytes.put_slice(&command.bytes());
        bytes.put_u8(b'\n');
        bytes
    }

    /// Waits while no command is outstanding until bytes arrive, and drops them.
    /// Cancel-safe.
    pub(crate) async fn idle(&mut self) -> Result<(), ExchangeError> {
        // A part of a frame at most: the driver's other work has its turn
        // between two reads.
        let outcome = self.framed.get_mut().read(&mut [0; SCRATCH_BYTES]).await;
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
        let outcome = self.framed.get_mut().drain().await;
        let drained = outcome.map_err(|error| self.lost(Some(error)))?;
        let fresh = drained.ok_or_else(|| self.lost(None))?;
        let skipped = fresh + self.framed.read_buffer().len() as u64;
        if skipped > 0 {
            self.telemetry.stats().bytes_skipped += skipped;
            self.dirty = true;
            self.drop_input();
        }
        // Without it replies would use up the buffer, and come in two reads.
        self.framed.read_buffer_mut().reserve(READ_BUFFER_BYTES);
        Ok(())
    }

    /// Writes `command`, and passes each frame that comes to `judge` until that
    /// returns something: this is the only place that receives frames. A frame
    /// that `judge` passes over is counted, and makes the link dirty.
    ///
    /// The deadline is absolute: the bytes of the command and its reply at the
    /// port's baud rate, and `latency`.
    ///
    /// # Errors
    ///
    /// [`Error::Timeout`] at the deadline, and those of `judge`.
    pub(crate) async fn exchange<T>(
        &mut self,
        command: &Command,
        latency: Duration,
        mut judge: impl FnMut(&Frame, Timing) -> Option<Result<T, ExchangeError>>,
    ) -> Result<T, ExchangeError> {
        let requested = Instant::now();
        let bytes = command.bytes().len() + 1 + command.reply_len();
        let wire = self.baud_rate().map_or(Duration::ZERO, |rate| rate.wire_time(bytes));
        let (deadline, after) = (requested + wire + latency, wire + latency);
        let timeout = Err(ExchangeError::Command(Error::Timeout { command: *command, after }));
        if !self.send(command, deadline).await? {
            return timeout;
        }
        for _ in 0..MAX_FRAMES {
            let Some(frame) = self.receive(deadline).await? else { return timeout };
            let received = Instant::now();
            self.latest = Some(received);
            self.pauses.end_reply(received, &frame);
            let line = self.framed.get_ref();
            let (began, stamp) = (line.first_byte().unwrap_or(received), line.stamp());
            let timing = Timing { requested, began, received, stamp };
            if let Some(verdict) = judge(&frame, timing) {
                return verdict;
            }
            self.dirty = true;
            self.begin_reply();
            self.telemetry.stats().bytes_skipped += wire_len(&frame);
        }
        Err(self.lost(Some(flood())))
    }

    /// Writes `command`, after an LF where one is due. Returns `false` if that
    /// took too long.
    async fn send(&mut self, command: &Command, deadline: Instant) -> Result<bool, ExchangeError> {
        if self.interrupted {
            self.framed.write_buffer_mut().put_u8(b'\n');
        }
        self.framed.get_mut().begin_command();
        self.pauses.begin_reply();
        // Stays set if this future is dropped half way.
        self.interrupted = true;
        let sent = async {
            let mut framed = Pin::new(&mut self.framed);
            poll_fn(|cx| framed.as_mut().poll_ready(cx)).await?;
            framed.as_mut().start_send(command)?;
            poll_fn(|cx| framed.as_mut().poll_flush(cx)).await
        };
        match self.deadline_timer.run(deadline, sent).await {
            Some(outcome) => outcome.map_err(|error| self.lost(Some(error)))?,
            None => {
                self.framed.write_buffer_mut().clear();
                self.dirty = true;
                return Ok(false);
            }
        }
        self.interrupted = false;
        Ok(true)
    }

    /// Returns the next frame, or `None` at the deadline. A frame that is there
    /// at the deadline wins. Pauses while the rest of a reply takes its time.
    async fn receive(&mut self, deadline: Instant) -> Result<Option<Frame>, ExchangeError> {
        loop {
            let Self { framed, deadline_timer, pause_timer, pauses, .. } = self;
            let frame_or_pause = poll_fn(|cx| match Pin::new(&mut *framed).poll_next(cx) {
                Poll::Ready(frame) => Poll::Ready(Received::Frame(frame)),
                Poll::Pending => {
                    let present = framed.read_buffer();
                    let missing = framed.codec().missing(present);
                    match missing.and_then(|missing| pauses.next(present.len(), missing, deadline))
                    {
                        Some(until) if framed.get_mut().suspend_wakeups() => {
                            Poll::Ready(Received::Pause(until))
                        }
                        _ => Poll::Pending,
                    }
                }
            });
            match deadline_timer.run(deadline, frame_or_pause).await {
                Some(Received::Pause(until)) => {
                    pause_timer.run(until, pending::<()>()).await;
                }
                Some(Received::Frame(Some(frame))) => {
                    return frame.map(Some).map_err(|error| self.lost(Some(error)));
                }
                Some(Received::Frame(None)) => return Err(self.lost(None)),
                None => {
                    self.dirty = true;
                    return Ok(None);
                }
            }
        }
    }

    fn begin_reply(&mut self) {
        self.framed.get_mut().begin_reply();
        self.pauses.begin_reply();
    }

    fn drop_input(&mut self) {
        self.framed.read_buffer_mut().clear();
        self.framed.codec_mut().reset();
    }

    /// Returns the outcome of an exchange on a port that has failed with `error`, or
    /// without one at the end of its stream.
    fn lost(&self, error: Option<io::Error>) -> ExchangeError {
        match (self.framed.get_ref().is_over(), error) {
            (false, error) => ExchangeError::Lost(Error::disconnected(error)),
            (true, None) => ExchangeError::Ended(Error::Closed),
            (true, error) => ExchangeError::Ended(Error::disconnected(error)),
        }
    }
}

/// The next event of a link on which [`Transport::receive`] waits.
enum Received {
    Frame(Option<io::Result<Frame>>),
    /// The rest of the reply comes at this time at the earliest.
    Pause(Instant),
}

/// Returns how many bytes a frame had on the wire, its terminator included.
pub(crate) fn wire_len(frame: &Frame) -> u64 {
    match frame {
        Frame::Reply(bytes) => bytes.len() as u64 + 2,
        Frame::Overlong { bytes } => *bytes as u64 + 2,
    }
}
