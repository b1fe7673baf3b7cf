//! Errors of commands. They name the operation that the driver was asked for, and the command as
//! text.

use std::time::Duration;

use super::super::super::failure::{ExchangeError, LinkError};
use super::super::super::transport::NoFrame;
use crate::ErrorKind;
use crate::error::Operation;
use crate::protocol::{Command, MalformedError, ReplyError, Status, Text};

fn operation(command: &Command) -> Operation {
    match command {
        Command::Version => Operation::Identify,
        Command::LaserOn => Operation::LaserOn,
        Command::LaserOff => Operation::LaserOff,
        Command::BaudRate(_) => Operation::SetBaudRate,
        Command::Distances(_) => Operation::Scan,
    }
}

fn text(command: &Command) -> Text {
    command.bytes()[..].into()
}

pub(super) fn timeout(command: &Command, after: Duration) -> ErrorKind {
    ErrorKind::Timeout { operation: operation(command), command: text(command), after }
}

pub(super) fn malformed(command: &Command, source: MalformedError) -> ErrorKind {
    ErrorKind::Malformed { operation: operation(command), command: text(command), source }
}

pub(super) fn refused(command: &Command, status: Status) -> ErrorKind {
    ErrorKind::Refused {
        operation: operation(command),
        command: text(command),
        status: status.into(),
        meaning: status.meaning(command),
    }
}

pub(super) fn not_confirmed(
    command: &Command,
    status: Option<Status>,
    refusal: Option<Status>,
) -> ErrorKind {
    ErrorKind::NotConfirmed {
        operation: operation(command),
        command: text(command),
        status: status.map(Text::from),
        refusal: refusal.map(Text::from),
    }
}

/// Converts the absence of a reply to `command`.
pub(super) fn no_reply(command: &Command, failure: NoFrame) -> ExchangeError {
    match failure {
        NoFrame::Late { after } => ExchangeError::Command(timeout(command, after)),
        NoFrame::Link(failure) => failure.into(),
    }
}

/// Converts the error of a reply to `command`.
pub(super) fn bad_reply(command: &Command, error: ReplyError) -> ErrorKind {
    match error {
        ReplyError::Malformed(source) => malformed(command, source),
        ReplyError::Scip2 { status } => ErrorKind::WrongProtocol { status, model: None },
        ReplyError::Foreign { found } => malformed(command, MalformedError::Echo { found }),
    }
}

/// Names `command` in the error of a fence that was sent on its behalf: the caller knows nothing
/// of fences.
pub(super) fn on_behalf_of(command: Command) -> impl FnOnce(ExchangeError) -> ExchangeError {
    move |error| match error {
        ExchangeError::Link(LinkError::Silent(error)) => LinkError::Silent(match error {
            ErrorKind::Timeout { after, .. } => timeout(&command, after),
            ErrorKind::Malformed { source, .. } => malformed(&command, source),
            error => error,
        })
        .into(),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BaudRate, Window};

    #[test]
    fn a_known_status_is_explained() {
        let refused = |command, status| refused(&command, Status::new(status)).to_string();
        for (command, status, meaning) in [
            (Command::Distances(Window::FULL), b'6', "'6': the laser is off"),
            (Command::Version, b'6', "'6'"),
            (Command::LaserOff, b'2', "'2': the laser is already in that state"),
            (Command::BaudRate(BaudRate::B115200), b'3', "or is on USB"),
            (Command::Version, b'E', "does not know the command"),
        ] {
            assert!(refused(command, status).ends_with(meaning), "{command}");
        }
    }
}
