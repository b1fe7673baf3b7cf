//! [`Error`]: everything that can fail, for the crate's users. Errors of the protocol
//! itself are in [`protocol`](crate::protocol).

mod chain;

use std::fmt;
use std::io;
use std::sync::Arc;
use std::time::Duration;

pub use self::chain::ErrorChain;
use crate::protocol::{BaudRate, Command, Malformed, Status, Text};

/// Why an operation failed, and what to do about it.
///
/// `Display` writes one line without the cause; [`source`](std::error::Error::source) returns it.
/// In a log, write [`chain`](Self::chain), which has both. An error is cheap to clone: all callers
/// that wait for the same event get the same error.
///
/// `Debug` writes the same as `chain`: a `main` that returns the error tells your user what to do.
///
/// A direction without a distance is not an error but a [`Measurement`](crate::Measurement).
///
/// You can construct every variant that a [`Connect`](crate::port::Connect) returns. The other
/// variants are `#[non_exhaustive]`: only the driver constructs them, and they may get more fields.
#[derive(Clone, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The text is not an [`Endpoint`](crate::Endpoint).
    #[error("invalid port {text:?}: {reason}")]
    #[non_exhaustive]
    InvalidEndpoint {
        /// Text as passed.
        text: String,
        /// Reason, and what was expected.
        reason: &'static str,
    },
    /// No such port exists.
    #[error("no port {port}: plug the sensor in, and check the name of the port")]
    NoSuchPort {
        /// Port, as the caller named it.
        port: String,
    },
    /// The path exists but is not a serial port.
    #[error("{port} is not a serial port: use a device such as /dev/ttyACM0")]
    NotASerialPort {
        /// Port, as the caller named it.
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
        /// Port, as the caller named it.
        port: String,
        /// Group that owns the port, if known.
        group: Option<String>,
    },
    /// Another program has the port.
    #[error(
        "{port} is in use: stop the program that has it open (`fuser {port}` shows it; ModemManager probes new ports for some seconds)"
    )]
    Busy {
        /// Port, as the caller named it.
        port: String,
    },
    /// Opening the port failed for another reason.
    #[error("cannot open {port}")]
    Open {
        /// Port, as the caller named it.
        port: String,
        /// Error of the system.
        source: Arc<io::Error>,
    },
    /// No port leads to the sensor with this serial number.
    #[error(
        "no sensor with serial number {serial_number} on any port: plug it in, and stop other programs that have its port open (busy ports are skipped)"
    )]
    NoSuchSensor {
        /// Serial number, as the caller named it.
        serial_number: String,
    },
    /// The port is open, but no sensor answers.
    #[error(
        "{} does not answer{}: check its power and the wiring (after power-up it is silent for some seconds){}",
        or_sensor(sensor),
        if *searched { " at any baud rate" } else { "" },
        if *bytes > 0 { format!("; found {bytes} bytes that are not a reply of SCIP 1.1") } else { String::new() },
    )]
    #[non_exhaustive]
    NoAnswer {
        /// Name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
        /// Only baud rate that was tried, if the port cannot change it.
        baud_rate: Option<BaudRate>,
        /// True if all six baud rates were tried.
        searched: bool,
        /// Number of received bytes that are not part of a reply.
        bytes: u64,
    },
    /// The port sends back what the driver writes to it.
    #[error(
        "{} returns what is written to it, as a loopback plug, a terminal with echo or crossed wires do: connect a sensor to the port",
        or_sensor(sensor)
    )]
    #[non_exhaustive]
    Loopback {
        /// Name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
    },
    /// The sensor speaks SCIP 2.
    #[error(
        "{} speaks SCIP 2 (status \"{status}\"): power-cycle it to return a URG-04LX to SCIP 1.1; models that know only SCIP 2 are not supported",
        or_sensor(sensor)
    )]
    #[non_exhaustive]
    WrongProtocol {
        /// Name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
        /// Status line of three characters, which only SCIP 2 has.
        status: Text,
    },
    /// A sensor other than the expected one answered.
    #[error(
        "{} has the wrong serial number: expected {expected}, found {found}: plug in {expected}, or ask for {found}",
        or_sensor(sensor)
    )]
    #[non_exhaustive]
    AnotherSensor {
        /// Name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
        /// Expected serial number.
        expected: Text,
        /// Serial number of the sensor that answered.
        found: Text,
    },
    /// Link lost: unplugged, hung up, or silent for too long.
    #[error("the link to {} is lost", or_sensor(sensor))]
    #[non_exhaustive]
    Disconnected {
        /// Name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
        /// Error of the port, if there was one.
        source: Option<Arc<io::Error>>,
    },
    /// The sensor did not answer in time.
    #[error("{} did not answer {command} within {} ms", or_sensor(sensor), after.as_millis())]
    #[non_exhaustive]
    Timeout {
        /// Name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
        /// Command without a reply.
        command: Command,
        /// Time from the command to the deadline.
        after: Duration,
    },
    /// The sensor refused the command.
    #[error(
        "{} refused {command} with status {status}{}",
        or_sensor(sensor),
        match status.meaning(command) { Some(meaning) => format!(": {meaning}"), None => String::new() }
    )]
    #[non_exhaustive]
    Refused {
        /// Name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
        /// Refused command.
        command: Command,
        /// Status of the reply.
        status: Status,
    },
    /// A reply was malformed.
    #[error("the reply of {} to {command} is malformed", or_sensor(sensor))]
    #[non_exhaustive]
    Malformed {
        /// Name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
        /// Command of the malformed reply.
        command: Command,
        /// Position, what was expected there, and what was found.
        source: Malformed,
    },
    /// Your service switched the laser off, so there are no scans.
    #[error(
        "the laser of {} is switched off: switch it on before asking for scans",
        or_sensor(sensor)
    )]
    #[non_exhaustive]
    LaserOff {
        /// Name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
    },
    /// The sensor did not act on a command: its laser or baud rate stays as it was.
    #[error("{}", not_confirmed(or_sensor(sensor), command, *status, *refusal))]
    #[non_exhaustive]
    NotConfirmed {
        /// Name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
        /// Command without effect.
        command: Command,
        /// Status of the reply, or `None` if there was no reply.
        status: Option<Status>,
        /// Status with which the sensor refuses to measure, if the laser stays off.
        refusal: Option<Status>,
    },
    /// This port does not support the baud rate.
    #[error("the port of {} cannot be set to {baud_rate} baud{}", or_sensor(sensor), if source.is_some() { "" } else { ": its baud rate is fixed at the other end" })]
    #[non_exhaustive]
    UnsupportedBaudRate {
        /// Name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
        /// Baud rate, as the caller named it.
        baud_rate: BaudRate,
        /// Error of the system.
        #[source]
        source: Option<Arc<io::Error>>,
    },
    /// The driver's task panicked: in your observer, `Connect` or `Port`, or in the driver itself.
    #[error("the driver of {} has panicked: {message}", or_sensor(sensor))]
    #[non_exhaustive]
    Panicked {
        /// Name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
        /// Message of the panic.
        message: String,
    },
    /// The driver has ended: it was closed, or its task was dropped.
    #[error("the driver of {} has ended", or_sensor(sensor))]
    Closed {
        /// Name of the sensor or its port, if it has one.
        sensor: Option<Arc<str>>,
    },
}

