//! [`Session`] for SCIP 1.1: one command is outstanding at a time.
//!
//! SCIP 1.1 numbers nothing, and two polls of the same window have the same echo. A reply
//! answers its command only because no older reply can still be on its way. Three things cast
//! doubt on that: unsolicited bytes, a malformed reply, and a missed deadline. So a command
//! leaves the link unsettled until its reply is accepted, and an unsettled link is fenced before
//! the next command.
//!
//! `fence` proves that no older reply can follow, and `unique_requests` chooses what each `G`
//! asks for.

mod baud_rate;
mod errors;
mod fence;
mod identity;
mod laser;
mod scip2_model;
mod unique_requests;

use std::io;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::time::Instant;

use self::errors::{bad_reply, no_reply, on_behalf_of, refused};
use self::unique_requests::UniqueRequests;
use super::super::failure::{ExchangeError, LinkError};
use super::super::observers::ReplyObservers;
use super::super::transport::{Expected, Limits, NoFrame, ReceivedFrame, ReplyTimes, Transport};
use super::Acquired;
use crate::RawReply;
use crate::codec::{ExpectedReply, FoundFrame, MAX_FRAME};
use crate::port::Port;
use crate::protocol::{Command, MalformedError, Reply, ReplyError, Status};
use crate::state::Telemetry;
use crate::{BaudRate, ErrorKind, Window};

/// A sensor answers a command with one frame of at most 1,576 bytes.
const LIMITS: Limits = Limits { frame: MAX_FRAME, frames: 64, bytes: 64 * 1024 };
/// How long after a reply a faulty line may deliver a copy of it.
const COPY_TIME: Duration = Duration::from_millis(20);

/// Stands for all commands that are answered like a scan.
const ANY_SCAN: Command = Command::Distances(Window::FULL);

/// Reply to a command.
#[derive(Debug)]
struct Answer {
    reply: Reply,
    times: ReplyTimes,
}

/// Which other replies may still be on their way with the echo of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum EchoKind {
    /// No other reply. If this one arrives too fast for its bytes, the baud rate is
    /// wrong.
    Unique,
    /// The latest reply. If this one arrives too fast, it is a copy of the latest.
    Repeated,
    /// Any reply to this kind of command.
    Common,
}

/// What a session leaves for the next one.
#[derive(Debug, Default)]
pub(crate) struct Leftovers {
    /// The system keeps bytes that arrive while a port is closed, so the next session may read
    /// replies to these.
    unique_requests: UniqueRequests,
    /// True if the sensor may hold part of a command. An LF ends it, and can cost a revolution.
    interrupted: bool,
}

impl Leftovers {
    /// Before the first session, an earlier program may have left replies to anything.
    pub(crate) fn unknown() -> Self {
        Self { unique_requests: UniqueRequests::random(), interrupted: false }
    }
}

pub(crate) struct Session {
    transport: Transport,
    /// True if no reply older than the next command can be on its way.
    is_settled: bool,
    /// True once a reply arrived faster than the port's baud rate allows, as on a
    /// pseudo-terminal, a USB adapter or a server on a fast line.
    is_baud_rate_disproved: bool,
    unique_requests: UniqueRequests,
    /// How long the sensor may take to begin its answer, if set.
    reply_latency: Option<Duration>,
    observers: Arc<ReplyObservers>,
    telemetry: Arc<Telemetry>,
}

impl Session {
    pub(crate) fn new(
        port: Box<dyn Port>,
        reply_latency: Option<Duration>,
        before: Leftovers,
        observers: Arc<ReplyObservers>,
        telemetry: Arc<Telemetry>,
    ) -> Self {
        let Leftovers { unique_requests, interrupted } = before;
        telemetry.stats().baud_rate_disproved = false;
        Self {
            transport: Transport::new(port, &LIMITS, interrupted),
            // The last user of the port may have left bytes behind.
            is_settled: false,
            is_baud_rate_disproved: false,
            unique_requests,
            reply_latency,
            observers,
            telemetry,
        }
    }

    /// Closes the port.
    pub(crate) fn close(self) -> Leftovers {
        let interrupted = self.transport.is_interrupted();
        Leftovers { unique_requests: self.unique_requests, interrupted }
    }

    /// Returns true while the driver is closing. A silent sensor then gets no second try.
    fn is_closing(&self) -> bool {
        self.telemetry.is_closing()
    }

    /// Returns true if the next command has to be preceded by a [`probe`](Self::probe), as far as
    /// known without reading.
    pub(crate) fn is_in_doubt(&self) -> bool {
        !self.is_settled || !self.transport.pending().is_empty()
    }

    /// Waits for unsolicited bytes. The session is [in doubt](Self::is_in_doubt) then.
    pub(crate) fn poll_unasked(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), LinkError>> {
        self.transport.poll_idle(cx)
    }

