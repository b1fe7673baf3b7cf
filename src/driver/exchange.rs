//! An exchange, a command and its reply: its times, the judge of its frames, its failure.

use std::time::SystemTime;

use tokio::time::Instant;

use crate::Error;
use crate::codec::Frame;
use crate::protocol::{Command, Status};

/// The times of a command and its reply.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Timing {
    pub(crate) requested: Instant,
    /// The time when the first byte was read.
    pub(crate) began: Instant,
    /// The time when the last byte was read.
    pub(crate) received: Instant,
    /// The wall-clock time when the first byte arrived.
    pub(crate) stamp: SystemTime,
}

/// Judges the frames that come after a command: returns the status of the answer, the error
/// with which the exchange ends, or `None` to wait for another frame. Not a type parameter:
/// an exchange is compiled once, and not for each judge (`benches/README.md`, item 8).
pub(crate) type Judge<'a> =
    dyn FnMut(Frame<&[u8]>, Timing) -> Option<Result<Status, ExchangeError>> + Send + 'a;

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
