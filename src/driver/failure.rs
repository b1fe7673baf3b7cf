//! [`ExchangeError`]: failure of a command, or of the link it was sent on ([`LinkError`]).

use crate::Error;
use crate::protocol::Command;

/// Failure of an exchange, sorted by what the driver has to do next.
#[derive(Debug)]
pub(crate) enum ExchangeError {
    /// This command failed; the next one may succeed.
    Command(Error),
    /// The link failed: no further command can succeed on it.
    Link(LinkError),
}

/// Failure of a link, sorted by what may bring the sensor back.
#[derive(Debug)]
pub(crate) enum LinkError {
    /// The sensor stopped answering, on a port that seems to work.
    Silent(Error),
    /// The link is lost. The port is useless from now on.
    Lost(Error),
    /// The port has ended permanently: [`Error::Closed`], or the error of its last read
    /// or write.
    Ended(Error),
}

impl ExchangeError {
    pub(crate) fn error(&self) -> &Error {
        match self {
            Self::Command(error) => error,
            Self::Link(failure) => failure.error(),
        }
    }

    /// Names `command` in the error of a fence that was sent on its behalf: the caller
    /// knows nothing of fences.
    pub(crate) fn of(self, command: Command) -> Self {
        match self {
            Self::Link(LinkError::Silent(error)) => LinkError::Silent(match error {
                Error::Timeout { after, .. } => Error::Timeout { sensor: None, command, after },
                Error::Malformed { source, .. } => {
                    Error::Malformed { sensor: None, command, source }
                }
                error => error,
            })
            .into(),
            other => other,
        }
    }
}

impl From<LinkError> for ExchangeError {
    fn from(failure: LinkError) -> Self {
        Self::Link(failure)
    }
}

/// A command that fails while a link is being opened ends the attempt.
impl From<ExchangeError> for LinkError {
    fn from(failure: ExchangeError) -> Self {
        match failure {
            ExchangeError::Command(error) => Self::Lost(error),
            ExchangeError::Link(failure) => failure,
        }
    }
}

impl LinkError {
    pub(crate) fn error(&self) -> &Error {
        match self {
            Self::Silent(error) | Self::Lost(error) | Self::Ended(error) => error,
        }
    }

    pub(crate) fn into_error(self) -> Error {
        match self {
            Self::Silent(error) | Self::Lost(error) | Self::Ended(error) => error,
        }
    }
}
