//! Validates a frame against its command: the whole echo, the status, and for `G` every
//! line, every character and the number of points.
//!
//! SCIP 1.1 has no checksum, so every other sign of damage is checked. A frame that
//! passes has exactly the shape that its command asked for.

use std::sync::Arc;
use std::time::Duration;

use super::measurement::{self, BLOCK};
use super::{Command, Status, Text, Window};

/// Number of bytes of a frame to show in an error message.
const EXCERPT: usize = 32;

/// Complete, well-formed reply to a [`Command`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reply<'a> {
    status: Status,
    data: &'a [u8],
    /// Number of values in the data of a successful `G`, otherwise 0.
    points: usize,
}

impl<'a> Reply<'a> {
    /// Validates `frame`, a reply without its terminator, against `command`.
    ///
    /// # Errors
    ///
    /// Returns a [`ReplyError`] unless the frame is exactly what a SCIP 1.1 sensor
    /// answers to this command: the same bytes back, a status of one character, data of
    /// the right shape after success, and no data after any other status.
    pub fn parse(command: &Command, frame: &'a [u8]) -> Result<Self, ReplyError> {
        // On the stack: the check decodes all values, and the caller does not need them.
        let mut values = [0; Window::FULL.points()];
        let values = values.get_mut(..points(command)).unwrap_or_default();
        Self::parse_slice(command, frame, values)
    }

    /// Parses like [`parse`](Self::parse), and replaces `values` by the values of the
    /// reply, 0..=4095 each, in the order of their steps. Use it to decode and check in
    /// one pass. Leaves `values` empty unless the reply is a successful `G`.
    ///
    /// # Errors
    ///
    /// The same as [`parse`](Self::parse).
    ///
    /// ```
    /// use tokio_scip::protocol::{Command, Reply, Window};
    ///
    /// let command = Command::Distances(Window::new(384..=385)?);
    /// let mut values = Vec::new();
    /// Reply::parse_into(&command, b"G38438501\n0\nCB06", &mut values)?;
    /// assert_eq!(values, [1234, 6]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[doc(hidden)] // For the driver and benches.
    pub fn parse_into(
        command: &Command,
        frame: &'a [u8],
        values: &mut Vec<u16>,
    ) -> Result<Self, ReplyError> {
        // Does nothing if the previous reply had the same number.
        values.resize(points(command), 0);
        let outcome = Self::parse_slice(command, frame, values);
        match &outcome {
            Ok(reply) if reply.status.is_ok() => {}
            _ => values.clear(),
        }
        outcome
    }

    /// Parses like [`parse`](Self::parse), and writes the values of a successful `G` to
    /// the front of `values`. Reuses their block if it is not shared and has room;
    /// otherwise allocates one that is not shorter. So a scan shares the block that its
    /// reply was decoded into. After any other reply, and after an error, the content of
    /// `values` is unspecified.
    ///
    /// # Errors
    ///
    /// The same as [`parse`](Self::parse).
    ///
    /// ```
    /// use std::sync::Arc;
    /// use tokio_scip::protocol::{Command, Reply, Window};
    ///
    /// let command = Command::Distances(Window::new(384..=385)?);
    /// let mut values = Arc::default();
    /// Reply::parse_into_shared(&command, b"G38438501\n0\nCB06", &mut values)?;
    /// assert_eq!(*values, [1234, 6]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[doc(hidden)] // For the driver and benches.
    pub fn parse_into_shared(
        command: &Command,
        frame: &'a [u8],
        values: &mut Arc<[u16]>,
    ) -> Result<Self, ReplyError> {
        let points = points(command);
        if let Some(block) = Arc::get_mut(values).and_then(|block| block.get_mut(..points)) {
            return Self::parse_slice(command, frame, block);
        }
        *values = std::iter::repeat_n(0, values.len().max(points)).collect();
        let block = Arc::get_mut(values).and_then(|block| block.get_mut(..points));
        Self::parse_slice(command, frame, block.unwrap_or_default())
    }

