//! One command and its reply: sends it, and judges the next frame.

use std::time::Duration;

use super::super::super::failure::ExchangeError;
use super::super::super::observers::ReplyObservers;
use super::super::super::transport::{Expected, ReceivedFrame, ReplyTimes};
use super::super::errors::{on_behalf_of, record_malformed, record_silence, refused};
use super::{ANY_SCAN, LIMITS, Scip1};
use crate::codec::{ExpectedReply, Frame};
use crate::protocol::{Command, MalformedError, Protocol, Reply, ReplyError, Status};
use crate::{BaudRate, RawReply};

/// Reply to a command.
#[derive(Debug)]
pub(in super::super) struct Answer {
    pub(in super::super) reply: Reply,
    pub(in super::super) times: ReplyTimes,
}

/// Which other replies may still be on their way with the echo of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in super::super) enum EchoKind {
    /// No other reply. If this one arrives too fast for its bytes, the baud rate is wrong.
    Unique,
    /// The latest reply. If this one arrives too fast, it is a copy of the latest.
    Repeated,
    /// Any reply to this kind of command.
    Common,
}

impl Scip1 {
    /// Sends `command`, and returns its reply, whatever its status.
    pub(in super::super) async fn command(
        &mut self,
        command: Command,
    ) -> Result<Answer, ExchangeError> {
        self.settle().await.map_err(on_behalf_of(command))?;
        self.exchange(command, EchoKind::Common).await
    }

    /// Like [`command`](Self::command), but sends the command once more if there was no
    /// answer. Only for commands that may be sent twice.
    pub(super) async fn command_twice(
        &mut self,
        command: Command,
    ) -> Result<Answer, ExchangeError> {
        match self.command(command).await {
            Err(failure) if failure.is_lost_reply() && !self.line.shared.is_closing() => {
                self.command(command).await
            }
            outcome => outcome,
        }
    }

    /// Sends `command` on a settled link, and judges the next frame: it is the answer, or
    /// the command has failed. Waiting for a better frame would cost the whole deadline
    /// each time a reply is damaged.
    pub(in super::super) async fn exchange(
        &mut self,
        command: Command,
        echo: EchoKind,
    ) -> Result<Answer, ExchangeError> {
        self.line.is_settled = false;
        let within = self.wire_time(&command) + self.latency(&command);
        let baud_rate = self.line.transport.believed_baud_rate();
        let bytes = command.bytes();
        let expected = expected(&command, &bytes);
        let received = match self.line.transport.ask(&bytes, &expected, within).await {
            Ok(received) => received,
            Err(failure) => return Err(record_silence(&self.line.shared, &command, failure)),
        };
        let (times, wire_len) = (received.times, received.wire_len());
        match judge(&command, echo, received, baud_rate, &self.line.observers) {
            Ok(reply) => {
                self.line.is_settled = true;
                if !reply.status.is_ok_for(&command) {
                    self.record_refusal();
                } else if echo == EchoKind::Unique
                    && let Some(baud_rate) = baud_rate
                {
                    self.check_speed(&command, baud_rate, reply.status, &times);
                }
                Ok(Answer { reply, times })
            }
            Err(error) => {
                let skipped = if is_echoed(&error) { 0 } else { wire_len };
                Err(record_malformed(&self.line.shared, &command, error, skipped))
            }
        }
    }

    /// How long the sensor may take to begin its answer.
    pub(super) fn latency(&self, command: &Command) -> Duration {
        let usual = match command {
            Command::Distances(_) => Duration::from_millis(500),
            _ => Duration::from_secs(1),
        };
        self.line.reply_latency.unwrap_or(usual)
    }

    /// How long the sensor may take to begin its answer to a fence.
    pub(in super::super) fn usual_latency(&self) -> Duration {
        self.latency(&ANY_SCAN)
    }

    /// Time of a command and its longest reply on the wire.
    pub(in super::super) fn wire_time(&self, command: &Command) -> Duration {
        let wire_time = |baud_rate| command.wire_time(baud_rate);
        let transport = &self.line.transport;
        let baud_rate = transport.baud_rate().or_else(|| transport.measured_baud_rate());
        baud_rate.map_or(Duration::ZERO, wire_time)
    }

    #[cold]
    fn record_refusal(&mut self) {
        self.line.shared.counters.lock().stats.refused += 1;
    }

    /// Checks whether the reply to `command` came faster than the baud rate allows. The command's echo
    /// must be unique, so that the reply cannot be an older one.
    pub(in super::super) fn check_speed(
        &mut self,
        command: &Command,
        baud_rate: BaudRate,
        status: Status,
        times: &ReplyTimes,
    ) {
        let wire_time = match status.is_ok() {
            true => command.wire_time(baud_rate),
            false => baud_rate.wire_time(2 * (command.bytes().len() + 1) + 3),
        };
        self.line.check_speed(wire_time, times);
    }
}

/// Returns the answer, or the error of `command` if the sensor refused it.
pub(in super::super) fn accepted(
    command: &Command,
    answer: Answer,
) -> Result<Answer, ExchangeError> {
    let status = answer.reply.status;
    if status.is_ok_for(command) { Ok(answer) } else { Err(refusal(command, status)) }
}

#[cold]
pub(super) fn refusal(command: &Command, status: Status) -> ExchangeError {
    ExchangeError::Command(refused(command, status.into(), status.meaning(command)))
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
        Frame::Reply(bytes) => bytes,
        Frame::Overlong { bytes } => return Err(MalformedError::Overlong { bytes }.into()),
    };
    let outcome = Reply::parse(command, bytes);
    observers.pass(|| {
        let is_answer = outcome.as_ref().err().is_none_or(is_echoed);
        raw_reply(bytes, is_answer.then_some(*command), times)
    });
    if echo == EchoKind::Repeated
        && outcome.is_ok()
        && let Some(baud_rate) = baud_rate
    {
        check_beginning(command, times, baud_rate)?;
    }
    outcome
}

pub(super) fn raw_reply<'a>(
    bytes: &'a [u8],
    command: Option<Command>,
    times: &ReplyTimes,
) -> RawReply<'a> {
    let ReplyTimes { received: received_at, stamp, .. } = *times;
    RawReply { protocol: Protocol::Scip1, command, request: None, bytes, received_at, stamp }
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
pub(super) fn expected(command: &Command, bytes: &[u8]) -> Expected {
    Expected { reply: ExpectedReply::new(command, bytes), limits: &LIMITS }
}

/// Returns true if a reply with this error began with its command.
fn is_echoed(error: &ReplyError) -> bool {
    !matches!(
        error,
        ReplyError::Foreign { .. } | ReplyError::Malformed(MalformedError::Overlong { .. })
    )
}
