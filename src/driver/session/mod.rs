//! [`Session`]: one open port, on which one command is outstanding at a time.
//!
//! SCIP 1.1 numbers nothing, and two polls of the same window have the same echo. A reply
//! answers its command only because no older reply can still be on its way. Three things cast
//! doubt on that: unsolicited bytes, a malformed reply, and a missed deadline. So a command
//! leaves the link unsettled until its reply is accepted, and an unsettled link is fenced before
//! the next command.
//!
//! `fence` proves that no older reply can follow, and `unique_requests` chooses what each `G`
//! asks for.

mod fence;
mod scip2;
mod unique_requests;

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

pub(crate) use self::unique_requests::UniqueRequests;
use super::failure::ExchangeError;
use super::observers::ReplyObservers;
use super::transport::{ReceivedFrame, Timing, Transport};
use crate::RawReply;
use crate::codec::FoundFrame;
use crate::port::Port;
use crate::protocol::{Command, MalformedError, Reply, ReplyError, Status, Version};
use crate::state::{Telemetry, VersionReply};
use crate::{BaudRate, ErrorKind, Window};

/// How long after a reply a faulty line may deliver a copy of it.
const COPY_TIME: Duration = Duration::from_millis(20);

/// Result of a successful poll.
#[derive(Debug)]
pub(crate) struct Polled {
    pub(crate) values: Arc<[u32]>,
    /// Index of the window's first value. Successive polls ask for extra values before or
    /// after the window.
    pub(crate) first: usize,
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
    pub(crate) unique_requests: UniqueRequests,
    /// True if the sensor may hold part of a command. An LF ends it, and can cost a revolution.
    pub(crate) interrupted: bool,
}

pub(crate) struct Session {
    pub(crate) transport: Transport,
    /// True if no reply older than the next command can be on its way.
    is_settled: bool,
    /// True once a reply arrived faster than the port's baud rate allows, as on a
    /// pseudo-terminal, a USB adapter or a server on a fast line.
    is_outrun: bool,
    unique_requests: UniqueRequests,
    observers: Arc<ReplyObservers>,
    telemetry: Arc<Telemetry>,
}

impl Session {
    pub(crate) fn new(
        port: Box<dyn Port>,
        latency: Option<Duration>,
        before: Leftovers,
        observers: Arc<ReplyObservers>,
        telemetry: Arc<Telemetry>,
    ) -> Self {
        let Leftovers { unique_requests, interrupted } = before;
        telemetry.stats().baud_rate_outrun = false;
        let transport = Transport::new(port, latency, interrupted);
        // The last user of the port may have left bytes behind.
        let is_settled = false;
        Self { transport, is_settled, is_outrun: false, unique_requests, observers, telemetry }
    }

    /// Closes the port.
    pub(crate) fn close(self) -> Leftovers {
        let interrupted = self.transport.is_interrupted();
        Leftovers { unique_requests: self.unique_requests, interrupted }
    }

    /// Returns true while the driver is closing. A silent sensor then gets no second try.
    pub(crate) fn is_closing(&self) -> bool {
        self.telemetry.is_closing()
    }

    /// Returns true if the next command needs no fence before it, as far as known without
    /// reading.
    pub(crate) fn is_settled(&self) -> bool {
        self.is_settled && self.transport.pending().is_empty()
    }

