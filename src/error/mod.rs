//! [`Error`]: everything that can fail, for the crate's users. Errors of the protocol
//! itself are in [`protocol`](crate::protocol).

mod chain;

use std::io;
use std::sync::Arc;
use std::time::Duration;

pub use self::chain::ErrorChain;
use crate::protocol::{BaudRate, Command, Malformed, Status, Text};

/// The reason why an operation failed, and what to do about it.
///
/// `Display` writes one line without the cause, which is in
/// [`source`](std::error::Error::source); a log wants [`chain`](Self::chain), which
/// writes both. An error is cheap to clone, so that all who wait for the same thing
/// get the same error.
///
/// A direction without a distance is not an error but a
/// [`Measurement`](crate::Measurement).
///
/// Kinds that a [`Connect`](crate::Connect) returns have all their fields, so that
/// others can make them. The rest are `#[non_exhaustive]`: only the driver makes them,
/// and they may get more fields.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The text is not an [`Endpoint`](crate::Endpoint).
    #[error("invalid port {text:?}: {reason}")]
    InvalidEndpoint {
        /// The text.
        text: String,
        /// The reason, and what was expected.
        reason: &'static str,
    },
    /// There is no such port.
    #[error("no port {port}: plug the sensor in, or list the ports with `urg list`")]
    NoSuchPort {
        /// The port, as the caller named it.
        port: String,
    },
    /// The path exists and is not a serial port.
    #[error(
        "{port} is not a serial port: use a device such as /dev/ttyACM0 (`urg list` shows them)"
    )]
    NotASerialPort {
        /// The port, as the caller named it.
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
        /// The port, as the caller named it.
        port: String,
        /// The group that owns the port, where that is known.
        group: Option<String>,
    },
    /// Another program has the port.
    #[error(
        "{port} is in use: stop the program that has it open (`fuser {port}` shows it; ModemManager probes new ports for some seconds)"
    )]
    Busy {
        /// The port, as the caller named it.
        port: String,
    },
    /// The port cannot be opened, for another reason.
    #[error("cannot open {port}")]
    Open {
        /// The port, as the caller named it.
        port: String,
        /// The reason, from the system.
        source: Arc<io::Error>,
    },
    /// No port leads to the sensor with this serial number.
    #[error(
        "no sensor with serial number {serial_number} on any port: plug it in (`urg list` shows the ports that were looked through; busy ones are skipped)"
    )]
    NoSuchSensor {
        /// The serial number, as the caller named it.
        serial_number: String,
    },
    /// The port is open, and no sensor answers.
    #[error(
        "{} does not answer{}: check its power and the wiring (after power-up it is silent for some seconds){}",
        or_sensor(sensor),
        match baud_rate { Some(baud_rate) => format!(" at {baud_rate} baud"), None if *searched => " at any baud rate".to_owned(), None => String::new() },
        if *bytes > 0 { format!("; found {bytes} bytes that are not a reply of SCIP 1.1") } else { String::new() },
    )]
    #[non_exhaustive]
    NoAnswer {
        /// The name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
        /// The only baud rate that was tried, where the port cannot change it.
        baud_rate: Option<BaudRate>,
        /// True if all six baud rates were tried.
        searched: bool,
        /// The number of bytes that came and made no reply.
        bytes: u64,
    },
    /// The port returns what is written to it.
    #[error(
        "{} returns what is written to it, as a loopback plug, a terminal with echo or crossed wires do: connect a sensor to the port",
        or_sensor(sensor)
    )]
    #[non_exhaustive]
    Loopback {
        /// The name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
    },
    /// The sensor speaks SCIP 2.
    #[error(
        "{} speaks SCIP 2 (status \"{status}\"): power-cycle it, a URG-04LX is back in SCIP 1.1 after a restart; a model that knows only SCIP 2 cannot be used",
        or_sensor(sensor)
    )]
    #[non_exhaustive]
    WrongProtocol {
        /// The name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
        /// The status line of three characters, which only SCIP 2 has.
        status: Text,
    },
    /// Another sensor answers than the one that is expected.
    #[error(
        "{} has the wrong serial number: expected {expected}, found {found}: plug in {expected}, or ask for {found}",
        or_sensor(sensor)
    )]
    #[non_exhaustive]
    AnotherSensor {
        /// The name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
        /// The serial number that was expected.
        expected: Text,
        /// The serial number of the sensor that answers.
        found: Text,
    },
    /// The link is gone: unplugged, hung up, or silent for good.
    #[error("the link to {} is lost", or_sensor(sensor))]
    #[non_exhaustive]
    Disconnected {
        /// The name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
        /// The error of the port, if there was one.
        source: Option<Arc<io::Error>>,
    },
    /// The sensor did not answer in time.
    #[error("the sensor did not answer {command} within {} ms", after.as_millis())]
    #[non_exhaustive]
    Timeout {
        /// The command.
        command: Command,
        /// The time from the command to the deadline.
        after: Duration,
    },
    /// The sensor refused the command.
    #[error(
        "the sensor refused {command} with status {status}{}",
        match status.meaning(command) { Some(meaning) => format!(": {meaning}"), None => String::new() }
    )]
    #[non_exhaustive]
    Refused {
        /// The command.
        command: Command,
        /// The status of its reply.
        status: Status,
    },
    /// The reply was malformed.
    #[error("the reply to {command} is malformed")]
    #[non_exhaustive]
    Malformed {
        /// The command.
        command: Command,
        /// The place, what was expected there, and what was found.
        source: Malformed,
    },
    /// The laser is off by request, so that there is no scan.
    #[error("the laser is switched off: switch it on before asking for scans")]
    LaserOff,
    /// The sensor answered a command and did not act on it: its laser or its baud
    /// rate stays as it was.
    #[error("{}", not_confirmed(command, *status, *refusal))]
    #[non_exhaustive]
    NotConfirmed {
        /// The command.
        command: Command,
        /// The status of its reply, or `None` if no reply came.
        status: Option<Status>,
        /// The status with which the sensor refuses to measure, where the laser
        /// stays off.
        refusal: Option<Status>,
    },
    /// The port cannot be set to this baud rate.
    #[error("the port cannot be set to {baud_rate} baud{}", if source.is_some() { "" } else { ": its baud rate is fixed at the other end" })]
    UnsupportedBaudRate {
        /// The baud rate, as the caller named it.
        baud_rate: BaudRate,
        /// The reason, from the system.
        #[source]
        source: Option<Arc<io::Error>>,
    },
    /// The driver's task has panicked: in an observer, a `Connect` or a `Port` of the
    /// caller, or in the driver itself.
    #[error("the driver's task has panicked: {message}")]
    #[non_exhaustive]
    Panicked {
        /// The message of the panic.
        message: String,
    },
    /// The driver has ended: it was closed, or its task was dropped.
    #[error("the driver of the sensor has ended")]
    Closed,
}

