//! [`Endpoint`]: the name of a port, and its text form. Nothing here opens a port.

use std::fmt;
use std::net::Ipv6Addr;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::{BaudRate, Error, ErrorKind};

/// Name of the port that a sensor is connected to.
///
/// | text | what it names |
/// |---|---|
/// | `/dev/ttyACM0`, `COM3` | a serial port of this machine; names below `/dev/serial/by-path` stay the same when a sensor is plugged in again |
/// | `serial:H0713090` | the sensor with this serial number (`SERI:`), on whichever USB port it is |
/// | `tcp://192.168.0.10` | a sensor on Ethernet, at its TCP port 10940 |
/// | `tcp://bridge:4001` | a raw TCP bridge to a serial port at 19,200 baud |
/// | `tcp://[fe80::1%eth0]:4001?baud=115200` | the same by IPv6, with a port at 115,200 baud |
///
/// Every endpoint can be named and parsed; opening it needs the feature `serial` or `tcp`.
/// [`Display`](fmt::Display) writes a parsed endpoint as a text that parses to the same endpoint.
/// Fields that you set yourself are not checked, and their text may not parse.
///
/// A [`Path`](std::path::Path) is always a serial port; it must be UTF-8 without control characters.
/// With feature `serde`, an endpoint is serialised as its text.
///
/// ```
/// use tokio_scip::{BaudRate, Endpoint};
///
/// let endpoint: Endpoint = "tcp://bridge:4001?baud=57600".parse()?;
/// assert_eq!(
///     endpoint,
///     Endpoint::Tcp { host: "bridge".to_owned(), port: 4001, baud_rate: BaudRate::B57600 },
/// );
/// assert!("tcp://bridge:".parse::<Endpoint>().is_err(), "which port?");
/// # Ok::<(), tokio_scip::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize), serde(try_from = "String"))]
#[non_exhaustive]
pub enum Endpoint {
    /// A serial port, by its path (Unix) or name (Windows), locked for other programs while it is open.
    ///
    /// Closing it discards unsent output. A thread of its own closes it: dropping the port waits at most
    /// 20 ms. If the device takes no bytes, the system needs up to half a minute, and the port is busy
    /// meanwhile. The driver drops a port that was unplugged, so that the system can assign the same
    /// name to the sensor when you plug it in again.
    Serial(String),
    /// Sensor with this serial number, on any USB port of a Hokuyo sensor. Skips busy ports.
    SerialNumber(String),
    /// Sensor on Ethernet, or a TCP server that passes bytes to and from a sensor unchanged.
    Tcp {
        /// Host name or address; IPv6 without brackets.
        host: String,
        /// TCP port.
        port: u16,
        /// Baud rate of the serial line that the server leads to. You cannot change it from here.
        /// At TCP port 10940, 19,200 baud stand for a sensor on Ethernet, which has no baud rate.
        baud_rate: BaudRate,
    },
}

/// TCP port of sensors on Ethernet.
const SENSOR_PORT: u16 = 10940;
/// Baud rate of a bridge's line if its address has none: the baud rate of a sensor after power-up.
const DEFAULT_BRIDGE_BAUD_RATE: BaudRate = BaudRate::B19200;

