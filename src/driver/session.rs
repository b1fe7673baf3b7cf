//! One open port: the exchange of a command for its reply, and the fence that
//! keeps replies from being taken for each other.
//!
//! SCIP 1.1 numbers nothing, and two polls of the same window have the same
//! echo. What makes a reply the answer to its command is that nothing older can
//! still be on its way. So everything that casts doubt on that (bytes that
//! nobody asked for, a foreign or damaged reply, a deadline that passed) makes
//! the line dirty, and a dirty line is fenced before the next command: a
//! single-step `G`, a different one each time, is sent until it is answered.
//! Replies come in order, so nothing older can follow that answer.

use std::future::poll_fn;
use std::io;
use std::ops::Range;
use std::pin::Pin;
use std::sync::Arc;
use std::task::Poll;
use std::time::{Duration, SystemTime};

use bytes::{BufMut, BytesMut};
use futures::{SinkExt, StreamExt};
use tokio::io::{AsyncRead, ReadBuf};
use tokio::time::{Instant, timeout_at};
use tokio_util::codec::Framed;
use tracing::Instrument;

use super::Config;
use super::line::Line;
use super::single_steps::SingleSteps;
use crate::codec::{Frame, ScipCodec};
use crate::port::Port;
use crate::protocol::{Command, Malformed, Reply, ReplyError, Status};
use crate::state::Telemetry;
use crate::tap::{Heard, Tap};
use crate::{BaudRate, Error, Window};

/// Fences sent before a line counts as lost.
const FENCES: usize = 6;
/// Frames and bytes that may come in answer to one command before the line
/// counts as flooded.
const MAX_FRAMES: usize = 64;
const MAX_BYTES: u64 = 64 * 1024;
/// Room for any reply of a sensor; the buffer grows to twice that under
/// garbage.
const READ_BUFFER: usize = 4096;

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

/// How a command may end without a fault of the line.
struct Exchanged<T> {
    reply: T,
    timing: Timing,
}

pub(crate) struct Session {
    framed: Framed<Line, ScipCodec>,
    /// How long the sensor may take to begin its answer, where not the default.
    latency: Option<Duration>,
    /// Something older than the next command may be on its way.
    dirty: bool,
    /// A command may have been written in part.
    interrupted: bool,
    /// Whether the port can change its speed.
    adjustable: bool,
    /// The step of the next fence.
    fence: u16,
    /// Single steps that were asked for since the last answered fence.
    asked: SingleSteps,
    /// The windows of the last polls.
    recent: [Option<Window>; 3],
    /// What the last poll brought, and which part of it was asked for.
    values: Vec<u16>,
    polled: Range<usize>,
    tap: Tap,
    telemetry: Arc<Telemetry>,
}

impl Session {
    pub(crate) fn new(port: Box<dyn Port>, config: &Config, telemetry: Arc<Telemetry>) -> Self {
        Self {
            framed: Framed::with_capacity(Line::new(port), ScipCodec::default(), READ_BUFFER),
            latency: config.reply_latency,
            // Whatever the last user of the port left behind.
            dirty: true,
            interrupted: true,
            adjustable: false,
            fence: 0,
            asked: SingleSteps::default(),
            recent: [None; 3],
            values: Vec::new(),
            polled: 0..0,
            tap: config.tap.clone(),
            telemetry,
        }
    }

    pub(crate) fn line_speed(&self) -> Option<BaudRate> {
        self.framed.get_ref().line_speed()
    }