    /// Parses, and replaces `values`, one for each [point](points) of the command.
    fn parse_slice(
        command: &Command,
        frame: &'a [u8],
        values: &mut [u16],
    ) -> Result<Self, ReplyError> {
        let rest = match command.strip_echo(frame) {
            Some([b'\n', rest @ ..]) => rest,
            Some([]) => return Err(Malformed::NoStatus.into()),
            _ => return Err(foreign(frame)),
        };
        // No sensor has a status outside printable ASCII, so such a byte is damage.
        let (status, data) = match rest {
            [status @ b'!'..=b'~', b'\n', data @ ..] => (Status::new(*status), Some(data)),
            [status @ b'!'..=b'~'] => (Status::new(*status), None),
            _ => return Err(no_status(rest)),
        };
        match (data, status.is_ok(), command) {
            (Some(data), true, Command::Distances(window)) => {
                if !decode(data, values) {
                    find_fault(data, window.points() * 2)?;
                }
                Ok(Self { status, data, points: window.points() })
            }
            (None | Some([]), true, Command::Version) | (None, true, Command::Distances(_)) => {
                Err(Malformed::NoData.into())
            }
            (Some(data), true, Command::Version) => Ok(Self { status, data, points: 0 }),
            (None, ..) => Ok(Self { status, data: &[], points: 0 }),
            (Some(data), ..) => Err(Malformed::UnexpectedData { status, bytes: data.len() }.into()),
        }
    }

    /// Finds the reply to `command` at the end of `frame`, whatever precedes it. A reply
    /// that was cut short has no terminator, so the next reply follows it in the same
    /// frame.
    ///
    /// Use it only if no older reply to `command` can be on its way, and for any command
    /// but `V`, whose reply has no fixed length.
    ///
    /// # Errors
    ///
    /// The errors of [`Reply::parse`] for the whole frame, if it does not end with the
    /// reply.
    #[doc(hidden)] // For the driver and tests.
    pub fn parse_end(command: &Command, frame: &'a [u8]) -> Result<Self, ReplyError> {
        // With data and without. Both lengths include the two LFs.
        let lengths = [command.reply_len() - 2, command.bytes().len() + 2];
        lengths
            .into_iter()
            .filter_map(|length| frame.len().checked_sub(length))
            .filter_map(|start| frame.get(start..))
            .find_map(|tail| Self::parse(command, tail).ok())
            .map_or_else(|| Self::parse(command, frame), Ok)
    }

    /// Status of the reply.
    pub const fn status(&self) -> Status {
        self.status
    }

    /// Frame of a reply to `command`, as it was parsed.
    pub(crate) fn frame(&self, command: &Command) -> Vec<u8> {
        let status = [b'\n', self.status.character(), b'\n'];
        [&*command.bytes(), &status, self.data].concat()
    }

    /// Iterates over the lines after the status, except empty ones.
    pub fn lines(&self) -> impl Iterator<Item = &'a [u8]> {
        self.data.split(|&byte| byte == b'\n').filter(|line| !line.is_empty())
    }

    /// Appends the values of a successful `G`, 0..=4095 each, in the order of their
    /// steps. Appends nothing for any other reply.
    #[doc(hidden)] // For the driver and tests.
    pub fn values_into(&self, values: &mut Vec<u16>) {
        let before = values.len();
        values.resize(before + self.points, 0);
        let fresh = values.get_mut(before..).unwrap_or_default();
        if !fresh.is_empty() {
            decode(self.data, fresh);
        }
    }
}

/// Decodes the data of a `G` reply into `values`. Returns true if the data has the right
/// shape for `values.len()` values: if [`find_fault`] finds no fault, but many times as
/// fast.
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

/// Fails at the first place where the data differs from the shape of `expected`
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

/// Number of values in a successful reply to `command`.
fn points(command: &Command) -> usize {
    match command {
        Command::Distances(window) => window.points(),
        _ => 0,
    }
}

/// Error for a reply whose status line, at the front of `rest`, is not one printable
/// character.
fn no_status(rest: &[u8]) -> ReplyError {
    let (line, _) = split_line(rest);
    if is_scip2(line) {
        return ReplyError::Scip2 { status: line.into() };
    }
    Malformed::Status { found: Text::excerpt(line, EXCERPT) }.into()
}

/// Error for a frame that does not begin with its command.
fn foreign(frame: &[u8]) -> ReplyError {
    let (echo, rest) = split_line(frame);
    match rest.map(split_line) {
        // In SCIP 2, `MD` and `MS` stream automatically.
        Some((status, _)) if echo.first() == Some(&b'M') && is_scip2(status) => {
            ReplyError::Scip2 { status: status.into() }
        }
        _ => ReplyError::Foreign { found: Text::excerpt(echo, EXCERPT) },
    }
}