/// Baud rate of the line behind a TCP port, unless a sensor on Ethernet listens there.
#[cfg(feature = "tcp")]
pub(super) fn line_baud_rate(port: u16, baud_rate: BaudRate) -> Option<BaudRate> {
    (port != SENSOR_PORT || baud_rate != DEFAULT_BRIDGE_BAUD_RATE).then_some(baud_rate)
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial(path) => f.write_str(path),
            Self::SerialNumber(number) => write!(f, "serial:{number}"),
            Self::Tcp { host, port, baud_rate } => {
                if host.contains(':') {
                    write!(f, "tcp://[{host}]:{port}")?;
                } else {
                    write!(f, "tcp://{host}:{port}")?;
                }
                if *baud_rate != DEFAULT_BRIDGE_BAUD_RATE {
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
    /// Fails with [`ErrorKind::InvalidEndpoint`] and the reason. Does not look for the port.
    fn from_str(text: &str) -> Result<Self, Error> {
        let invalid = |reason| ErrorKind::InvalidEndpoint { text: text.to_owned(), reason };
        Ok(parse(text).map_err(invalid)?)
    }
}

impl Endpoint {
    /// Takes the path for a serial port, whatever it looks like.
    fn from_path(path: &Path) -> Result<Self, Error> {
        let reason = match path.to_str() {
            Some("") => EMPTY,
            Some(path) if path.contains(char::is_control) => {
                "remove the control characters from the path"
            }
            Some(path) => return Ok(Self::Serial(path.to_owned())),
            None => "a path to a serial port must be UTF-8",
        };
        Err(ErrorKind::InvalidEndpoint { text: path.display().to_string(), reason }.into())
    }
}

macro_rules! convert {
    ($($from:ty => $convert:ident),+) => {
        $(impl TryFrom<$from> for Endpoint {
            type Error = Error;

            fn try_from(from: $from) -> Result<Self, Error> {
                Self::$convert(from.as_ref())
            }
        })+
    };
}

convert!(&str => from_str, &String => from_str, String => from_str);
convert!(&Path => from_path, &PathBuf => from_path, PathBuf => from_path);

/// As data: its text, such as `"/dev/ttyACM0"`.
#[cfg(feature = "serde")]
impl serde::Serialize for Endpoint {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

type Parsed = Result<Endpoint, &'static str>;

fn parse(text: &str) -> Parsed {
    if text.is_empty() {
        return Err(EMPTY);
    }
    if text.trim() != text || text.contains(char::is_control) {
        return Err("remove white space at its ends and control characters");
    }
    if let Some(address) = text.strip_prefix("tcp://") {
        return parse_tcp(address);
    }
    let is_address = |(scheme, _): (&str, _)| !scheme.contains('/');
    if text.starts_with("tcp:") || text.split_once("://").is_some_and(is_address) {
        return Err("expected tcp://HOST or tcp://HOST:PORT, the only addresses with ://");
    }
    if let Some(number) = text.strip_prefix("serial:") {
        if number.is_empty() || !number.bytes().all(|byte| byte.is_ascii_graphic()) {
            return Err("expected a serial number without spaces, as in serial:H0713090");
        }
        return Ok(Endpoint::SerialNumber(number.to_owned()));
    }
    // Without this, HOST:PORT without tcp:// would pass for a file name.
    if !text.contains(['/', '\\']) && text.rsplit_once(':').is_some_and(|(_, end)| is_number(end)) {
        return Err("expected tcp://HOST:PORT for a TCP address");
    }
    if text.parse::<std::net::IpAddr>().is_ok() {
        return Err("expected tcp://HOST for a sensor on Ethernet");
    }
    Ok(Endpoint::Serial(text.to_owned()))
}

fn parse_tcp(address: &str) -> Parsed {
    let (authority, baud_rate) = match address.split_once('?') {
        None => (address, DEFAULT_BRIDGE_BAUD_RATE),
        Some((authority, query)) => (authority, parse_query(query)?),
    };
    let (host, port) = match authority.rsplit_once(':') {
        Some((host, port)) if !port.contains(']') => (host, Some(port)),
        // The colon is part of an IPv6 address.
        _ => (authority, None),
    };
    let host = match host.strip_prefix('[') {
        Some(bracketed) => {
            let host = bracketed.strip_suffix(']').ok_or(BRACKETS)?;
            // Only the system knows which zones exist, as in fe80::1%eth0.
            let (address, zone) = host.split_once('%').unwrap_or((host, "0"));
            if address.parse::<Ipv6Addr>().is_err() || zone.is_empty() {
                return Err("expected an IPv6 address in the brackets, as in tcp://[::1]:4001");
            }
            host
        }
        None if host.contains(':') => return Err(BRACKETS),
        None if host.is_empty() => return Err("the host is missing, as in tcp://HOST:PORT"),
        None if host.bytes().all(|byte| byte.is_ascii_alphanumeric() || b".-_".contains(&byte)) => {
            host
        }
        None => return Err("expected a host name or an address between tcp:// and the port"),
    };
    let port = match port {
        None => Some(SENSOR_PORT),
        Some(digits) if is_number(digits) => digits.parse().ok().filter(|port| *port != 0),
        Some(_) => None,
    };
    let port = port.ok_or("expected a TCP port from 1 to 65535, as in tcp://HOST:PORT?baud=N")?;
    Ok(Endpoint::Tcp { host: host.to_owned(), port, baud_rate })
}

const EMPTY: &str = "it is empty; expected a device path, serial:NUMBER or tcp://HOST:PORT";
const BRACKETS: &str = "expected brackets around the IPv6 address, as in tcp://[::1]:4001";

fn parse_query(query: &str) -> Result<BaudRate, &'static str> {
    let baud_rate =
        query.strip_prefix("baud=").ok_or("expected baud=N after the ?, and nothing else")?;
    Some(baud_rate)
        .filter(|digits| is_number(digits))
        .and_then(|digits| digits.parse().ok())
        .ok_or("expected one of 19200, 57600, 115200, 250000, 500000 and 750000 after baud=")
}

/// Returns true for digits only: `parse` alone also accepts a sign.
fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}
