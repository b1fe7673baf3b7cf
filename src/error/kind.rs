//! [`ErrorKind`]: what can fail, and the sentence that says so.

use std::fmt;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use crate::protocol::{BaudRate, MalformedError, Protocol, Text};

/// What failed, as [`Error::kind`](crate::Error::kind) returns it.
///
/// Convert a kind with [`Error::from`](crate::Error), for a [`Connect`](crate::port::Connect) of
/// your own or a test. You can construct every variant that a `Connect` of your own returns. The other
/// variants with fields are `#[non_exhaustive]`: only this crate constructs them, and they may get more.
#[derive(Debug, Clone, thiserror::Error)]
#[error("{}", Sentence { kind: self, sensor: "the sensor" })]
#[non_exhaustive]
pub enum ErrorKind {
    /// The text is not an [`Endpoint`](crate::Endpoint).
    #[non_exhaustive]
    InvalidEndpoint {
        /// Text as passed.
        text: String,
        /// Reason, and what was expected.
        reason: &'static str,
    },
    /// No such port exists.
    NoSuchPort {
        /// Port, as the caller named it.
        port: String,
    },
    /// The path exists but is not a serial port.
    NotASerialPort {
        /// Port, as the caller named it.
        port: String,
    },
    /// The user may not open the port.
    PermissionDenied {
        /// Port, as the caller named it.
        port: String,
        /// Group that owns the port, if known.
        group: Option<String>,
    },
    /// Another program has the port.
    Busy {
        /// Port, as the caller named it.
        port: String,
    },
    /// Opening the port failed for another reason.
    Open {
        /// Port, as the caller named it.
        port: String,
        /// Error of the system.
        source: Arc<io::Error>,
    },
    /// No port leads to the sensor with this serial number.
    NoSuchSensor {
        /// Serial number, as the caller named it.
        serial_number: String,
        /// Serial numbers of the sensors that the ports lead to.
        found: Vec<Text>,
    },
    /// The port is open, but no sensor answers.
    #[non_exhaustive]
    NoAnswer {
        /// Only baud rate that was tried, if the port cannot change it.
        baud_rate: Option<BaudRate>,
        /// True if all baud rates of the port were tried.
        searched: bool,
        /// Baud rates that the port could not be set to.
        refused: Vec<BaudRate>,
        /// Number of received bytes that are not part of a reply.
        bytes: u64,
        /// Text that came in place of replies, such as a server's banner.
        words: Option<Text>,
    },
    /// The other end sent text in place of a reply, and closed the port: a serial server refused you.
    #[non_exhaustive]
    Rejected {
        /// Its text, such as `Port already in use`.
        words: Text,
        /// Error of the port, if there was one.
        source: Option<Arc<io::Error>>,
    },
    /// The port sends back what the driver writes to it.
    Loopback,
    /// The sensor does not speak the protocol that you asked for with
    /// [`SensorBuilder::protocol`](crate::SensorBuilder::protocol).
    #[non_exhaustive]
    WrongProtocol {
        /// Protocol that you asked for.
        expected: Protocol,
        /// Status of the sensor's answer, which belongs to the other protocol.
        status: Text,
    },
    /// A sensor other than the expected one answered.
    #[non_exhaustive]
    AnotherSensor {
        /// Expected serial number.
        expected: Text,
        /// Serial number of the sensor that answered.
        found: Text,
    },
    /// Link lost: unplugged, hung up, or silent for too long.
    Disconnected {
        /// Error of the port, if there was one.
        source: Option<Arc<io::Error>>,
    },
    /// The sensor did not answer in time.
    #[non_exhaustive]
    Timeout {
        /// What the driver wanted.
        operation: Operation,
        /// Command without a reply, as text.
        command: Text,
        /// Time from the command to the deadline.
        after: Duration,
    },
    /// The sensor refused the command.
    #[non_exhaustive]
    Refused {
        /// What the driver wanted.
        operation: Operation,
        /// Refused command, as text.
        command: Text,
        /// Status of the reply.
        status: Text,
        /// Meaning of the status, if it is known.
        meaning: Option<&'static str>,
    },
    /// A reply was malformed.
    #[non_exhaustive]
    Malformed {
        /// What the driver wanted.
        operation: Operation,
        /// Command of the malformed reply, as text.
        command: Text,
        /// Position, what was expected there, and what was found.
        source: MalformedError,
    },
    /// Your service switched the laser off, so there are no scans.
    LaserOff,
    /// The sensor did not act on a command for its laser, or does not answer at its new baud rate.
    #[non_exhaustive]
    NotConfirmed {
        /// What the driver wanted.
        operation: Operation,
        /// Command without effect, as text.
        command: Text,
        /// Status of the reply, or `None` if there was no reply.
        status: Option<Text>,
        /// Status with which the sensor refuses to measure, if the laser stays off.
        refusal: Option<Text>,
    },
    /// This port does not support the baud rate.
    #[non_exhaustive]
    UnsupportedBaudRate {
        /// Baud rate, as the caller named it.
        baud_rate: BaudRate,
        /// Error of the system.
        source: Option<Arc<io::Error>>,
    },
    /// The sensor speaks SCIP 1.1, which has no command to restart it.
    UnsupportedReboot,
    /// The driver's task panicked: in your observer, `Connect` or `Port`, or in the driver itself.
    #[non_exhaustive]
    Panicked {
        /// Message of the panic.
        message: String,
    },
    /// The driver has ended: it was closed, or its task was dropped.
    Closed,
    /// Error of another type of this crate, such as
    /// [`WindowError`](crate::protocol::WindowError), which `?` has converted.
    #[error(transparent)]
    #[non_exhaustive]
    Other {
        /// That error.
        source: Arc<dyn std::error::Error + Send + Sync>,
    },
}

