//! Errors of commands. They name the operation that the driver was asked for, and the command as text.

use std::time::Duration;

use super::super::failure::{ExchangeError, LinkError};
use super::super::transport::NoFrame;
use crate::ErrorKind;
use crate::error::Operation;
use crate::protocol::{Command, MalformedError, Protocol, ReplyError, Text, scip2};
use crate::state::Shared;

/// Command that can fail.
pub(super) trait Asked {
    /// What the driver wanted.
    fn operation(&self) -> Operation;

    /// Command as it is sent, without the label of SCIP 2, which differs each time.
    fn text(&self) -> Text;
}

impl Asked for Command {
    fn operation(&self) -> Operation {
        match self {
            Self::Version => Operation::Identify,
            Self::LaserOn => Operation::LaserOn,
            Self::LaserOff => Operation::LaserOff,
            Self::BaudRate(_) => Operation::SetBaudRate,
            Self::Distances(_) => Operation::Scan,
        }
    }

    fn text(&self) -> Text {
        self.bytes()[..].into()
    }
}

impl Asked for scip2::Command {
    fn operation(&self) -> Operation {
        match self {
            Self::LaserOn => Operation::LaserOn,
            Self::LaserOff => Operation::LaserOff,
            Self::BaudRate(_) => Operation::SetBaudRate,
            Self::Reboot => Operation::Reboot,
            Self::Latest { .. } | Self::Stream(_) => Operation::Scan,
            _ => Operation::Identify,
        }
    }

    fn text(&self) -> Text {
        self.to_string().into()
    }
}

pub(super) fn timeout(asked: &impl Asked, after: Duration) -> ErrorKind {
    ErrorKind::Timeout { operation: asked.operation(), command: asked.text(), after }
}

pub(super) fn malformed(asked: &impl Asked, source: MalformedError) -> ErrorKind {
    ErrorKind::Malformed { operation: asked.operation(), command: asked.text(), source }
}

/// Converts the error of a reply.
fn bad_reply(asked: &impl Asked, error: ReplyError) -> ErrorKind {
    let source = match error {
        ReplyError::Malformed(source) => source,
        ReplyError::Scip2 { status } => {
            return ErrorKind::WrongProtocol { expected: Protocol::Scip1, status };
        }
        // Damaged, or from a URG-04LX that has restarted: then it answers nothing else either.
        ReplyError::Scip1 { status } => MalformedError::Status { found: status },
        ReplyError::Foreign { found } | ReplyError::MultiEcho { found } => {
            MalformedError::Echo { found }
        }
        ReplyError::Uam => MalformedError::Echo { found: Text::default() },
    };
    malformed(asked, source)
}

/// Error of a command that the sensor refused.
#[cold]
pub(super) fn refused(
    asked: &impl Asked,
    status: Text,
    meaning: Option<&'static str>,
) -> ErrorKind {
    let (operation, command) = (asked.operation(), asked.text());
    let error = ErrorKind::Refused { operation, command, status, meaning };
    tracing::trace!(%error, "no answer");
    error
}

pub(super) fn not_confirmed(
    asked: &impl Asked,
    status: Option<Text>,
    refusal: Option<Text>,
) -> ErrorKind {
    ErrorKind::NotConfirmed { operation: asked.operation(), command: asked.text(), status, refusal }
}

/// Converts the absence of a reply.
pub(super) fn no_reply(asked: &impl Asked, failure: NoFrame) -> ExchangeError {
    match failure {
        NoFrame::Late { after } => ExchangeError::Command(timeout(asked, after)),
        NoFrame::Link(failure) => failure.into(),
    }
}

/// Counts the absence of a reply, and converts it.
#[cold]
pub(super) fn record_silence(
    shared: &Shared,
    asked: &impl Asked,
    failure: NoFrame,
) -> ExchangeError {
    let failure = no_reply(asked, failure);
    if let ExchangeError::Command(error) = &failure {
        shared.counters.lock().stats.timeouts += 1;
        tracing::trace!(%error, "no answer");
    }
    failure
}

/// Counts a malformed reply and its `skipped` bytes, which belong to no reply. Converts its error.
#[cold]
pub(super) fn record_malformed(
    shared: &Shared,
    asked: &impl Asked,
    error: ReplyError,
    skipped: u64,
) -> ExchangeError {
    shared.counters.count_malformed(&error, skipped);
    let error = bad_reply(asked, error);
    tracing::trace!(%error, "no answer");
    ExchangeError::Command(error)
}

/// Names `asked` in the error of a command that was sent on its behalf: the caller knows only `asked`.
pub(super) fn on_behalf_of(asked: impl Asked) -> impl FnOnce(ExchangeError) -> ExchangeError {
    move |error| match error {
        ExchangeError::Link(LinkError::Silent(error)) => LinkError::Silent(match error {
            ErrorKind::Timeout { after, .. } => timeout(&asked, after),
            ErrorKind::Malformed { source, .. } => malformed(&asked, source),
            error => error,
        })
        .into(),
        other => other,
    }
}
