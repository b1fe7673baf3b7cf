//! [`ExchangeError`]: failure of a command, or of the link it was sent on ([`LinkError`]).

use crate::ErrorKind;

/// Failure of an exchange, sorted by what the driver has to do next.
#[derive(Debug)]
pub(crate) enum ExchangeError {
    /// This command failed; the next one may succeed.
    Command(ErrorKind),
    /// The link failed: no further command can succeed on it.
    Link(LinkError),
}

/// Failure of a link, sorted by what may bring the sensor back.
#[derive(Debug)]
pub(crate) enum LinkError {
    /// The sensor stopped answering, on a port that seems to work.
    Silent(ErrorKind),
    /// The link is lost. The port is useless from now on.
    Lost(ErrorKind),
    /// The port has ended permanently: [`ErrorKind::Closed`], or the error of its last read or write.
    Ended(ErrorKind),
}

impl ExchangeError {
    pub(crate) fn kind(&self) -> &ErrorKind {
        match self {
            Self::Command(kind) => kind,
            Self::Link(failure) => failure.kind(),
        }
    }

    /// Returns true if the reply did not arrive, or was damaged.
    pub(crate) fn is_lost_reply(&self) -> bool {
        matches!(self, Self::Command(ErrorKind::Timeout { .. } | ErrorKind::Malformed { .. }))
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
    pub(crate) fn kind(&self) -> &ErrorKind {
        match self {
            Self::Silent(kind) | Self::Lost(kind) | Self::Ended(kind) => kind,
        }
    }
}
