//! What can go wrong, for the crate's users.

use std::fmt;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use crate::protocol::{BaudRate, Command, Malformed, Status, Text};

/// What went wrong.
///
/// `Display` tells the error's own layer, on one line, and what to do about
/// it; the cause is in [`source`](std::error::Error::source), and a log wants
/// both (`{:#}` of `anyhow` prints them, so does [`State`](crate::State) as data).
/// An error is cheap to clone: everyone who waits for the same thing gets the same
/// error.
///
/// That there is no distance in a direction is no error but a
/// [`Measurement`](crate::Measurement).
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The text names no endpoint.
    #[error("{text:?} is no port: {reason}")]
    InvalidEndpoint {
        /// The text.
        text: String,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// There is no such port.
    #[error("no port {port}: plug the sensor in, or see what is there with `urg list`")]
    NoSuchPort {
        /// The port as it was asked for.
        port: String,
    },
    /// The path exists and is not a serial port.
    #[error(
        "{port} is not a serial port: name a device such as /dev/ttyACM0 (`urg list` shows them)"
    )]
    NotASerialPort {
        /// The port as it was asked for.
        port: String,
    },
    /// The user may not open the port.
    #[error(
        "no permission to open {port}: {}",
        match group {
            Some(group) => format!("add the user to the group {group} (`sudo usermod -aG {group} $USER`, then log in again)"),
            None => "give the user read and write access to it".to_owned(),
        }
    )]
    PermissionDenied {
        /// The port as it was asked for.
        port: String,
        /// The group that owns the port, where that is known.
        group: Option<String>,
    },
    /// Another program has the port.
    #[error(
        "{port} is in use: stop the program that has it open (`fuser {port}` tells which; ModemManager probes new ports for some seconds)"
    )]
    Busy {
        /// The port as it was asked for.
        port: String,
    },
    /// The port cannot be opened, for a reason that has no kind of its own.
    #[error("cannot open {port}")]
    Open {
        /// The port as it was asked for.
        port: String,
        /// Why not.
        source: Arc<io::Error>,
    },
    /// No port leads to the sensor with this serial number.
    #[error(
        "no sensor with serial number {serial_number} on any port: plug it in (`urg list` shows the ports that were looked through; busy ones are skipped)"
    )]
    NoSuchSensor {
        /// The serial number that was asked for.
        serial_number: String,
    },
    /// The port opened, and no sensor answers.
    #[error(
        "no sensor answers{}: check its power and the wiring (after power-up it is silent for some seconds){}",
        match baud_rate { Some(baud_rate) => format!(" at {baud_rate} baud"), None if *searched => " at any baud rate".to_owned(), None => String::new() },
        if *bytes > 0 { format!("; {bytes} bytes came that are no reply of SCIP 1.1") } else { String::new() },
    )]
    NoAnswer {
        /// The only baud rate that was tried, where the port cannot change it.
        baud_rate: Option<BaudRate>,
        /// Whether all six baud rates were tried.
        searched: bool,
        /// How many bytes came that made no reply.
        bytes: u64,
    },
    /// What is sent comes straight back.
    #[error(
        "the port sends back what is written to it: a loopback plug, a terminal with echo, or crossed wires; no sensor is at the other end"
    )]
    Loopback,
    /// The sensor speaks SCIP 2.
    #[error(
        "the sensor speaks SCIP 2 (status \"{status}\"): power-cycle it, a URG-04LX is back in SCIP 1.1 after a restart; a model that knows only SCIP 2 cannot be used"
    )]
    WrongProtocol {
        /// The status that gave it away.
        status: Text,
    },
    /// A sensor answers, and it is not the one that was asked for.
    #[error(
        "the sensor is {found}, where {expected} was expected: plug in {expected}, or ask for {found}"
    )]
    AnotherSensor {
        /// The serial number that was expected.
        expected: Text,
        /// The serial number that answers.
        found: Text,
    },
    /// The link is gone: unplugged, hung up, or silent for good.
    #[error("the link to the sensor is lost")]
    Disconnected {
        /// What the system said, if it said anything.
        source: Option<Arc<io::Error>>,
    },
    /// The sensor did not answer in time.
    #[error("no answer to {command} within {} ms", after.as_millis())]
    Timeout {
        /// What was sent.
        command: Command,
        /// How long was waited.
        after: Duration,
    },
    /// The sensor answered with an error status.
    #[error(
        "the sensor refused {command} with status {status}{}",
        match status.meaning(command) { Some(meaning) => format!(": {meaning}"), None => String::new() }
    )]
    Refused {
        /// What was sent.
        command: Command,
        /// What came back.
        status: Status,
    },
    /// The reply was damaged.
    #[error("the reply to {command} is damaged")]
    Malformed {
        /// What was sent.
        command: Command,
        /// Where, what was expected, and what came.
        source: Malformed,
    },
    /// A scan was asked for while the laser is off by request.
    #[error("the laser was switched off: switch it on before asking for scans")]
    LaserOff,
    /// The sensor accepted a command and then behaved as if it had not.
    #[error("the sensor accepted {command}, and then did not act on it")]
    NotConfirmed {
        /// What was sent.
        command: Command,
    },
    /// The port cannot be set to this baud rate.
    #[error("the port cannot be set to {baud_rate} baud{}", if source.is_some() { "" } else { ": its speed is fixed at the other end" })]
    UnsupportedBaudRate {
        /// The baud rate that was asked for.
        baud_rate: BaudRate,
        /// Why not.
        #[source]
        source: Option<Arc<io::Error>>,
    },
    /// The driver has ended: it was closed, or its task was dropped.
    #[error("the driver has ended")]
    Closed,
}