/// Pattern of the errors that concern a link, and so the sensor behind it.
macro_rules! of_a_link {
    ($sensor:ident) => {
        Error::NoAnswer { sensor: $sensor, .. }
            | Error::Loopback { sensor: $sensor }
            | Error::WrongProtocol { sensor: $sensor, .. }
            | Error::AnotherSensor { sensor: $sensor, .. }
            | Error::Disconnected { sensor: $sensor, .. }
            | Error::Timeout { sensor: $sensor, .. }
            | Error::Refused { sensor: $sensor, .. }
            | Error::Malformed { sensor: $sensor, .. }
            | Error::LaserOff { sensor: $sensor }
            | Error::NotConfirmed { sensor: $sensor, .. }
            | Error::UnsupportedBaudRate { sensor: $sensor, .. }
            | Error::Panicked { sensor: $sensor, .. }
            | Error::Closed { sensor: $sensor }
    };
}

impl fmt::Debug for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Not `Debug` of the chain, which would come back here.
        fmt::Display::fmt(&self.chain(), f)
    }
}

/// Formats the message of [`Error::NotConfirmed`].
fn not_confirmed(
    sensor: &str,
    command: &Command,
    status: Option<Status>,
    refusal: Option<Status>,
) -> String {
    let mut text = match command {
        Command::LaserOn => format!("the laser of {sensor} stays off"),
        Command::LaserOff => format!("the laser of {sensor} stays on"),
        _ => format!("{sensor} keeps its baud rate"),
    };
    text += &match status {
        Some(status) => format!(": it answered {command} with status {status}"),
        None => format!(": it did not answer {command}"),
    };
    text += &match (refusal, command) {
        (Some(refusal), _) => format!(", and refuses to measure with status {refusal}"),
        (None, Command::LaserOff) => ", and still measures".to_owned(),
        (None, _) => ", and did not act on it".to_owned(),
    };
    text + "; power-cycle it"
}

