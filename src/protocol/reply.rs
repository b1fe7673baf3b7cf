//! Validates a frame against the command that it should answer: the whole echo, the
//! status, and for `G` every line, every character and the number of points.
//!
//! SCIP 1.1 has no checksum, so every other sign of damage is checked: a frame that
//! passes has exactly the shape that its command asked for.

use std::fmt;

use super::measurement;
use super::{Command, Text, Window};

/// Data bytes in a full line of a `G` reply (C-42-3320-A p. 3 and 6).
pub(super) const BLOCK: usize = 64;
/// Bytes of a frame that an error message shows.
const EXCERPT: usize = 32;

/// The status of a reply: one character, of which only `0` means success
/// (C-42-3320-A p. 3). As data (feature `serde`) it is that character.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "serde", serde(into = "char"))]
pub struct Status(u8);

impl Status {
    /// `0`: success.
    pub const OK: Self = Self(b'0');

    /// Returns the status with this character.
    pub const fn new(character: u8) -> Self {
        Self(character)
    }

    /// Returns the character as it came.
    pub const fn character(self) -> u8 {
        self.0
    }

    /// Returns true for `0`.
    pub const fn is_ok(self) -> bool {
        matches!(self, Self::OK)
    }

    /// Returns the meaning of this status in answer to `command`, as far as drivers
    /// of real sensors know it. The protocol text names none but `0`.
    pub const fn meaning(self, command: &Command) -> Option<&'static str> {
        match (self.0, command) {
            (b'0', _) => Some("success"),
            (b'2', Command::LaserOn | Command::LaserOff) => {
                Some("the laser is already in that state")
            }
            (b'3', Command::BaudRate(_)) => {
                Some("the sensor is already at that baud rate, or is on USB")
            }
            (b'6', Command::Distances(_)) => Some("the laser is off"),
            (b'E', _) => Some("the sensor does not know the command"),
            _ => None,
        }
    }

    /// Returns true for `0`, and for the statuses of `L` and `S` that mean that
    /// nothing had to be done: `2` on `L`, `3` on `S`.
    pub const fn is_ok_for(self, command: &Command) -> bool {
        match command {
            Command::LaserOn | Command::LaserOff => matches!(self.0, b'0' | b'2'),
            Command::BaudRate(_) => matches!(self.0, b'0' | b'3'),
            Command::Version | Command::Distances(_) => self.is_ok(),
        }
    }
}

impl From<Status> for char {
    fn from(status: Status) -> Self {
        status.0.into()
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "'{}'", Text::from(&[self.0][..]))
    }
}

/// A whole and well-formed reply to a [`Command`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reply<'a> {
    status: Status,
    data: &'a [u8],
}

impl Reply<'static> {
    /// What is left of a scan whose values were taken: success, and no data.
    pub(crate) const SCAN: Self = Self { status: Status::OK, data: &[] };
}

impl<'a> Reply<'a> {
    /// Validates `frame`, a reply without its terminator, against `command`.
    ///
    /// # Errors
    ///
    /// [`ReplyError`] unless the frame is exactly what a sensor that speaks
    /// SCIP 1.1 answers to this very command: the same bytes back, a status of
    /// one character, and data of the right shape after success, none after
    /// anything else.
    pub fn parse(command: &Command, frame: &'a [u8]) -> Result<Self, ReplyError> {
        let (echo, rest) = split_line(frame);
        if echo != &*command.bytes() {
            return Err(match rest.map(split_line) {
                // `MD` and `MS` stream by themselves in SCIP 2.
                Some((status, _)) if echo.first() == Some(&b'M') && is_scip2(status) => {
                    ReplyError::Scip2 { status: status.into() }
                }
                _ => ReplyError::Foreign { found: Text::excerpt(echo, EXCERPT) },
            });
        }
        let Some(rest) = rest else { return Err(Malformed::NoStatus.into()) };
        let (line, data) = split_line(rest);
        if is_scip2(line) {
            return Err(ReplyError::Scip2 { status: line.into() });
        }
        // No sensor uses a byte outside of printable ASCII as a status: it is damage.
        let &[status @ b'!'..=b'~'] = line else {
            return Err(Malformed::Status { found: Text::excerpt(line, EXCERPT) }.into());
        };
        let status = Status(status);
        match (data, status.is_ok(), command) {
            (Some(data), true, Command::Distances(window)) => {
                let mut values = [0; Window::FULL.points()];
                let points = window.points();
                if !values.get_mut(..points).is_some_and(|values| decode(data, values)) {
                    find_fault(data, points * 2)?;
                }
                Ok(Self { status, data })
            }
            (None | Some([]), true, Command::Version) | (None, true, Command::Distances(_)) => {
                Err(Malformed::NoData.into())
            }
            (Some(data), true, Command::Version) => Ok(Self { status, data }),
            (None, ..) => Ok(Self { status, data: &[] }),
            (Some(data), ..) => Err(Malformed::UnexpectedData { status, bytes: data.len() }.into()),
        }
    }

