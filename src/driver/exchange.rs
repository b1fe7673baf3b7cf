//! [`ExchangeError`]: the failure of one exchange.

use crate::Error;
use crate::protocol::Command;

/// The failure of an exchange, sorted by what the driver has to do next.
#[derive(Debug)]
pub(crate) enum ExchangeError {
    /// This command failed; the next one may succeed.
    Command(Error),
    /// The sensor does not answer any more, on a port that seems to work.
    Silent(Error),
    /// The link is lost: the port is of no use any more.
    Lost(Error),
    /// The port has ended, and no other one can follow: [`Error::Closed`], or the
    /// error with which it ended.
    Ended(Error),
}

impl ExchangeError {
    /// Returns a reference to the error.
    pub(crate) fn error(&self) -> &Error {
        match self {
            Self::Command(error) | Self::Silent(error) | Self::Lost(error) | Self::Ended(error) => {
                error
            }
        }
    }

    /// Converts into the error, without what the driver has to do next.
    pub(crate) fn into_error(self) -> Error {
        match self {
            Self::Command(error) | Self::Silent(error) | Self::Lost(error) | Self::Ended(error) => {
                error
            }
        }
    }

    /// Returns the error of `command`, where it is one of the fence before or after
    /// it: whoever asked for `command` knows nothing of fences.
    pub(crate) fn of(self, command: Command) -> Self {
        match self {
            Self::Silent(Error::Timeout { after, .. }) => {
                Self::Silent(Error::Timeout { command, after })
            }
            Self::Silent(Error::Malformed { source, .. }) => {
                Self::Silent(Error::Malformed { command, source })
            }
            other => other,
        }
    }
}