/// What the driver wanted of the sensor when a command failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Operation {
    /// To know which sensor it is.
    Identify,
    /// To switch the laser on.
    LaserOn,
    /// To switch the laser off.
    LaserOff,
    /// To change the baud rate.
    SetBaudRate,
    /// To restart the sensor.
    Reboot,
    /// To get a scan, or to know whether the sensor answers.
    Scan,
}

impl ErrorKind {
    pub(crate) fn disconnected(source: Option<io::Error>) -> Self {
        Self::Disconnected { source: source.map(Arc::new) }
    }

    pub(crate) fn is_transient(&self) -> bool {
        matches!(
            self,
            Self::NoSuchPort { .. }
                | Self::NoSuchSensor { .. }
                | Self::Busy { .. }
                | Self::Open { .. }
                | Self::NoAnswer { .. }
                | Self::Rejected { .. }
                | Self::Disconnected { .. }
                | Self::Timeout { .. }
                | Self::Malformed { .. }
                | Self::NotConfirmed { .. }
        )
    }
}

/// One sentence: what failed, and the name of the sensor.
pub(super) struct Sentence<'a> {
    pub(super) kind: &'a ErrorKind,
    pub(super) sensor: &'a str,
}

impl fmt::Display for Sentence<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { kind, sensor } = self;
        match kind {
            ErrorKind::InvalidEndpoint { text, reason } => {
                write!(f, "invalid port {text:?}: {reason}")
            }
            ErrorKind::NoSuchPort { port } if port.starts_with("tty") => {
                write!(f, "no port {port}: write its whole path, /dev/{port}")
            }
            ErrorKind::NoSuchPort { port } => {
                write!(f, "no port {port}: plug the sensor in, and check the name of the port")
            }
            ErrorKind::NotASerialPort { port } => {
                write!(f, "{port} is not a serial port: use a device such as /dev/ttyACM0")
            }
            ErrorKind::PermissionDenied { port, group: Some(group) } => write!(
                f,
                "no permission to open {port}: add the user to the group {group} (`sudo usermod -aG {group} $USER`, then log in again)"
            ),
            ErrorKind::PermissionDenied { port, group: None } => {
                write!(f, "no permission to open {port}: give the user read and write access to it")
            }
            ErrorKind::Busy { port } if port.starts_with('/') => write!(
                f,
                "{port} is in use: stop the program that has it open, such as gpsd (`sudo fuser {port}` shows it)"
            ),
            ErrorKind::Busy { port } => {
                write!(f, "{port} is in use: stop the program that has it open")
            }
            ErrorKind::Open { port, source } => {
                write!(f, "cannot open {port}{}", remedy(port, source.kind()))
            }
            ErrorKind::NoSuchSensor { serial_number, found } => {
                let only = if found.is_empty() { "" } else { ", only " };
                let found = found.iter().map(Text::to_string).collect::<Vec<_>>().join(", ");
                write!(
                    f,
                    "no sensor with serial number {serial_number} on any port{only}{found}: plug it in, and stop other programs that have its port open (busy ports are skipped)"
                )
            }
            ErrorKind::NoAnswer { baud_rate, searched, refused, bytes, words } => {
                write_no_answer(f, sensor, *baud_rate, *searched, refused)?;
                match (bytes, words) {
                    (0, _) => Ok(()),
                    (_, Some(words)) => write!(f, "; found the text \"{words}\""),
                    (_, None) => write!(f, "; found {bytes} bytes that are not a SCIP reply"),
                }
            }
            ErrorKind::Rejected { words, .. } => write!(
                f,
                "{sensor} cannot be reached: its serial server says \"{words}\" and closes the connection"
            ),
            ErrorKind::Loopback => write!(
                f,
                "{sensor} returns what is written to it, as a loopback plug, a terminal with echo or crossed wires do: connect a sensor to the port"
            ),
            ErrorKind::WrongProtocol { expected: Protocol::Scip1, status } => write!(
                f,
                "{sensor} speaks SCIP 2 (status \"{status}\"), and you asked for SCIP 1.1: ask for no protocol, or power-cycle a URG-04LX to return it to SCIP 1.1"
            ),
            ErrorKind::WrongProtocol { expected: Protocol::Scip2, status } => write!(
                f,
                "{sensor} speaks SCIP 1.1 (status \"{status}\"), and you asked for SCIP 2: ask for no protocol"
            ),
            ErrorKind::AnotherSensor { expected, found } => write!(
                f,
                "{sensor} has the wrong serial number: expected {expected}, found {found}: plug in {expected}, or ask for {found} or any sensor"
            ),
            ErrorKind::Disconnected { .. } => write!(f, "the link to {sensor} is lost"),
            ErrorKind::Timeout { command, after, .. } => {
                write!(f, "{sensor} did not answer {command} within {} ms", after.as_millis())
            }
            ErrorKind::Refused { command, status, meaning, .. } => {
                write!(f, "{sensor} refused {command} with status '{status}'")?;
                meaning.map_or(Ok(()), |meaning| write!(f, ": {meaning}"))
            }
            ErrorKind::Malformed { command, .. } => {
                write!(f, "the reply of {sensor} to {command} is malformed")
            }
            ErrorKind::LaserOff => write!(
                f,
                "the laser of {sensor} is switched off: switch it on before asking for scans"
            ),
            ErrorKind::NotConfirmed { operation, command, status, refusal } => {
                let (status, refusal) = (status.as_ref(), refusal.as_ref());
                write_not_confirmed(f, sensor, *operation, command, status, refusal)
            }
            ErrorKind::UnsupportedBaudRate { baud_rate, source } => {
                let why = if source.is_some() {
                    ""
                } else {
                    ": its baud rate is fixed at the other end, and a sensor on Ethernet has none"
                };
                write!(f, "the port of {sensor} cannot be set to {baud_rate} baud{why}")
            }
            ErrorKind::UnsupportedReboot => {
                write!(f, "{sensor} speaks SCIP 1.1, which cannot restart it: power-cycle it")
            }
            ErrorKind::Panicked { message } => {
                write!(f, "the driver of {sensor} has panicked: {message}")
            }
            ErrorKind::Closed => write!(f, "the driver of {sensor} has ended"),
            ErrorKind::Other { source } => source.fmt(f),
        }
    }
}

