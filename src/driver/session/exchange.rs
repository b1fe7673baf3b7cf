//! An exchange: sends a command, and judges the frame that follows.

use std::sync::Arc;

use tracing::Instrument;

use super::super::failure::ExchangeError;
use super::super::observers::ReplyObservers;
use super::super::transport::{TimedFrame, Timing};
use super::{Read, Session};
use crate::ErrorKind;
use crate::RawReply;
use crate::codec::Frame;
use crate::protocol::{Command, MalformedError, Reply, ReplyError, Status};

/// Which other replies may still be on their way with the echo of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum EchoKind {
    /// No other reply. If this one arrives too fast for its bytes, the baud rate is
    /// wrong.
    Unique,
    /// The latest reply. If this one arrives too fast, it is a copy of the latest.
    Repeated,
    /// Any reply to this kind of command.
    Common,
}

impl Session {
    /// Sends `command` on a settled link, and judges the next frame: it is the answer, or
    /// the command has failed. Waiting for a better frame would cost the whole deadline
    /// each time a reply is damaged.
    pub(super) async fn exchange(
        &mut self,
        command: Command,
        echo: EchoKind,
        values: &mut Arc<[u16]>,
        read: &mut Read<'_>,
    ) -> Result<(Status, Timing), ExchangeError> {
        let Self { transport, observers, telemetry, .. } = self;
        let latency = transport.latency(&command);
        let span = tracing::trace_span!("exchange", %command);
        let answer = match transport.ask(&command, latency).instrument(span.clone()).await {
            Ok(received) => {
                let outcome = judge(&command, echo, received, observers, values);
                if let Err(error) = &outcome {
                    let mut stats = telemetry.stats();
                    stats.malformed.count(error);
                    if !is_echoed(error) {
                        stats.bytes_skipped += received.wire_len;
                    }
                }
                match outcome {
                    Ok(reply) if reply.status().is_ok_for(&command) => {
                        read(&reply);
                        Ok((reply.status(), received.timing))
                    }
                    outcome => Err(ExchangeError::Command(failure(command, outcome))),
                }
            }
            Err(error) => Err(error),
        };
        match &answer {
            Ok((status, timing)) => {
                if echo == EchoKind::Unique && timing.disproves_baud_rate(&command, *status) {
                    transport.note_outrun();
                }
            }
            Err(ExchangeError::Command(error)) => {
                tracing::trace!(parent: &span, %error, "no answer");
                match error {
                    ErrorKind::Refused { .. } => telemetry.stats().refused += 1,
                    ErrorKind::Timeout { .. } => telemetry.stats().timeouts += 1,
                    _ => transport.mark_dirty(),
                }
            }
            Err(_) => {}
        }
        answer
    }
}

/// Compares a frame with `command`, and shows it to the observers.
fn judge<'a>(
    command: &Command,
    echo: EchoKind,
    TimedFrame { frame, timing, .. }: TimedFrame<'a>,
    observers: &ReplyObservers,
    values: &mut Arc<[u16]>,
) -> Result<Reply<'a>, ReplyError> {
    let bytes = match frame {
        Frame::Reply(bytes) => bytes,
        Frame::Overlong { bytes } => return Err(MalformedError::Overlong { bytes }.into()),
    };
    let outcome = Reply::parse_into_shared(command, bytes, values);
    observers.pass(|| RawReply {
        command: outcome.as_ref().err().is_none_or(is_echoed).then_some(*command),
        bytes,
        received_at: timing.received,
        stamp: timing.stamp,
    });
    // The first byte of the reply cannot arrive before the command has left the wire.
    let least = timing.least_until_reply(command);
    let after = timing.began - timing.requested;
    if echo == EchoKind::Repeated && outcome.is_ok() && after < least {
        return Err(MalformedError::Early { after, least }.into());
    }
    outcome
}

/// Converts a malformed or refused reply into its error.
fn failure(command: Command, outcome: Result<Reply<'_>, ReplyError>) -> ErrorKind {
    match outcome {
        Ok(reply) => ErrorKind::Refused { command, status: reply.status() },
        Err(ReplyError::Malformed(source)) => ErrorKind::Malformed { command, source },
        Err(ReplyError::Scip2 { status }) => ErrorKind::WrongProtocol { status },
        Err(ReplyError::Foreign { found }) => {
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