    /// Sets this side's baud rate. Forgets what is known of the line at the former one.
    pub(crate) async fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        self.is_settled = false;
        self.is_outrun = false;
        self.telemetry.stats().baud_rate_outrun = false;
        self.transport.set_baud_rate(baud_rate).await
    }

    /// Drops pending input. Bytes without a command cast doubt on the link.
    pub(crate) async fn discard_pending(&mut self) -> Result<(), ExchangeError> {
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

    /// Polls `window`.
    pub(crate) async fn poll(&mut self, window: Window) -> Result<Polled, ExchangeError> {
        let on_behalf = |error: ExchangeError| error.on_behalf_of(Command::Distances(window));
        // First, so that the fence's `clear` cannot forget this poll.
        if !self.is_quiet()? {
            self.settle().await.map_err(on_behalf)?;
        }
        let mut widened = self.unique_requests.widen(window);
        if widened.repeats && self.may_be_copied() {
            // A copy of the latest reply would match this poll.
            Box::pin(self.fence()).await.map_err(on_behalf)?;
            widened = self.unique_requests.widen(window);
        }
        self.telemetry.count_poll();
        let echo = if widened.repeats { EchoKind::Repeated } else { EchoKind::Unique };
        let reply = self.exchange(Command::Distances(widened.asked), echo).await?;
        Ok(Polled { values: reply.into_values(), first: widened.first })
    }

    /// Returns when [`poll`](Self::poll) of this window needs no fence to rule out a copy of the
    /// latest reply, or `None` if it needs no fence now.
    pub(crate) fn copies_end(&self, window: Window) -> Option<Instant> {
        let may_match = self.may_be_copied() && self.unique_requests.repeats(window);
        self.transport.latest_at().filter(|_| may_match).map(|latest| latest + COPY_TIME)
    }

    /// Returns true if a copy of the latest frame may still be on its way: on a serial line, for
    /// [`COPY_TIME`] after the frame.
    fn may_be_copied(&self) -> bool {
        // Last, because reading the clock costs more than the rest.
        self.believed_baud_rate().is_some()
            && self.transport.latest_at().is_some_and(|latest| latest.elapsed() < COPY_TIME)
    }

    /// Baud rate of the line, unless it has none or a reply has disproved it.
    pub(crate) fn believed_baud_rate(&self) -> Option<BaudRate> {
        self.transport.baud_rate().filter(|_| !self.is_outrun)
    }

    /// Reads the version of the sensor. Asks once more if there was no answer.
    pub(crate) async fn version(&mut self) -> Result<VersionReply, ExchangeError> {
        let reply = self.command_twice(Command::Version).await?;
        let Timing { received, stamp, .. } = *self.transport.timing();
        let version = Version::from_reply(&reply);
        let frame = reply.version_frame().into();
        Ok(VersionReply { version, frame, received_at: received, stamp })
    }

    /// Sends `command`, and returns its reply.
    ///
    /// # Errors
    ///
    /// Any status but success is [`ErrorKind::Refused`].
    pub(crate) async fn command(&mut self, command: Command) -> Result<Reply, ExchangeError> {
        self.settle().await.map_err(|error| error.on_behalf_of(command))?;
        self.exchange(command, EchoKind::Common).await
    }

    /// Like [`command`](Self::command), but sends the command once more if there was no
    /// answer. Only for commands that may be sent twice.
    pub(crate) async fn command_twice(&mut self, command: Command) -> Result<Reply, ExchangeError> {
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
    async fn exchange(&mut self, command: Command, echo: EchoKind) -> Result<Reply, ExchangeError> {
        self.is_settled = false;
        let latency = self.transport.latency(&command);
        let baud_rate = self.believed_baud_rate();
        let received = match self.transport.ask(&command, latency).await {
            Ok(received) => received,
            Err(failure) => return Err(record_silence(&self.telemetry, failure)),
        };
        let wire_len = received.wire_len();
        match judge(&command, echo, received, baud_rate, &self.observers) {
            Ok(reply) => {
                self.is_settled = true;
                if !reply.status().is_ok_for(&command) {
                    return Err(self.record_refusal(command, reply.status()));
                }
                if echo == EchoKind::Unique {
                    self.check_speed(&command, reply.status());
                }
                Ok(reply)
            }
            Err(error) => Err(self.record_malformed(command, error, wire_len)),
        }
    }

    #[cold]
    fn record_refusal(&mut self, command: Command, status: Status) -> ExchangeError {
        self.telemetry.stats().refused += 1;
        let error = ErrorKind::Refused { command, status };
        tracing::trace!(%error, "no answer");
        ExchangeError::Command(error)
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
        let error = failure(command, error);
        tracing::trace!(%error, "no answer");
        ExchangeError::Command(error)
    }

    /// Checks whether the latest reply arrived faster than its bytes and the bytes of its `command`
    /// can: then the port's baud rate is wrong. The command's echo must be unique, so that the
    /// reply cannot be an older one.
    fn check_speed(&mut self, command: &Command, status: Status) {
        let Some(baud_rate) = self.believed_baud_rate() else { return };
        let echo = command.bytes().len() + 1;
        let bytes = echo + if status.is_ok() { command.reply_len() } else { echo + 3 };
        let Timing { requested, received, .. } = *self.transport.timing();
        if received.saturating_duration_since(requested) < baud_rate.wire_time(bytes) {
            self.is_outrun = true;
            self.telemetry.stats().baud_rate_outrun = true;
            tracing::debug!("replies come faster than the baud rate can carry");
        }
    }
}

/// Compares a frame with `command`, and shows it to the observers.
fn judge(
    command: &Command,
    echo: EchoKind,
    received: ReceivedFrame<'_>,
    baud_rate: Option<BaudRate>,
    observers: &ReplyObservers,
) -> Result<Reply, ReplyError> {
    let timing = received.timing;
    let bytes = match received.frame() {
        FoundFrame::Reply(bytes) => bytes,
        FoundFrame::Overlong { bytes } => return Err(MalformedError::Overlong { bytes }.into()),
    };
    let outcome = Reply::parse(command, bytes);
    observers.pass(|| RawReply {
        command: outcome.as_ref().err().is_none_or(is_echoed).then_some(*command),
        bytes,
        received_at: timing.received,
        stamp: timing.stamp,
    });
    if echo == EchoKind::Repeated
        && outcome.is_ok()
        && let Some(baud_rate) = baud_rate
    {
        check_beginning(command, timing, baud_rate)?;
    }
    outcome
}

/// Fails if the reply began before the command had left the wire.
#[cold]
fn check_beginning(
    command: &Command,
    timing: &Timing,
    baud_rate: BaudRate,
) -> Result<(), MalformedError> {
    let least = baud_rate.wire_time(command.bytes().len() + 2);
    let after = timing.began - timing.requested;
    if after < least { Err(MalformedError::Early { after, least }) } else { Ok(()) }
}

#[cold]
fn record_silence(telemetry: &Telemetry, failure: ExchangeError) -> ExchangeError {
    if let ExchangeError::Command(error) = &failure {
        telemetry.stats().timeouts += 1;
        tracing::trace!(%error, "no answer");
    }
    failure
}

/// Converts the error of a reply into the error of its command.
fn failure(command: Command, error: ReplyError) -> ErrorKind {
    match error {
        ReplyError::Malformed(source) => ErrorKind::Malformed { command, source },
        ReplyError::Scip2 { status } => ErrorKind::WrongProtocol { status, model: None },
        ReplyError::Foreign { found } => {
            ErrorKind::Malformed { command, source: MalformedError::Echo { found } }
        }
    }
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

    use super::super::transport::scripted_port::ScriptedPort;
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
            for (early, is_outrun) in [(Duration::ZERO, false), (NANOSECOND, true)] {
                let mut session = session(b"");
                let requested = Instant::now();
                let received = requested + Duration::from_nanos(wire) - early;
                session.transport.set_times(requested, received);
                session.check_speed(&command, status);
                assert_eq!(session.is_outrun, is_outrun, "{command}");
                assert_eq!(session.telemetry.stats().baud_rate_outrun, is_outrun);
                assert_eq!(session.believed_baud_rate().is_none(), is_outrun);
            }
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
        session.transport = Transport::new(Box::new(copy), None, false);
        assert!(session.is_settled());
        assert!(session.command(Command::LaserOff).await.is_err());
    }
}