    /// Returns the reply to `command` at the end of `frame`, whatever is in front of
    /// it: a reply that was cut short has no terminator, so the next reply follows it
    /// in the same frame.
    ///
    /// Meant for a command of which no older reply can be on its way, and whose
    /// reply has a known length: any but `V`.
    ///
    /// # Errors
    ///
    /// Those of [`Reply::parse`] for the whole frame, if it does not end so.
    pub fn parse_end(command: &Command, frame: &'a [u8]) -> Result<Self, ReplyError> {
        // With data and without; both reply lengths count the two LFs.
        let lengths = [command.reply_len() - 2, command.bytes().len() + 2];
        lengths
            .into_iter()
            .filter_map(|length| frame.len().checked_sub(length))
            .filter_map(|start| frame.get(start..))
            .find_map(|tail| Self::parse(command, tail).ok())
            .map_or_else(|| Self::parse(command, frame), Ok)
    }

    /// Returns the status.
    pub const fn status(&self) -> Status {
        self.status
    }

    /// Iterates over the lines after the status, empty ones left out.
    pub fn lines(&self) -> impl Iterator<Item = &'a [u8]> {
        self.data.split(|&byte| byte == b'\n').filter(|line| !line.is_empty())
    }

    /// Appends the values of a `G` reply, 0..=4095 each, in the order of their
    /// steps.
    pub fn values_into(&self, values: &mut Vec<u16>) {
        let (before, lines) = (values.len(), self.data.len() / (BLOCK + 1));
        values.resize(before + (self.data.len() - lines) / 2, 0);
        decode(self.data, values.get_mut(before..).unwrap_or_default());
    }
}

/// Replaces `values` by those of `frame` if it is the reply of success to the `G`
/// for `window`, and returns whether it is: all that
/// [`Reply::parse`] and [`Reply::values_into`] do then, in one pass.
pub(crate) fn decode_scan(window: Window, frame: &[u8], values: &mut Vec<u16>) -> bool {
    // Does nothing where there were as many before.
    values.resize(window.points(), 0);
    let command = Command::Distances(window).bytes();
    let Some((echo, [b'\n', b'0', b'\n', data @ ..])) = frame.split_at_checked(command.len())
    else {
        return false;
    };
    echo.iter().eq(command.iter()) && decode(data, values)
}

/// Decodes the data of a `G` reply into `values`, and returns whether it has the
/// shape for so many: true if [`find_fault`] finds none, many times as fast.
fn decode(data: &[u8], values: &mut [u16]) -> bool {
    let (lines, last) = data.as_chunks::<{ BLOCK + 1 }>();
    let right_length = data.len() == 2 * values.len() + lines.len() && !last.is_empty();
    let Some((whole, rest)) = values.split_at_mut_checked(lines.len() * BLOCK / 2) else {
        return false;
    };
    let (mut decoder, mut ends) = (measurement::Decoder::default(), 0);
    for ([line @ .., end], values) in lines.iter().zip(whole.as_chunks_mut().0) {
        decoder.line(line, values);
        ends |= end ^ b'\n';
    }
    decoder.last_line(last, rest);
    right_length && ends == 0 && decoder.saw_only_characters()
}

