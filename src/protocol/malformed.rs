//! [`ReplyError`]: why a frame is not the reply to its command.

use std::time::Duration;

use super::{Status, Text};

/// Why a frame is not the reply to a command.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ReplyError {
    /// It does not begin with the command: it answers another command, or its echo is damaged.
    #[error("expected the echo of the command, found \"{found}\"")]
    Foreign {
        /// First line of the frame.
        found: Text,
    },
    /// It begins with the command, but the rest is malformed.
    #[error(transparent)]
    Malformed(#[from] MalformedError),
    /// It has a status of one character, as in SCIP 1.1.
    #[error(
        "expected SCIP 2, found the status \"{status}\" of SCIP 1.1: send SCIP2.0 to a URG-04LX"
    )]
    Scip1 {
        /// Status line.
        status: Text,
    },
    /// It has a status of three characters, as in SCIP 2.
    #[error("expected a status of SCIP 1.1, found \"{status}\" of SCIP 2")]
    Scip2 {
        /// Status line.
        status: Text,
    },
    /// It answers a command of SCIP 2 for several echoes a step, which another program sent.
    #[error("expected one echo a step, found \"{found}\", which asks for several: stop it with QT")]
    MultiEcho {
        /// First line of the frame.
        found: Text,
    },
    /// It begins with STX, as the frames of UAM safety scanners do.
    #[error("expected SCIP 2, found a frame of the UAM safety scanners' own protocol: send MD")]
    Uam,
}

/// Fault in the shape of a reply: where it is, what was expected there, and what was found.
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
    /// It began before the command can have left the wire, so it is the reply to an older command.
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
    /// Its status line is not one printable character, or in SCIP 2 not two and their sum.
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
    /// Something on the link changes bytes: it translates line ends, or is a telnet session.
    #[error(
        "expected raw bytes, found CR LF line ends or telnet commands: set the terminal or the serial server to raw mode"
    )]
    NotRaw,
    /// A reply of SCIP 2 has another fault.
    #[error("expected {expected} in {}, found {found}", place(line))]
    Scip2 {
        /// Number of the line after the status, from 0. `None` if the status is wrong, or a line missing.
        line: Option<usize>,
        /// What was expected there.
        expected: String,
        /// What was found.
        found: String,
    },
}

impl MalformedError {
    pub(super) fn in_scip2(
        line: impl Into<Option<usize>>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self::Scip2 { line: line.into(), expected: expected.into(), found: found.into() }
    }
}

fn place(line: &Option<usize>) -> String {
    line.map_or_else(|| "the reply".into(), |line| format!("line {line}"))
}