/// Returns the message of [`Error::NotConfirmed`].
fn not_confirmed(command: &Command, status: Option<Status>, refusal: Option<Status>) -> String {
    let mut text = match command {
        Command::LaserOn => "the laser stays off".to_owned(),
        Command::LaserOff => "the laser stays on".to_owned(),
        _ => "the sensor keeps its baud rate".to_owned(),
    };
    text += &match status {
        Some(status) => format!(": the sensor answered {command} with status {status}"),
        None => format!(": the sensor did not answer {command}"),
    };
    text += &match (refusal, command) {
        (Some(refusal), _) => format!(", and refuses to measure with status {refusal}"),
        (None, Command::LaserOff) => ", and still measures".to_owned(),
        (None, _) => ", and did not act on it".to_owned(),
    };
    text + "; power-cycle it"
}

impl Error {
    /// Returns true if trying again later may help without doing anything else: the
    /// link may come back, the next scan may be whole. This holds for [`NoSuchPort`](Self::NoSuchPort),
    /// [`NoSuchSensor`](Self::NoSuchSensor), [`Busy`](Self::Busy),
    /// [`Open`](Self::Open), [`NoAnswer`](Self::NoAnswer),
    /// [`Disconnected`](Self::Disconnected), [`Timeout`](Self::Timeout),
    /// [`Malformed`](Self::Malformed) and [`NotConfirmed`](Self::NotConfirmed).
    /// The others need a change first, of the machine, the sensor or the program. A
    /// driver that has ended stays ended, whatever the error.
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
            | Self::Loopback { .. }
            | Self::WrongProtocol { .. }
            | Self::AnotherSensor { .. }
            | Self::Refused { .. }
            | Self::LaserOff
            | Self::Panicked { .. }
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
    /// let error = Error::Open { port: "/dev/ttyACM0".to_owned(), source };
    /// assert_eq!(error.to_string(), "cannot open /dev/ttyACM0");
    /// assert_eq!(error.chain().to_string(), "cannot open /dev/ttyACM0: device removed");
    /// ```
    pub fn chain(&self) -> ErrorChain<'_> {
        ErrorChain::new(self)
    }

    pub(crate) fn open(port: impl Into<String>, source: io::Error) -> Self {
        Self::Open { port: port.into(), source: Arc::new(source) }
    }

    pub(crate) fn disconnected(source: Option<io::Error>) -> Self {
        Self::Disconnected { sensor: None, source: source.map(Arc::new) }
    }

    /// Returns this error with the name of the sensor, in the kinds that have one.
    pub(crate) fn named(mut self, name: Option<&Arc<str>>) -> Self {
        if let (
            Self::NoAnswer { sensor, .. }
            | Self::Loopback { sensor }
            | Self::WrongProtocol { sensor, .. }
            | Self::AnotherSensor { sensor, .. }
            | Self::Disconnected { sensor, .. },
            Some(name),
        ) = (&mut self, name)
        {
            sensor.get_or_insert_with(|| Arc::clone(name));
        }
        self
    }
}