    /// When the sensor was last heard.
    pub(crate) fn heard_at(&self) -> Option<Instant> {
        self.transport.latest_at()
    }

    pub(crate) fn can_die_silently(&mut self) -> bool {
        self.transport.can_die_silently()
    }

    pub(crate) fn delivers_intact(&mut self) -> bool {
        self.transport.delivers_intact()
    }

    /// Baud rate of the port, unless it has none.
    pub(crate) fn baud_rate(&self) -> Option<BaudRate> {
        self.transport.baud_rate()
    }

    /// Baud rate of the line, unless it has none or a reply has disproved it.
    pub(crate) fn believed_baud_rate(&self) -> Option<BaudRate> {
        self.baud_rate().filter(|_| !self.is_baud_rate_disproved)
    }

    /// Returns true if the sensor can be searched for at several baud rates.
    pub(crate) fn is_searchable(&self) -> bool {
        self.transport.is_adjustable() && self.baud_rate().is_some()
    }

    /// Drops pending input, and sends fences until one is answered. Returns true if the sensor
    /// measures: it refuses to while its laser is off.
    pub(crate) async fn probe(&mut self) -> Result<bool, ExchangeError> {
        self.discard_pending().await?;
        self.fence().await.map(Status::is_ok)
    }

    /// Asks for the values of `window`.
    pub(crate) async fn acquire(&mut self, window: Window) -> Result<Acquired, ExchangeError> {
        let wanted = Command::Distances(window);
        // First, so that the fence's `clear` cannot forget this request.
        if !self.is_quiet()? {
            self.settle().await.map_err(on_behalf_of(wanted))?;
        }
        let mut widened = self.unique_requests.widen(window);
        if widened.repeats && self.may_be_copied() {
            // A copy of the latest reply would match this request.
            Box::pin(self.fence()).await.map_err(on_behalf_of(wanted))?;
            widened = self.unique_requests.widen(window);
        }
        self.telemetry.count_poll();
        let echo = if widened.repeats { EchoKind::Repeated } else { EchoKind::Unique };
        let command = Command::Distances(widened.asked);
        let Answer { reply, times } = accepted(&command, self.exchange(command, echo).await?)?;
        Ok(Acquired { values: reply.into_values(), first: widened.first, times })
    }

    /// Returns when [`acquire`](Self::acquire) of this window needs no fence to rule out a copy of
    /// the latest reply, or `None` if it needs no fence now.
    pub(crate) fn copies_end(&self, window: Window) -> Option<Instant> {
        let may_match = self.may_be_copied() && self.unique_requests.repeats(window);
        self.transport.latest_at().filter(|_| may_match).map(|latest| latest + COPY_TIME)
    }