/// Fails with the first place where the data does not have the shape of `expected`
/// characters.
fn find_fault(data: &[u8], expected: usize) -> Result<(), Malformed> {
    let mut left = expected;
    for (index, line) in data.split(|&byte| byte == b'\n').enumerate() {
        let expected = left.min(BLOCK);
        if line.len() != expected || expected == 0 {
            return Err(Malformed::LineLength { line: index, expected, found: line.len() });
        }
        let stray = line.iter().enumerate().find(|(_, byte)| !measurement::is_character(**byte));
        if let Some((column, &found)) = stray {
            return Err(Malformed::Character { line: index, column, found });
        }
        left -= expected;
    }
    if left == 0 { Ok(()) } else { Err(Malformed::Short { expected, found: expected - left }) }
}

/// Splits off the first line; the rest is `None` without an LF.
fn split_line(bytes: &[u8]) -> (&[u8], Option<&[u8]>) {
    let mut parts = bytes.splitn(2, |&byte| byte == b'\n');
    (parts.next().unwrap_or_default(), parts.next())
}

/// Returns true for a status of SCIP 2: two characters and their checksum, which is the
/// low six bits of their sum, plus 0x30 (`99b`), or on some sensors the sum
/// itself (`0Eu`).
///
/// Without the checksum a reply to a one-step `G` that lost the LF after its
/// status (`0CD`) would pass for one.
fn is_scip2(status: &[u8]) -> bool {
    let &[a, b, sum] = status else { return false };
    let total = a.wrapping_add(b);
    a.is_ascii_alphanumeric()
        && b.is_ascii_alphanumeric()
        && (sum == (total & 0x3f) + 0x30 || sum == total)
}

/// The reason why a frame is not the reply to a command.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ReplyError {
    /// It does not begin with the command: it answers another one, or its echo is
    /// damaged.
    #[error("expected the echo of the command, found \"{found}\"")]
    Foreign {
        /// Its first line.
        found: Text,
    },
    /// It begins with the command, and the rest is malformed.
    #[error(transparent)]
    Malformed(#[from] Malformed),
    /// It has a status of three characters, as in SCIP 2.
    #[error("expected a status of SCIP 1.1, found \"{status}\" of SCIP 2")]
    Scip2 {
        /// The status line.
        status: Text,
    },
}

/// A fault in the shape of a reply: the place, what was expected there, and what was
/// found.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Malformed {
    /// The reply ends after its echo.
    #[error("expected a status after the echo, found the end of the reply")]
    NoStatus,
    /// The status line is not exactly one printable character.
    #[error("expected a status of one character, found \"{found}\"")]
    Status {
        /// The line.
        found: Text,
    },
    /// The status is success, and no data follows.
    #[error("expected data after a status of success, found the end of the reply")]
    NoData,
    /// Data follows a status that has none.
    #[error("expected no data after the status {status}, found {bytes} bytes")]
    UnexpectedData {
        /// The status.
        status: Status,
        /// The number of bytes.
        bytes: usize,
    },
    /// A line of data is too short or too long.
    #[error("expected {expected} characters in line {line} of the data, found {found}")]
    LineLength {
        /// The number of the line in the data, from 0.
        line: usize,
        /// The number of characters that it must have.
        expected: usize,
        /// The number of characters that it has.
        found: usize,
    },
    /// The data ends early, after a full line.
    #[error("expected {expected} characters of data, found {found}")]
    Short {
        /// The number of characters that it must have.
        expected: usize,
        /// The number of characters that it has.
        found: usize,
    },
    /// A character that carries no 6-bit number.
    #[error("expected 0x30 to 0x6f as character {column} of data line {line}, found 0x{found:02x}")]
    Character {
        /// The number of the line in the data, from 0.
        line: usize,
        /// The place of the character in the line, from 0.
        column: usize,
        /// The byte.
        found: u8,
    },
    /// The reply does not end.
    #[error("expected two LFs at the end of the reply, found none in {bytes} bytes")]
    Overlong {
        /// The number of bytes that came.
        bytes: usize,
    },
    /// The link is not transparent: it translates line ends, or is a telnet session.
    #[error(
        "expected raw bytes, found CR LF line ends or telnet commands: set the terminal or the serial server to raw mode"
    )]
    NotRaw,
}