/// Returns what to do about an error of opening a port, or nothing if that is not known.
fn remedy(port: &str, error: io::ErrorKind) -> &'static str {
    match error {
        io::ErrorKind::ConnectionRefused => {
            ": a sensor on Ethernet may still boot, or serve another client; otherwise start its server, or correct the address"
        }
        // A UST may leave another client's connection unanswered.
        io::ErrorKind::TimedOut if port.starts_with("tcp://") => {
            ": check its power and address, and stop other programs that are connected to it; if there is none, power-cycle it"
        }
        io::ErrorKind::HostUnreachable | io::ErrorKind::NetworkUnreachable => {
            ": check its power, cable and address (192.168.0.10 when new), and give this computer an address in the same network"
        }
        // As the look-up of a host's name fails.
        io::ErrorKind::NotFound if port.starts_with("tcp://") => {
            ": check the name of the host, and this computer's network"
        }
        _ => "",
    }
}

/// Writes that no sensor answers, and what to check.
fn write_no_answer(
    f: &mut fmt::Formatter<'_>,
    sensor: &str,
    baud_rate: Option<BaudRate>,
    searched: bool,
    refused: &[BaudRate],
) -> fmt::Result {
    let wherever = if searched { " at any baud rate" } else { "" };
    write!(
        f,
        "{sensor} does not answer{wherever}: check its power and the wiring (after power-up it is silent for some seconds)"
    )?;
    let all = refused.iter().map(BaudRate::to_string).collect::<Vec<_>>().join(" or ");
    if !all.is_empty() {
        write!(f, ", and power-cycle it if it is at {all} baud, which the port lacks")?;
    }
    if let Some(baud_rate) = baud_rate {
        write!(
            f,
            ", and the baud rate of the serial server ({baud_rate} in its address): it must be the sensor's, which is usually 19200 after power-up"
        )?;
    }
    if sensor.starts_with("tcp://") {
        f.write_str(", and stop other programs that are connected to it: it may serve only one")
    } else if baud_rate.is_none() && !searched {
        f.write_str(", and its model: a UST-05LN or UTX-10LN does not speak SCIP")
    } else {
        Ok(())
    }
}

/// Writes that the sensor did not act on a command, whatever its answer was.
fn write_not_confirmed(
    f: &mut fmt::Formatter<'_>,
    sensor: &str,
    operation: Operation,
    command: &Text,
    status: Option<&Text>,
    refusal: Option<&Text>,
) -> fmt::Result {
    match operation {
        Operation::LaserOn => write!(f, "the laser of {sensor} stays off")?,
        Operation::LaserOff => write!(f, "the laser of {sensor} stays on")?,
        _ => write!(f, "{sensor} does not answer at the new baud rate")?,
    }
    match status {
        Some(status) => write!(f, ": it answered {command} with status '{status}'")?,
        None => write!(f, ": it did not answer {command}")?,
    }
    match (refusal, operation) {
        (Some(refusal), _) => write!(f, ", and refuses to measure with status '{refusal}'")?,
        (None, Operation::LaserOff) => f.write_str(", and still measures")?,
        (None, Operation::LaserOn) => f.write_str(", and did not act on it")?,
        (None, _) => f.write_str(" (some adapters misreport theirs)")?,
    }
    f.write_str("; power-cycle it")
}