    /// Sets this side's baud rate. Forgets what is known of the line at the former one.
    async fn set_port_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        self.is_settled = false;
        self.is_baud_rate_disproved = false;
        self.telemetry.stats().baud_rate_disproved = false;
        self.transport.set_baud_rate(baud_rate).await
    }

    /// Drops pending input. Bytes without a command cast doubt on the link.
    async fn discard_pending(&mut self) -> Result<(), ExchangeError> {
        let dropped = self.transport.discard_pending().await?;
        self.record_dropped(dropped);
        Ok(())
    }

    /// Drops pending input if that needs no waiting. Returns true if there is no doubt about the link
    /// then.
    fn is_quiet(&mut self) -> Result<bool, ExchangeError> {
        match self.transport.try_discard_pending() {
            Some(dropped) => {
                self.record_dropped(dropped?);
                Ok(self.is_settled)
            }
            None => Ok(false),
        }
    }

    fn record_dropped(&mut self, bytes: u64) {
        if bytes > 0 {
            self.is_settled = false;
            self.telemetry.stats().bytes_skipped += bytes;
        }
    }

    /// Drops pending input, and sends a fence if there is doubt about the link.
    async fn settle(&mut self) -> Result<(), ExchangeError> {
        self.discard_pending().await?;
        if self.is_settled { Ok(()) } else { Box::pin(self.fence()).await.map(drop) }
    }

    /// Returns true if a copy of the latest frame may still be on its way: on a serial line, for
    /// [`COPY_TIME`] after the frame.
    fn may_be_copied(&self) -> bool {
        // Last, because reading the clock costs more than the rest.
        self.believed_baud_rate().is_some()
            && self.transport.latest_at().is_some_and(|latest| latest.elapsed() < COPY_TIME)
    }

    /// Sends `command`, and returns its reply, whatever its status.
    async fn command(&mut self, command: Command) -> Result<Answer, ExchangeError> {
        self.settle().await.map_err(on_behalf_of(command))?;
        self.exchange(command, EchoKind::Common).await
    }

    /// Like [`command`](Self::command), but sends the command once more if there was no
    /// answer. Only for commands that may be sent twice.
    async fn command_twice(&mut self, command: Command) -> Result<Answer, ExchangeError> {
        match self.command(command).await {
            Err(ExchangeError::Command(
                ErrorKind::Timeout { .. } | ErrorKind::Malformed { .. },
            )) if !self.is_closing() => self.command(command).await,
            outcome => outcome,
        }
    }

    /// Sends `command` on a settled link, and judges the next frame: it is the answer, or
    /// the command has failed. Waiting for a better frame would cost the whole deadline
    /// each time a reply is damaged.
    async fn exchange(
        &mut self,
        command: Command,
        echo: EchoKind,
    ) -> Result<Answer, ExchangeError> {
        self.is_settled = false;
        let within = self.time_limit(&command, self.latency(&command));
        let baud_rate = self.believed_baud_rate();
        let bytes = command.bytes();
        let expected = expected(&command, &bytes);
        let received = match self.transport.ask(&bytes, &expected, within).await {
            Ok(received) => received,
            Err(failure) => return Err(record_silence(&self.telemetry, &command, failure)),
        };
        let (times, wire_len) = (received.times, received.wire_len());
        match judge(&command, echo, received, baud_rate, &self.observers) {
            Ok(reply) => {
                self.is_settled = true;
                if !reply.status().is_ok_for(&command) {
                    self.record_refusal();
                } else if echo == EchoKind::Unique {
                    self.check_speed(&command, reply.status(), &times);
                }
                Ok(Answer { reply, times })
            }
            Err(error) => Err(self.record_malformed(command, error, wire_len)),
        }
    }

    /// How long the sensor may take to begin its answer.
    fn latency(&self, command: &Command) -> Duration {
        let usual = match command {
            Command::Distances(_) => Duration::from_millis(500),
            _ => Duration::from_secs(1),
        };
        self.reply_latency.unwrap_or(usual)
    }

    /// How long an exchange may take: `latency`, and the time of its bytes on the wire.
    fn time_limit(&self, command: &Command, latency: Duration) -> Duration {
        let wire_time = |baud_rate| command.wire_time(baud_rate);
        self.transport.baud_rate().map_or(Duration::ZERO, wire_time) + latency
    }

    #[cold]
    fn record_refusal(&mut self) {
        self.telemetry.stats().refused += 1;
    }

    #[cold]
    fn record_malformed(
        &mut self,
        command: Command,
        error: ReplyError,
        wire_len: u64,
    ) -> ExchangeError {
        let mut stats = self.telemetry.stats();
        stats.malformed.count(&error);
        if !is_echoed(&error) {
            stats.bytes_skipped += wire_len;
        }
        drop(stats);
        let error = bad_reply(&command, error);
        tracing::trace!(%error, "no answer");
        ExchangeError::Command(error)
    }

    /// Checks whether the latest reply arrived faster than its bytes and the bytes of its `command`
    /// can: then the port's baud rate is wrong. The command's echo must be unique, so that the
    /// reply cannot be an older one.
    fn check_speed(&mut self, command: &Command, status: Status, times: &ReplyTimes) {
        let Some(baud_rate) = self.believed_baud_rate() else { return };
        let echo = command.bytes().len() + 1;
        let bytes = echo + if status.is_ok() { command.reply_len() } else { echo + 3 };
        if times.received - times.requested < baud_rate.wire_time(bytes) {
            self.is_baud_rate_disproved = true;
            self.telemetry.stats().baud_rate_disproved = true;
            tracing::debug!("replies come faster than the baud rate can carry");
        }
    }
}

/// Returns the answer, or the error of `command` if the sensor refused it.
fn accepted(command: &Command, answer: Answer) -> Result<Answer, ExchangeError> {
    let status = answer.reply.status();
    if status.is_ok_for(command) { Ok(answer) } else { Err(refusal(command, status)) }
}

#[cold]
fn refusal(command: &Command, status: Status) -> ExchangeError {
    let error = refused(command, status);
    tracing::trace!(%error, "no answer");
    ExchangeError::Command(error)
}

/// Compares a frame with `command`, and shows it to the observers.
fn judge(
    command: &Command,
    echo: EchoKind,
    received: ReceivedFrame<'_>,
    baud_rate: Option<BaudRate>,
    observers: &ReplyObservers,
) -> Result<Reply, ReplyError> {
    let times = &received.times;
    let bytes = match received.frame() {
        FoundFrame::Reply(bytes) => bytes,
        FoundFrame::Overlong { bytes } => return Err(MalformedError::Overlong { bytes }.into()),
    };
    let outcome = Reply::parse(command, bytes);
    observers.pass(|| RawReply {
        command: outcome.as_ref().err().is_none_or(is_echoed).then_some(*command),
        bytes,
        received_at: times.received,
        stamp: times.stamp,
    });
    if echo == EchoKind::Repeated
        && outcome.is_ok()
        && let Some(baud_rate) = baud_rate
    {
        check_beginning(command, times, baud_rate)?;
    }
    outcome
}

