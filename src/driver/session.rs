//! One open port: the exchange of a command for its reply.
//!
//! SCIP 1.1 numbers nothing, and two polls of the same window have the same
//! echo. What makes a reply the answer to its command is that nothing older can
//! still be on its way. So everything that casts doubt on that (bytes that
//! nobody asked for, a foreign or damaged reply, a deadline that passed) makes
//! the line dirty, and a dirty line is fenced before the next command.

use std::io;
use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use bytes::BufMut;
use futures::{SinkExt, StreamExt};
use tokio::io::AsyncReadExt;
use tokio::time::Instant;
use tokio_util::codec::Framed;
use tracing::Instrument;

use super::deadline::DeadlineTimer;
use super::intake::{Intake, Item};
use super::line::{Line, READ_BUFFER, SCRATCH, flood};
use super::unique_requests::UniqueRequests;
use crate::codec::Frame;
use crate::protocol::{Command, Reply, ReplyError, Status};
use crate::state::Telemetry;
use crate::{BaudRate, Error, Window};

/// Frames that may come in answer to one command before the line counts as
/// flooded.
pub(super) const MAX_FRAMES: usize = 64;

/// Why a command got no answer.
#[derive(Debug)]
pub(crate) enum Failure {
    /// This command failed; the next one may do better.
    Command(Error),
    /// The sensor does not answer any more, on a port that seems to work.
    Silent(Error),
    /// The port is of no use any more.
    Line(Error),
}

impl From<io::Error> for Failure {
    fn from(error: io::Error) -> Self {
        Self::Line(Error::disconnected(Some(error)))
    }
}

/// What is known of an exchange besides its reply.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Timing {
    pub(crate) requested: Instant,
    pub(crate) received: Instant,
    pub(crate) stamp: SystemTime,
}

pub(crate) struct Session {
    pub(super) framed: Framed<Line, Intake>,
    deadline_timer: DeadlineTimer,
    /// How long the sensor may take to begin its answer, where not the default.
    latency: Option<Duration>,
    /// Something older than the next command may be on its way.
    pub(super) dirty: bool,
    /// A command may have been written in part.
    pub(super) interrupted: bool,
    /// Whether the port can change its speed.
    adjustable: bool,
    pub(super) unique_requests: UniqueRequests,
    /// Which part of what the last poll brought was asked for.
    polled: Range<usize>,
    pub(super) telemetry: Arc<Telemetry>,
}

impl Session {
    pub(crate) fn new(
        framed: Framed<Line, Intake>,
        latency: Option<Duration>,
        unique_requests: UniqueRequests,
        telemetry: Arc<Telemetry>,
    ) -> Self {
        Self {
            framed,
            deadline_timer: DeadlineTimer::default(),
            latency,
            // Whatever the last user of the port left behind.
            dirty: true,
            interrupted: true,
            adjustable: false,
            unique_requests,
            polled: 0..0,
            telemetry,
        }
    }

    /// Closes the port, and gives what the next session has to know.
    pub(crate) fn close(self) -> UniqueRequests {
        self.unique_requests
    }

    pub(crate) fn baud_rate(&self) -> Option<BaudRate> {
        self.framed.get_ref().baud_rate()
    }

