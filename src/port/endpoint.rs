//! The ways to name a port: [`Endpoint`], and its text form. No port is
//! touched here.

use std::fmt;
use std::net::Ipv6Addr;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::EndpointConnector;
use crate::{BaudRate, Error};

/// Where a sensor is.
///
/// | text | what it names |
/// |---|---|
/// | `/dev/ttyACM0`, `COM3` | a serial port of this machine; names below `/dev/serial/by-path` stay the same when a sensor is plugged in again |
/// | `serial:H0713090` | the sensor with this serial number (`SERI:`), on whichever USB port it is |
/// | `tcp://bridge:4001` | a raw TCP bridge to a serial port whose speed is 19,200 baud |
/// | `tcp://[fe80::1%eth0]:4001?baud=115200` | the same by IPv6, with a port at 115,200 baud |
///
/// [`Display`](fmt::Display) writes the text that [`FromStr`] reads, and so do data
/// formats (feature `serde`). The first two need the feature `serial`.
///
/// ```
/// use tokio_scip::{BaudRate, Endpoint};
///
/// let endpoint: Endpoint = "tcp://bridge:4001?baud=57600".parse()?;
/// assert_eq!(
///     endpoint,
///     Endpoint::Tcp { host: "bridge".to_owned(), port: 4001, baud_rate: BaudRate::B57600 },
/// );
/// assert!("tcp://bridge".parse::<Endpoint>().is_err(), "which port?");
/// # Ok::<(), tokio_scip::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Endpoint {
    /// A serial port, by its path (Unix) or name (Windows).
    #[cfg(feature = "serial")]
    Serial(String),
    /// The sensor with this serial number, on any port with the sensors' USB
    /// id. Ports that are busy are skipped.
    #[cfg(feature = "serial")]
    SerialNumber(String),
    /// A TCP server that passes bytes to and from a sensor unchanged.
    Tcp {
        /// A host name or an address, IPv6 without its brackets.
        host: String,
        /// The TCP port.
        port: u16,
        /// The speed of the serial line behind the server. It cannot be changed
        /// from here.
        baud_rate: BaudRate,
    },
}

/// What a bridge's line is taken to run at where its address does not say:
/// sensors are at this speed after power-up.
const DEFAULT_BRIDGE_SPEED: BaudRate = BaudRate::B19200;

impl Endpoint {
    /// What opens the port, again after each loss of the link.
    pub fn into_connector(self) -> EndpointConnector {
        EndpointConnector::new(self)
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            #[cfg(feature = "serial")]
            Self::Serial(path) => f.write_str(path),
            #[cfg(feature = "serial")]
            Self::SerialNumber(number) => write!(f, "serial:{number}"),
            Self::Tcp { host, port, baud_rate } => {
                if host.contains(':') {
                    write!(f, "tcp://[{host}]:{port}")?;
                } else {
                    write!(f, "tcp://{host}:{port}")?;
                }
                if *baud_rate != DEFAULT_BRIDGE_SPEED {
                    write!(f, "?baud={baud_rate}")?;
                }
                Ok(())
            }
        }
    }
}

impl FromStr for Endpoint {
    type Err = Error;

    /// # Errors
    ///
    /// [`Error::InvalidEndpoint`], with the reason. Whether there is such a
    /// port is found out when it is opened.
    fn from_str(text: &str) -> Result<Self, Error> {
        parse(text).map_err(|reason| Error::InvalidEndpoint { text: text.to_owned(), reason })
    }
}

impl TryFrom<&str> for Endpoint {
    type Error = Error;

    fn try_from(text: &str) -> Result<Self, Error> {
        text.parse()
    }
}

impl TryFrom<&String> for Endpoint {
    type Error = Error;

    fn try_from(text: &String) -> Result<Self, Error> {
        text.parse()
    }
}

impl TryFrom<String> for Endpoint {
    type Error = Error;

    fn try_from(text: String) -> Result<Self, Error> {
        text.parse()
    }
}

/// A serial port by its path, whatever the path looks like.
///
/// # Errors
///
/// [`Error::InvalidEndpoint`] if the path is empty or not UTF-8, and without the feature
/// `serial`.
impl TryFrom<&Path> for Endpoint {
    type Error = Error;

    fn try_from(path: &Path) -> Result<Self, Error> {
        let endpoint = match path.to_str() {
            Some("") => Err("it is empty"),
            Some(path) => device(path),
            None => Err("it is not UTF-8"),
        };
        let text = || path.display().to_string();
        endpoint.map_err(|reason| Error::InvalidEndpoint { text: text(), reason })
    }
}

/// The same as for a `&Path`.
impl TryFrom<PathBuf> for Endpoint {
    type Error = Error;