fn or_sensor(name: &Option<Arc<str>>) -> &str {
    name.as_deref().unwrap_or("the sensor")
}

/// Converts to an I/O error of the nearest kind, with this one inside, so that a function
/// that returns `io::Result` can use `?`.
impl From<Error> for io::Error {
    fn from(error: Error) -> Self {
        let kind = match &error {
            Error::InvalidEndpoint { .. } => io::ErrorKind::InvalidInput,
            Error::NoSuchPort { .. } | Error::NoSuchSensor { .. } => io::ErrorKind::NotFound,
            Error::PermissionDenied { .. } => io::ErrorKind::PermissionDenied,
            Error::Busy { .. } => io::ErrorKind::ResourceBusy,
            Error::Open { source, .. } => source.kind(),
            Error::NoAnswer { .. } | Error::Timeout { .. } => io::ErrorKind::TimedOut,
            Error::Disconnected { source: Some(source), .. } => source.kind(),
            Error::Disconnected { source: None, .. } | Error::Closed => io::ErrorKind::NotConnected,
            Error::Malformed { .. } | Error::WrongProtocol { .. } => io::ErrorKind::InvalidData,
            Error::UnsupportedBaudRate { .. } => io::ErrorKind::Unsupported,
            Error::NotASerialPort { .. }
            | Error::Loopback { .. }
            | Error::AnotherSensor { .. }
            | Error::Refused { .. }
            | Error::LaserOff
            | Error::Panicked { .. }
            | Error::NotConfirmed { .. } => io::ErrorKind::Other,
        };
        Self::new(kind, error)
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
    fn the_name_of_the_sensor_is_in_the_errors_of_its_link() {
        let name: Arc<str> = "left".into();
        let lost = Error::disconnected(None);
        assert_eq!(lost.to_string(), "the link to the sensor is lost");
        let lost = lost.named(Some(&name));
        assert_eq!(lost.to_string(), "the link to left is lost");
        assert_eq!(lost.named(Some(&"right".into())).to_string(), "the link to left is lost");
        let silent = Error::NoAnswer { sensor: None, baud_rate: None, searched: true, bytes: 0 };
        let silent = silent.named(Some(&name)).to_string();
        assert!(silent.starts_with("left does not answer at any baud rate: "), "{silent}");
        assert!(Error::Loopback { sensor: None }.to_string().starts_with("the sensor returns"));
    }

    #[test]
    fn an_io_error_keeps_the_kind_and_the_error() {
        let refused = io::Error::from(io::ErrorKind::ConnectionRefused);
        let open = Error::Open { port: "tcp://bridge:1".to_owned(), source: Arc::new(refused) };
        let error = io::Error::from(open);
        assert_eq!(error.kind(), io::ErrorKind::ConnectionRefused);
        let inner = error.into_inner().and_then(|inner| inner.downcast::<Error>().ok());
        assert!(matches!(inner.as_deref(), Some(Error::Open { .. })));
        let missing = Error::NoSuchPort { port: "/dev/ttyACM0".to_owned() };
        assert_eq!(io::Error::from(missing).kind(), io::ErrorKind::NotFound);
        assert_eq!(io::Error::from(Error::Closed).kind(), io::ErrorKind::NotConnected);
    }
}