    /// Sets this side's speed. What arrived at another one is worth nothing.
    pub(crate) fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        self.dirty = true;
        self.interrupted = true;
        self.reset_input();
        let outcome = self.framed.get_mut().set_baud_rate(baud_rate);
        let unsupported = |error: &io::Error| error.kind() == io::ErrorKind::Unsupported;
        self.adjustable = !outcome.as_ref().is_err_and(unsupported);
        outcome
    }

    /// Whether the port could change its speed when it was last asked to.
    pub(crate) fn is_adjustable(&self) -> bool {
        self.adjustable
    }

    /// How many bytes ever arrived.
    pub(crate) fn received(&self) -> u64 {
        self.framed.get_ref().received()
    }

    /// Reads while nothing is asked for, until something comes, and throws it
    /// away. Cancel-safe.
    pub(crate) async fn idle(&mut self) -> Result<(), Failure> {
        // Not a whole frame: nobody else would get a turn before its end.
        let read = self.framed.get_mut().read(&mut [0; SCRATCH]).await?;
        if read == 0 {
            return Err(Failure::Line(Error::disconnected(None)));
        }
        self.telemetry.stats().bytes_skipped += read as u64;
        self.dirty = true;
        Ok(())
    }

    /// Raises a fence if one is needed, and gives the status of its answer.
    pub(crate) async fn settle(&mut self) -> Result<Option<Status>, Failure> {
        self.discard_pending().await?;
        if !self.dirty {
            return Ok(None);
        }
        self.fence().await.map(Some)
    }

    /// Sends `command` and reads its reply with `read`.
    ///
    /// # Errors
    ///
    /// Any status but success is [`Error::Refused`].
    pub(crate) async fn command<T>(
        &mut self,
        command: Command,
        read: impl FnOnce(&Reply<'_>) -> T,
    ) -> Result<(T, Timing), Failure> {
        self.settle().await?;
        self.ask(command, read).await
    }

    /// Sends `command` on a line that is settled.
    async fn ask<T>(
        &mut self,
        command: Command,
        read: impl FnOnce(&Reply<'_>) -> T,
    ) -> Result<(T, Timing), Failure> {
        let deadline = self.deadline(&command, self.latency(&command));
        let span = tracing::trace_span!("exchange", %command);
        let exchange = async {
            let outcome = self.exchange(&command, deadline, read).await;
            if let Err(Failure::Command(error)) = &outcome {
                tracing::trace!(%error, "no answer");
            }
            outcome
        };
        let (answer, timing) = exchange.instrument(span).await?;
        match answer {
            Ok(answer) => Ok((answer, timing)),
            Err(status) => {
                self.telemetry.stats().refused += 1;
                Err(Failure::Command(Error::Refused { command, status }))
            }
        }
    }

    /// Like [`command`](Self::command), and once more if there was no answer:
    /// for commands that may be given twice.
    pub(crate) async fn command_twice<T>(
        &mut self,
        command: Command,
        read: impl Fn(&Reply<'_>) -> T,
    ) -> Result<(T, Timing), Failure> {
        match self.command(command, &read).await {
            Err(Failure::Command(Error::Timeout { .. } | Error::Malformed { .. })) => {
                self.command(command, &read).await
            }
            outcome => outcome,
        }
    }

    /// Polls `window`; its [`values`](Self::values) are there afterwards.
    pub(crate) async fn poll(&mut self, window: Window) -> Result<Timing, Failure> {
        // First: what a fence clears must not be this poll.
        self.settle().await?;
        let (asked, surplus) = self.unique_requests.poll(window);
        self.telemetry.stats().polls += 1;
        let ((), timing) = self.ask(Command::Distances(asked), |_| ()).await?;
        let mut stats = self.telemetry.stats();
        stats.scans += 1;
        stats.reply_latency.add(timing.received - timing.requested);
        drop(stats);
        self.polled = surplus..surplus + window.points();
        Ok(timing)
    }

    /// The values that the last successful poll brought, one for each point.
    pub(crate) fn values(&self) -> &[u16] {
        self.framed.codec().values().get(self.polled.clone()).unwrap_or_default()
    }

    /// Whether a fence is needed before the next command.
    pub(crate) fn is_dirty(&self) -> bool {
        self.dirty
    }

    /// Forgets everything that arrived, at what may have been another speed.
    fn reset_input(&mut self) {
        self.framed.read_buffer_mut().clear();
        self.framed.codec_mut().reset();
    }

    /// Writes `command` and waits for its reply: what `read` makes of it, or a
    /// status that is not success.
    async fn exchange<T>(
        &mut self,
        command: &Command,
        deadline: Instant,
        read: impl FnOnce(&Reply<'_>) -> T,
    ) -> Result<(Result<T, Status>, Timing), Failure> {
        let (command, requested) = (*command, Instant::now());
        let timeout = Failure::Command(Error::Timeout { command, after: deadline - requested });
        if !self.send(&command, deadline).await? {
            self.telemetry.stats().timeouts += 1;
            return Err(timeout);
        }
        for _ in 0..MAX_FRAMES {
            let Some(item) = self.receive(deadline).await? else {
                self.telemetry.stats().timeouts += 1;
                return Err(timeout);
            };
            let frame = match item {
                Item::Scan => return Ok((Ok(read(&Reply::SCAN)), self.timing(requested))),
                Item::Frame(frame) => frame,
            };
            if let Frame::Reply(bytes) = &frame {
                let outcome = Reply::parse(&command, bytes);
                let foreign = matches!(outcome, Err(ReplyError::Foreign { .. }));
                self.framed.get_ref().hear((!foreign).then_some(command), bytes);
                let error = match outcome {
                    Ok(reply) => {
                        let (timing, status) = (self.timing(requested), reply.status());
                        let done = status.is_ok_for(&command);
                        if let (Command::Distances(_), true) = (command, done) {
                            self.framed.codec_mut().take_values(&reply);
                        }
                        return Ok((if done { Ok(read(&reply)) } else { Err(status) }, timing));
                    }
                    Err(error) => error,
                };
                self.dirty = true;
                self.telemetry.stats().malformed.count(&error);
                match error {
                    ReplyError::Malformed(source) => {
                        return Err(Failure::Command(Error::Malformed { command, source }));
                    }
                    ReplyError::Scip2 { status } => {
                        return Err(Failure::Command(Error::WrongProtocol { status }));
                    }
                    ReplyError::Foreign { .. } => {}
                }
            }
            self.dirty = true;
            self.skip(&frame);
        }
        Err(flood().into())
    }

    /// Writes a command, after an LF where one is due. False if that took too
    /// long.
    pub(super) async fn send(
        &mut self,
        command: &Command,
        deadline: Instant,
    ) -> Result<bool, Failure> {
        if self.interrupted {
            self.framed.write_buffer_mut().put_u8(b'\n');
        }
        self.framed.get_mut().begin_command();
        // Stays set if this future is dropped half way.
        self.interrupted = true;
        match self.deadline_timer.run(deadline, self.framed.send(command)).await {
            Some(outcome) => outcome?,
            None => {
                self.framed.write_buffer_mut().clear();
                self.dirty = true;
                return Ok(false);
            }
        }
        self.interrupted = false;
        Ok(true)
    }

    /// What comes next, or `None` at the deadline.
    pub(super) async fn receive(&mut self, deadline: Instant) -> Result<Option<Item>, Failure> {
        // Looks at the line before it looks at the clock.
        match self.deadline_timer.run(deadline, self.framed.next()).await {
            Some(Some(item)) => Ok(Some(item?)),
            Some(None) => Err(Failure::Line(Error::disconnected(None))),
            None => {
                self.dirty = true;
                Ok(None)
            }
        }
    }

    /// Throws away what came since the last reply: it is older than the next
    /// command. That something came makes the line dirty.
    pub(super) async fn discard_pending(&mut self) -> Result<(), Failure> {
        let drained = self.framed.get_mut().drain().await?;
        let fresh = drained.ok_or_else(|| Failure::Line(Error::disconnected(None)))?;
        let skipped = fresh + self.framed.read_buffer().len() as u64;
        if skipped > 0 {
            self.telemetry.stats().bytes_skipped += skipped;
            self.dirty = true;
            self.reset_input();
        }
        // Or replies would use up the buffer, and come in two reads each time.
        self.framed.read_buffer_mut().reserve(READ_BUFFER);
        Ok(())
    }

    /// Counts a frame that nobody asked for, and waits for the next.
    pub(super) fn skip(&mut self, frame: &Frame) {
        self.framed.get_mut().begin_reply();
        let mut stats = self.telemetry.stats();
        stats.bytes_skipped += match frame {
            Frame::Reply(bytes) => bytes.len() as u64 + 2,
            Frame::Overlong { bytes } => {
                stats.malformed.overlong += 1;
                *bytes as u64 + 2
            }
        };
    }

    pub(crate) fn latency(&self, command: &Command) -> Duration {
        let usual = match command {
            Command::Distances(_) => Duration::from_millis(500),
            _ => Duration::from_secs(1),
        };
        self.latency.unwrap_or(usual)
    }

    pub(super) fn deadline(&self, command: &Command, latency: Duration) -> Instant {
        let bytes = command.bytes().len() + 1 + command.reply_len();
        let wire = self.baud_rate().map_or(Duration::ZERO, |baud_rate| baud_rate.wire_time(bytes));
        Instant::now() + wire + latency
    }

    fn timing(&self, requested: Instant) -> Timing {
        Timing { requested, received: Instant::now(), stamp: self.framed.get_ref().stamp() }
    }
}