    fn try_from(path: PathBuf) -> Result<Self, Error> {
        path.as_path().try_into()
    }
}

#[cfg(feature = "serde")]
impl serde::Serialize for Endpoint {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

#[cfg(feature = "serde")]
impl<'de> serde::Deserialize<'de> for Endpoint {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = <String as serde::Deserialize>::deserialize(deserializer)?;
        text.parse().map_err(serde::de::Error::custom)
    }
}

type Parsed = Result<Endpoint, &'static str>;

fn parse(text: &str) -> Parsed {
    if text.is_empty() {
        return Err("it is empty");
    }
    if text.trim() != text || text.contains(char::is_control) {
        return Err("it has white space at an end, or a control character in it");
    }
    if let Some(address) = text.strip_prefix("tcp://") {
        return parse_tcp(address);
    }
    if text.split_once("://").is_some_and(|(scheme, _)| !scheme.contains('/')) {
        return Err("the only kind of address with :// is tcp://HOST:PORT");
    }
    if let Some(number) = text.strip_prefix("serial:") {
        return serial_number(number);
    }
    // Not a file in the working directory, and not worth a "no such port".
    if !text.contains(['/', '\\']) && text.rsplit_once(':').is_some_and(|(_, end)| is_number(end)) {
        return Err("a TCP address is written tcp://HOST:PORT");
    }
    device(text)
}

#[cfg(feature = "serial")]
fn serial_number(number: &str) -> Parsed {
    if number.is_empty() {
        return Err("the serial number after serial: is missing");
    }
    if !number.bytes().all(|byte| byte.is_ascii_graphic()) {
        return Err("a serial number is printable ASCII without spaces, as in serial:H0713090");
    }
    Ok(Endpoint::SerialNumber(number.to_owned()))
}

#[cfg(feature = "serial")]
fn device(path: &str) -> Parsed {
    Ok(Endpoint::Serial(path.to_owned()))
}

#[cfg(not(feature = "serial"))]
fn serial_number(_number: &str) -> Parsed {
    Err(NO_SERIAL)
}

#[cfg(not(feature = "serial"))]
fn device(_path: &str) -> Parsed {
    Err(NO_SERIAL)
}

#[cfg(not(feature = "serial"))]
const NO_SERIAL: &str =
    "serial ports need the feature `serial` of tokio-scip, which this program was built without";

fn parse_tcp(address: &str) -> Parsed {
    let (authority, baud_rate) = match address.split_once('?') {
        None => (address, DEFAULT_BRIDGE_SPEED),
        Some((authority, query)) => (authority, parse_query(query)?),
    };
    let (host, port) = match authority.strip_prefix('[') {
        Some(bracketed) => {
            let (host, rest) = bracketed.split_once(']').ok_or("the bracket is never closed")?;
            // The zone, as in fe80::1%eth0, is the system's to judge.
            let (address, zone) = host.split_once('%').unwrap_or((host, "0"));
            if address.parse::<Ipv6Addr>().is_err() || zone.is_empty() {
                return Err("no IPv6 address is between the brackets");
            }
            (host, rest.strip_prefix(':').ok_or(MISSING_PORT)?)
        }
        None => {
            let (host, port) = authority.rsplit_once(':').ok_or(MISSING_PORT)?;
            if host.contains(':') {
                return Err("an IPv6 address goes in brackets, as in tcp://[::1]:4001");
            }
            if host.is_empty() {
                return Err("the host is missing, as in tcp://HOST:PORT");
            }
            if !host.bytes().all(|byte| byte.is_ascii_alphanumeric() || b".-_".contains(&byte)) {
                return Err("the host is neither a name nor an address");
            }
            (host, port)
        }
    };
    let port = match port {
        "" => return Err(MISSING_PORT),
        digits if is_number(digits) => digits.parse().ok().filter(|port| *port != 0),
        _ => None,
    };
    let port =
        port.ok_or("the TCP port is a number from 1 to 65535, with only ?baud=N after it")?;
    Ok(Endpoint::Tcp { host: host.to_owned(), port, baud_rate })
}

const MISSING_PORT: &str = "the TCP port is missing, as in tcp://HOST:PORT";

fn parse_query(query: &str) -> Result<BaudRate, &'static str> {
    let speed = query.strip_prefix("baud=").ok_or("after the ? only baud=N can follow")?;
    Some(speed)
        .filter(|speed| is_number(speed))
        .and_then(|speed| speed.parse().ok())
        .ok_or("baud is one of 19200, 57600, 115200, 250000, 500000 and 750000")
}

/// StreamPort digits: `parse` alone would take a sign, too.
fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}