/// Fails if the reply began before the command had left the wire.
#[cold]
fn check_beginning(
    command: &Command,
    times: &ReplyTimes,
    baud_rate: BaudRate,
) -> Result<(), MalformedError> {
    let least = baud_rate.wire_time(command.bytes().len() + 2);
    let after = times.began - times.requested;
    if after < least { Err(MalformedError::Early { after, least }) } else { Ok(()) }
}

/// What to expect after `command`, whose bytes are `bytes`.
fn expected(command: &Command, bytes: &[u8]) -> Expected {
    Expected { reply: ExpectedReply::new(command, bytes), limits: &LIMITS }
}

#[cold]
fn record_silence(telemetry: &Telemetry, command: &Command, failure: NoFrame) -> ExchangeError {
    let failure = no_reply(command, failure);
    if let ExchangeError::Command(error) = &failure {
        telemetry.stats().timeouts += 1;
        tracing::trace!(%error, "no answer");
    }
    failure
}

/// Returns true if a reply with this error began with its command.
fn is_echoed(error: &ReplyError) -> bool {
    !matches!(
        error,
        ReplyError::Foreign { .. } | ReplyError::Malformed(MalformedError::Overlong { .. })
    )
}

#[cfg(test)]
mod tests {
    use tokio::time::advance;

    use super::super::super::transport::scripted_port::ScriptedPort;
    use super::*;

    const NANOSECOND: Duration = Duration::from_nanos(1);

    /// Creates a session at 19,200 baud that receives these bytes in one piece.
    fn session(input: &[u8]) -> Session {
        let (reads, baud_rate) = ([Ok(input.to_vec())].into(), Some(BaudRate::B19200));
        let port = ScriptedPort { reads, baud_rate, ..ScriptedPort::default() };
        let telemetry = Arc::new(Telemetry::new(None));
        Session::new(Box::new(port), None, Leftovers::default(), Arc::default(), telemetry)
    }

    #[tokio::test]
    async fn an_early_reply_disproves_the_baud_rate() {
        let refused = Status::new(b'6');
        let full = Command::Distances(Window::FULL);
        // The bytes of the command and its reply, and their time.
        for (command, status, wire) in [
            (Command::LaserOff, Status::OK, 4_687_500),
            (full, Status::OK, 826_041_666),
            // A refusal has its echo, a status and two LFs: 10 and 13 bytes.
            (full, refused, 11_979_166),
        ] {
            for (early, is_disproved) in [(Duration::ZERO, false), (NANOSECOND, true)] {
                let mut session = session(b"");
                let began = Instant::now();
                let times = ReplyTimes {
                    requested: began,
                    began,
                    received: began + Duration::from_nanos(wire) - early,
                    stamp: std::time::SystemTime::now(),
                    is_replayed: false,
                };
                session.check_speed(&command, status, &times);
                assert_eq!(session.is_baud_rate_disproved, is_disproved, "{command}");
                assert_eq!(session.telemetry.stats().baud_rate_disproved, is_disproved);
                assert_eq!(session.believed_baud_rate().is_none(), is_disproved);
            }
        }
    }

    #[tokio::test]
    async fn a_time_limit_includes_the_wire() {
        let (session, latency) = (session(b""), Duration::from_millis(100));
        // 3 bytes and 6 bytes of 520.8 us, and 10 and 1,576.
        for (command, wire) in
            [(Command::LaserOff, 4_687_500), (Command::Distances(Window::FULL), 826_041_666)]
        {
            let limit = Duration::from_nanos(wire) + latency;
            assert_eq!(session.time_limit(&command, latency), limit);
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_copy_may_come_soon_after_a_reply() {
        let mut session = session(b"L0\n0\n\n");
        assert!(!session.may_be_copied(), "there is nothing to copy");
        session.exchange(Command::LaserOff, EchoKind::Common).await.unwrap();
        advance(COPY_TIME - NANOSECOND).await;
        assert!(session.may_be_copied());
        advance(NANOSECOND).await;
        assert!(!session.may_be_copied());
    }

    #[tokio::test(start_paused = true)]
    async fn a_copy_that_waits_in_the_port_answers_no_command() {
        let mut session = session(b"L0\n0\n\n");
        session.exchange(Command::LaserOff, EchoKind::Common).await.unwrap();
        let copy =
            ScriptedPort { reads: [Ok(b"L0\n0\n\n".to_vec())].into(), ..ScriptedPort::default() };
        session.transport = Transport::new(Box::new(copy), &LIMITS, false);
        assert!(!session.is_in_doubt());
        assert!(session.command(Command::LaserOff).await.is_err());
    }
}