impl Error {
    /// Returns true if you can try again later without changing anything: the link may come back,
    /// or the next scan may be whole. This applies to [`NoSuchPort`](Self::NoSuchPort),
    /// [`NoSuchSensor`](Self::NoSuchSensor), [`Busy`](Self::Busy), [`Open`](Self::Open),
    /// [`NoAnswer`](Self::NoAnswer), [`Disconnected`](Self::Disconnected),
    /// [`Timeout`](Self::Timeout), [`Malformed`](Self::Malformed) and
    /// [`NotConfirmed`](Self::NotConfirmed). For the others, change the machine, the sensor or the
    /// program first. A driver that has ended stays ended, whatever the error.
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
            | Self::LaserOff { .. }
            | Self::Panicked { .. }
            | Self::UnsupportedBaudRate { .. }
            | Self::Closed { .. } => false,
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

    /// Creates an [`Error::Open`], for a [`Connect`](crate::port::Connect) of your own.
    pub fn open(port: impl Into<String>, source: io::Error) -> Self {
        Self::Open { port: port.into(), source: Arc::new(source) }
    }

    pub(crate) fn disconnected(source: Option<io::Error>) -> Self {
        Self::Disconnected { sensor: None, source: source.map(Arc::new) }
    }

    /// Name of the sensor that this error concerns: the
    /// [name](crate::SensorBuilder::name) given to it, or else its port. An error of opening
    /// a port has the port or the serial number that was asked for. `None` for
    /// [`InvalidEndpoint`](Self::InvalidEndpoint), and where neither sensor nor port has a
    /// name, as with [`Sensor::attach`](crate::Sensor::attach).
    pub fn sensor(&self) -> Option<&str> {
        match self {
            Self::NoSuchPort { port }
            | Self::NotASerialPort { port }
            | Self::PermissionDenied { port, .. }
            | Self::Busy { port }
            | Self::Open { port, .. } => Some(port),
            Self::NoSuchSensor { serial_number } => Some(serial_number),
            Self::InvalidEndpoint { .. } => None,
            of_a_link!(sensor) => sensor.as_deref(),
        }
    }

    /// Adds the name of the sensor, unless the error has one. The driver leaves names out:
    /// handles, streams and states add them to all errors that they return.
    pub(crate) fn named(mut self, name: Option<&Arc<str>>) -> Self {
        let of_a_link!(sensor) = &mut self else { return self };
        if sensor.is_none() {
            *sensor = name.cloned();
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
            Error::Disconnected { source: None, .. } | Error::Closed { .. } => {
                io::ErrorKind::NotConnected
            }
            Error::Malformed { .. } | Error::WrongProtocol { .. } => io::ErrorKind::InvalidData,
            Error::UnsupportedBaudRate { .. } => io::ErrorKind::Unsupported,
            Error::NotASerialPort { .. }
            | Error::Loopback { .. }
            | Error::AnotherSensor { .. }
            | Error::Refused { .. }
            | Error::LaserOff { .. }
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
        let (command, baud_rate) = (Command::LaserOn, BaudRate::B115200);
        let after = Duration::from_millis(500);
        let errors = [
            Error::Timeout { sensor: None, command, after },
            Error::Refused { sensor: None, command, status: Status::OK },
            Error::Malformed { sensor: None, command, source: Malformed::NoData },
            Error::NotConfirmed { sensor: None, command, status: None, refusal: None },
            Error::UnsupportedBaudRate { sensor: None, baud_rate, source: None },
            Error::Panicked { sensor: None, message: String::new() },
            Error::LaserOff { sensor: None },
            Error::Closed { sensor: None },
        ];
        for error in errors {
            assert!(
                error.sensor().is_none() && error.to_string().contains("the sensor"),
                "{error}"
            );
            let error = error.named(Some(&name));
            assert_eq!(error.sensor(), Some("left"));
            assert!(error.to_string().contains("left"), "{error}");
        }
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
        assert_eq!(
            io::Error::from(Error::Closed { sensor: None }).kind(),
            io::ErrorKind::NotConnected
        );
    }
}