/// Splits off the first line. The rest is `None` without an LF.
fn split_line(bytes: &[u8]) -> (&[u8], Option<&[u8]>) {
    let length = bytes.iter().position(|&byte| byte == b'\n').unwrap_or(bytes.len());
    let (line, rest) = bytes.split_at_checked(length).unwrap_or((bytes, b""));
    (line, rest.get(1..))
}

/// Recognises a status of SCIP 2: two characters and their checksum. The checksum is the
/// low six bits of their sum, plus 0x30 (`99b`), or on some sensors the sum itself
/// (`0Eu`).
///
/// Without the checksum, a reply to a one-step `G` that lost the LF after its status
/// (`0CD`) would pass for one.
fn is_scip2(status: &[u8]) -> bool {
    let &[a, b, sum] = status else { return false };
    let total = a.wrapping_add(b);
    a.is_ascii_alphanumeric()
        && b.is_ascii_alphanumeric()
        && (sum == (total & 0x3f) + 0x30 || sum == total)
}

/// Why a frame is not the reply to a command.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ReplyError {
    /// It does not begin with the command: it answers another command, or its echo is
    /// damaged.
    #[error("expected the echo of the command, found \"{found}\"")]
    Foreign {
        /// First line of the frame.
        found: Text,
    },
    /// It begins with the command, but the rest is malformed.
    #[error(transparent)]
    Malformed(#[from] Malformed),
    /// It has a status of three characters, as in SCIP 2.
    #[error("expected a status of SCIP 1.1, found \"{status}\" of SCIP 2")]
    Scip2 {
        /// Status line.
        status: Text,
    },
}

/// Fault in the shape of a reply: where it is, what was expected there, and what was
/// found.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Malformed {
    /// It does not begin with the command: the echo was damaged, bytes came before it, or
    /// it is the reply to another command.
    #[error("expected the echo of the command, found \"{found}\"")]
    Echo {
        /// Bytes at the beginning.
        found: Text,
    },
    /// It began before the command can have left the wire, so it is the reply to an older
    /// command.
    #[error("the reply began {} us after the command, which alone takes {} us on the wire", after.as_micros(), least.as_micros())]
    Early {
        /// Time from the command to the first byte of the reply.
        after: Duration,
        /// Time that the command and one byte take at the port's baud rate.
        least: Duration,
    },
    /// It ends after its echo.
    #[error("expected a status after the echo, found the end of the reply")]
    NoStatus,
    /// Its status line is not exactly one printable character.
    #[error("expected a status of one character, found \"{found}\"")]
    Status {
        /// Status line.
        found: Text,
    },
    /// Its status is success, but no data follows.
    #[error("expected data after a status of success, found the end of the reply")]
    NoData,
    /// Data follows a status that allows no data.
    #[error("expected no data after the status {status}, found {bytes} bytes")]
    UnexpectedData {
        /// Status of the reply.
        status: Status,
        /// Number of data bytes.
        bytes: usize,
    },
    /// Its data has a line that is too short or too long.
    #[error("expected {expected} characters in line {line} of the data, found {found}")]
    LineLength {
        /// Number of the line in the data, from 0.
        line: usize,
        /// Expected number of characters.
        expected: usize,
        /// Number of characters found.
        found: usize,
    },
    /// Its data ends early, after a full line.
    #[error("expected {expected} characters of data, found {found}")]
    Short {
        /// Expected number of characters.
        expected: usize,
        /// Number of characters found.
        found: usize,
    },
    /// A data character carries no 6-bit number.
    #[error("expected 0x30 to 0x6f as character {column} of data line {line}, found 0x{found:02x}")]
    Character {
        /// Number of the line in the data, from 0.
        line: usize,
        /// Position of the character in the line, from 0.
        column: usize,
        /// Byte that was found.
        found: u8,
    },
    /// It does not end.
    #[error("expected two LFs at the end of the reply, found none in {bytes} bytes")]
    Overlong {
        /// Number of bytes received.
        bytes: usize,
    },
    /// Something on the link changes bytes: it translates line ends, or is a telnet
    /// session.
    #[error(
        "expected raw bytes, found CR LF line ends or telnet commands: set the terminal or the serial server to raw mode"
    )]
    NotRaw,
}