    /// Sets this side's speed. What arrived at another one is worth nothing.
    pub(crate) fn set_line_speed(&mut self, speed: BaudRate) -> io::Result<()> {
        self.dirty = true;
        self.interrupted = true;
        self.reset_input();
        let outcome = self.framed.get_mut().set_line_speed(speed);
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

    /// Reads while nothing is asked for, until something comes. Cancel-safe.
    pub(crate) async fn idle(&mut self) -> Result<(), Failure> {
        match self.framed.next().await {
            Some(Ok(frame)) => {
                if let Frame::Reply(bytes) = &frame {
                    self.hear(bytes, None);
                }
                self.skip(&frame);
                self.dirty = true;
                Ok(())
            }
            Some(Err(error)) => Err(error.into()),
            None => Err(Failure::Line(Error::disconnected(None))),
        }
    }

    /// Raises a fence if one is needed.
    pub(crate) async fn settle(&mut self) -> Result<(), Failure> {
        self.discard_pending().await?;
        if self.dirty {
            self.fence().await?;
        }
        Ok(())
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
        let deadline = self.deadline(&command, self.latency(&command));
        let span = tracing::trace_span!("exchange", %command);
        let exchange = async {
            let outcome = self.exchange(&command, deadline, read).await;
            if let Err(Failure::Command(error)) = &outcome {
                tracing::trace!(%error, "no answer");
            }
            outcome
        };
        let answer = exchange.instrument(span).await?;
        match answer.reply {
            Ok(reply) => Ok((reply, answer.timing)),
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
    ///
    /// What is asked for differs from the polls before, where the window leaves
    /// room for that, so that even a reply that a faulty line delivers twice is
    /// never taken for the next.
    pub(crate) async fn poll(&mut self, window: Window) -> Result<Timing, Failure> {
        let (asked, surplus) = (0..=self.recent.len() as u16)
            .filter_map(|groups| window.widened(groups))
            .find(|(asked, _)| !self.recent.contains(&Some(*asked)))
            .unwrap_or((window, 0));
        self.recent.rotate_right(1);
        if let Some(newest) = self.recent.first_mut() {
            *newest = Some(asked);
        }
        let mut values = std::mem::take(&mut self.values);
        values.clear();
        self.telemetry.stats().polls += 1;
        let outcome =
            self.command(Command::Distances(asked), |reply| reply.values_into(&mut values)).await;
        self.values = values;
        let ((), timing) = outcome?;
        let mut stats = self.telemetry.stats();
        stats.scans += 1;
        stats.reply_latency.add(timing.received - timing.requested);
        drop(stats);
        self.polled = surplus..surplus + window.points();
        Ok(timing)
    }

    /// The values that the last successful poll brought, one for each point.
    pub(crate) fn values(&self) -> &[u16] {
        self.values.get(self.polled.clone()).unwrap_or_default()
    }

    /// Whether a fence is needed before the next command.
    pub(crate) fn is_dirty(&self) -> bool {
        self.dirty
    }

    /// Sends single-step `G`s until the latest of them is answered, and gives
    /// the status of that answer.
    pub(crate) async fn fence(&mut self) -> Result<Status, Failure> {
        let mut failure = Failure::Silent(Error::disconnected(None));
        for _ in 0..FENCES {
            match self.fence_once(self.latency(&Command::Distances(Window::single(0)))).await {
                Err(Failure::Command(error)) => failure = Failure::Silent(error),
                outcome => return outcome,
            }
        }
        Err(failure)
    }

    /// One fence, answered within `latency`.
    pub(crate) async fn fence_once(&mut self, latency: Duration) -> Result<Status, Failure> {
        let command = self.next_fence();
        self.dirty = true;
        self.telemetry.stats().fences += 1;
        let deadline = self.deadline(&command, latency);
        let span = tracing::trace_span!("fence", %command);
        let answer = self.exchange_fence(&command, deadline).instrument(span).await;
        match &answer {
            Ok(_) => {
                self.dirty = false;
                self.asked.clear();
            }
            Err(_) => self.telemetry.stats().fence_timeouts += 1,
        }
        answer
    }

    /// Forgets everything that arrived, at what may have been another speed.
    fn reset_input(&mut self) {
        self.framed.read_buffer_mut().clear();
        self.framed.codec_mut().reset();
    }

    async fn exchange<T>(
        &mut self,
        command: &Command,
        deadline: Instant,
        read: impl FnOnce(&Reply<'_>) -> T,
    ) -> Result<Exchanged<Result<T, Status>>, Failure> {
        if let Command::Distances(window) = command {
            self.asked.insert(*window);
        }
        let (requested, after) = (Instant::now(), deadline - Instant::now());
        let mut flood = Flood::new(self.framed.get_ref());
        if !self.send(command, deadline).await? {
            self.telemetry.stats().timeouts += 1;
            return Err(Failure::Command(Error::Timeout { command: *command, after }));
        }
        loop {
            let Some(frame) = self.receive(deadline).await? else {
                self.telemetry.stats().timeouts += 1;
                return Err(Failure::Command(Error::Timeout { command: *command, after }));
            };
            let bytes = match &frame {
                Frame::Reply(bytes) => bytes,
                Frame::Overlong { .. } => {
                    self.skip(&frame);
                    self.dirty = true;
                    flood.check(self.framed.get_ref())?;
                    continue;
                }
            };
            let outcome = Reply::parse(command, bytes);
            let foreign = matches!(outcome, Err(ReplyError::Foreign { .. }));
            self.hear(bytes, (!foreign).then_some(*command));
            match outcome {
                Ok(reply) => {
                    let timing = self.timing(requested);
                    let status = reply.status();
                    let reply =
                        if status.is_ok_for(command) { Ok(read(&reply)) } else { Err(status) };
                    return Ok(Exchanged { reply, timing });
                }
                Err(error) => {
                    self.dirty = true;
                    self.telemetry.stats().malformed.count(&error);
                    match error {
                        ReplyError::Malformed(source) => {
                            let command = *command;
                            return Err(Failure::Command(Error::Malformed { command, source }));
                        }
                        ReplyError::Scip2 { status } => {
                            return Err(Failure::Command(Error::WrongProtocol { status }));
                        }
                        ReplyError::Foreign { .. } => {
                            self.skip(&frame);
                            flood.check(self.framed.get_ref())?;
                        }
                    }
                }
            }
        }
    }

    /// Sends a fence and waits for its answer, whatever comes before.
    async fn exchange_fence(
        &mut self,
        command: &Command,
        deadline: Instant,
    ) -> Result<Status, Failure> {
        let after = deadline - Instant::now();
        let mut flood = Flood::new(self.framed.get_ref());
        let mut sent = BytesMut::with_capacity(16);
        if self.interrupted {
            // Ends a command that the sensor may have in part.
            sent.put_u8(b'\n');
        }
        sent.extend_from_slice(&command.bytes());
        sent.put_u8(b'\n');
        let timeout = Failure::Command(Error::Timeout { command: *command, after });
        if !self.send(command, deadline).await? {
            return Err(timeout);
        }
        loop {
            let Some(frame) = self.receive(deadline).await? else {
                return Err(self.explain_silence(&sent, command).unwrap_or(timeout));
            };
            if let Frame::Reply(bytes) = &frame {
                self.hear(bytes, None);
                match Reply::parse_end(command, bytes) {
                    Ok(_) if is_echoed(&sent, command, bytes) => {
                        return Err(Failure::Line(Error::Loopback));
                    }
                    Ok(reply) => return Ok(reply.status()),
                    Err(ReplyError::Scip2 { status }) => {
                        return Err(Failure::Command(Error::WrongProtocol { status }));
                    }
                    Err(error) => self.telemetry.stats().malformed.count(&error),
                }
            }
            self.skip(&frame);
            flood.check(self.framed.get_ref())?;
        }
    }

    /// What the unfinished frame tells when nothing else came in answer to
    /// `sent`.
    fn explain_silence(&self, sent: &[u8], command: &Command) -> Option<Failure> {
        let pending = self.framed.read_buffer();
        if pending.starts_with(b"\n") && *pending == sent {
            return Some(Failure::Line(Error::Loopback));
        }
        // At a wrong speed any bytes may come, so only a line that cannot have
        // one counts as telnet.
        let telnet = !self.adjustable && matches!(**pending, [0xff, 0xfb..=0xfe, ..]);
        let echo = [&command.bytes(), &b"\r\n"[..]].concat();
        let translated = pending.windows(echo.len()).any(|part| part == echo);
        (telnet || translated).then(|| {
            let (command, source) = (*command, Malformed::NotRaw);
            Failure::Command(Error::Malformed { command, source })
        })
    }

    /// Writes a command, after an LF where one is due. False if that took too
    /// long.
    async fn send(&mut self, command: &Command, deadline: Instant) -> Result<bool, Failure> {
        if self.interrupted {
            self.framed.write_buffer_mut().put_u8(b'\n');
        }
        self.framed.get_mut().expect();
        // Stays set if this future is dropped half way.
        self.interrupted = true;
        match timeout_at(deadline, self.framed.send(command)).await {
            Ok(outcome) => outcome?,
            Err(_) => {
                self.framed.write_buffer_mut().clear();
                self.dirty = true;
                return Ok(false);
            }
        }
        self.interrupted = false;
        Ok(true)
    }

    /// The next frame, or `None` at the deadline.
    async fn receive(&mut self, deadline: Instant) -> Result<Option<Frame>, Failure> {
        // Looks at the line before it looks at the clock.
        match timeout_at(deadline, self.framed.next()).await {
            Ok(Some(frame)) => Ok(Some(frame?)),
            Ok(None) => Err(Failure::Line(Error::disconnected(None))),
            Err(_) => {
                self.dirty = true;
                Ok(None)
            }
        }
    }

    /// Throws away what came since the last reply: it is older than the next
    /// command. That something came makes the line dirty.
    async fn discard_pending(&mut self) -> Result<(), Failure> {
        // Lets the runtime see what the system has.
        tokio::task::yield_now().await;
        let line = self.framed.get_mut();
        let before = line.received();
        let mut scratch = [0; 512];
        let closed = poll_fn(|cx| {
            loop {
                let mut buffer = ReadBuf::new(&mut scratch);
                match Pin::new(&mut *line).poll_read(cx, &mut buffer) {
                    Poll::Ready(Ok(())) if buffer.filled().is_empty() => {
                        return Poll::Ready(Ok(true));
                    }
                    Poll::Ready(Ok(())) if line.received() - before > MAX_BYTES => break,
                    Poll::Ready(Ok(())) => {}
                    Poll::Ready(Err(error)) => return Poll::Ready(Err(error)),
                    Poll::Pending => break,
                }
            }
            Poll::Ready(Ok(false))
        })
        .await?;
        if closed {
            return Err(Failure::Line(Error::disconnected(None)));
        }
        let fresh = line.received() - before;
        let skipped = fresh + self.framed.read_buffer().len() as u64;
        if skipped > 0 {
            self.telemetry.stats().bytes_skipped += skipped;
            self.dirty = true;
            self.reset_input();
        }
        Ok(())
    }

    /// Lets the tap hear a frame that answers `command`, or no command that was
    /// to bring anything.
    fn hear(&self, bytes: &[u8], command: Option<Command>) {
        self.tap.hear(|| {
            let stamp = self.framed.get_ref().arrival().unwrap_or_else(SystemTime::now);
            Heard { command, bytes, received_at: Instant::now().into_std(), stamp }
        });
    }

    /// Counts a frame that nobody asked for.
    fn skip(&self, frame: &Frame) {
        let mut stats = self.telemetry.stats();
        stats.bytes_skipped += match frame {
            Frame::Reply(bytes) => bytes.len() as u64 + 2,
            Frame::Overlong { bytes } => {
                stats.malformed.overlong += 1;
                *bytes as u64 + 2
            }
        };
    }

    fn next_fence(&mut self) -> Command {
        for _ in 0..SingleSteps::COUNT {
            if !self.asked.contains(self.fence) {
                break;
            }
            self.advance_fence();
        }
        let command = Command::Distances(Window::single(self.fence));
        self.advance_fence();
        command
    }

    fn advance_fence(&mut self) {
        self.fence = (self.fence + 1) % SingleSteps::COUNT;
    }

    pub(crate) fn latency(&self, command: &Command) -> Duration {
        let usual = match command {
            Command::Distances(_) => Duration::from_millis(500),
            _ => Duration::from_secs(1),
        };
        self.latency.unwrap_or(usual)
    }

    fn deadline(&self, command: &Command, latency: Duration) -> Instant {
        let bytes = command.bytes().len() + 1 + command.reply_len();
        let wire = self.line_speed().map_or(Duration::ZERO, |speed| speed.wire_time(bytes));
        Instant::now() + wire + latency
    }

    fn timing(&self, requested: Instant) -> Timing {
        let received = Instant::now();
        let stamp = self.framed.get_ref().arrival().unwrap_or_else(SystemTime::now);
        Timing { requested, received, stamp }
    }
}

/// Whether `frame` is what was sent, and then a reply to it.
fn is_echoed(sent: &[u8], command: &Command, frame: &[u8]) -> bool {
    frame.strip_prefix(sent).is_some_and(|rest| rest.starts_with(&command.bytes()))
}

/// Notices when far more comes than any sensor sends.
struct Flood {
    frames: usize,
    bytes: u64,
}

impl Flood {
    fn new(line: &Line) -> Self {
        Self { frames: 0, bytes: line.received() }
    }

    /// To be called for each frame that was not asked for.
    fn check(&mut self, line: &Line) -> Result<(), Failure> {
        self.frames += 1;
        if self.frames > MAX_FRAMES || line.received() - self.bytes > MAX_BYTES {
            let text = "far more comes than any sensor sends";
            return Err(io::Error::new(io::ErrorKind::InvalidData, text).into());
        }
        Ok(())
    }
}
