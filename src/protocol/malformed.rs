//! [`ReplyError`]: why a frame is not the reply to its command.

use std::time::Duration;

use super::scip2::has_data;
use super::{Status, Text, fault};

/// Number of bytes of a frame to show in an error message.
const EXCERPT: usize = 32;

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
    Malformed(#[from] MalformedError),
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
pub enum MalformedError {
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
    /// Its status line is not exactly one printable character, or in SCIP 2 not two characters and
    /// their sum.
    #[error("expected a status, found \"{found}\"")]
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
    /// A reply of SCIP 2 has a fault.
    #[error(transparent)]
    Scip2(fault::MalformedError),
}

/// Error for a reply whose status line, at the front of `rest`, is not one printable
/// character.
pub(super) fn no_status(rest: &[u8]) -> ReplyError {
    let (line, _) = split_line(rest);
    if is_scip2(line) {
        return ReplyError::Scip2 { status: line.into() };
    }
    MalformedError::Status { found: Text::excerpt(line, EXCERPT) }.into()
}

/// Error for a frame that does not begin with its command.
pub(super) fn foreign(frame: &[u8]) -> ReplyError {
    let (echo, rest) = split_line(frame);
    match rest.map(split_line) {
        // In SCIP 2, `MD` and `MS` stream automatically.
        Some((status, _)) if echo.first() == Some(&b'M') && is_scip2(status) => {
            ReplyError::Scip2 { status: status.into() }
        }
        // The end of a scan, whose beginning was lost.
        _ if has_data(frame) => ReplyError::Scip2 { status: "99b".into() },
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