impl Error {
    /// Whether trying again later may help with nothing else done: the link
    /// may come back, the next scan may be whole.
    ///
    /// True for [`NoSuchPort`](Self::NoSuchPort),
    /// [`NoSuchSensor`](Self::NoSuchSensor), [`Busy`](Self::Busy),
    /// [`Open`](Self::Open), [`NoAnswer`](Self::NoAnswer),
    /// [`Disconnected`](Self::Disconnected), [`Timeout`](Self::Timeout),
    /// [`Malformed`](Self::Malformed) and [`NotConfirmed`](Self::NotConfirmed).
    /// Others want something done first, to the machine, the sensor or the
    /// program. It says nothing of the driver: one that has ended with
    /// `Disconnected` stays ended.
    pub fn is_transient(&self) -> bool {
        match self {
            Self::NoSuchPort { .. }
            | Self::NoSuchSensor { .. }
            | Self::Busy { .. }
            | Self::Open { .. }
            | Self::NoAnswer { .. }
            | Self::Disconnected { .. }
            | Self::Timeout { .. }
            | Self::Malformed { .. }
            | Self::NotConfirmed { .. } => true,
            Self::InvalidEndpoint { .. }
            | Self::NotASerialPort { .. }
            | Self::PermissionDenied { .. }
            | Self::Loopback
            | Self::WrongProtocol { .. }
            | Self::AnotherSensor { .. }
            | Self::Refused { .. }
            | Self::LaserOff
            | Self::UnsupportedBaudRate { .. }
            | Self::Closed => false,
        }
    }

    /// Formats the error and its causes on one line, for a log or a message.
    ///
    /// ```
    /// use tokio_scip::Error;
    ///
    /// let source = std::sync::Arc::new(std::io::Error::other("device removed"));
    /// let error = Error::Disconnected { source: Some(source) };
    /// assert_eq!(error.to_string(), "the link to the sensor is lost");
    /// assert_eq!(error.chain().to_string(), "the link to the sensor is lost: device removed");
    /// ```
    pub fn chain(&self) -> ErrorChain<'_> {
        ErrorChain::new(self)
    }

    pub(crate) fn disconnected(source: Option<io::Error>) -> Self {
        Self::Disconnected { source: source.map(Arc::new) }
    }
}

/// An error and its causes, as one line: `Display` joins them with `: `.
///
/// A cause whose text already ends the line is not repeated: some errors include
/// the text of their cause in their own.
#[derive(Debug, Clone, Copy)]
pub struct ErrorChain<'a>(&'a (dyn std::error::Error + 'a));

impl<'a> ErrorChain<'a> {
    /// Wraps any error; [`Error::chain`] is the short way for those of this crate.
    pub fn new(error: &'a (dyn std::error::Error + 'a)) -> Self {
        Self(error)
    }
}

impl fmt::Display for ErrorChain<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut last = self.0.to_string();
        f.write_str(&last)?;
        let mut cause = self.0.source();
        while let Some(error) = cause {
            let text = error.to_string();
            if !last.ends_with(&text) {
                write!(f, ": {text}")?;
                last = text;
            }
            cause = error.source();
        }
        Ok(())
    }
}

impl From<std::convert::Infallible> for Error {
    fn from(never: std::convert::Infallible) -> Self {
        match never {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chain_names_each_cause_once() {
        #[derive(Debug, thiserror::Error)]
        #[error("cannot start: {0}")]
        struct Outer(#[source] Error);

        let source = Some(Arc::new(io::Error::other("device removed")));
        let lost = Error::Disconnected { source };
        let text = "cannot start: the link to the sensor is lost: device removed";
        assert_eq!(ErrorChain::new(&Outer(lost)).to_string(), text);
        assert_eq!(Error::Closed.chain().to_string(), Error::Closed.to_string());
    }
}
