//! [`Command`]: a command line after parsing.

use tokio_scip::BaudRate;

use crate::body::Steps;
use crate::format::{baud_rate, number};

/// Command line after parsing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Command {
    Version,
    Laser(bool),
    BaudRate(BaudRate),
    Scan(Steps),
    /// `SCIP2.0`, which asks a sensor to switch to SCIP 2.
    Scip2,
    /// Not a command of SCIP 1.1.
    Undefined,
    /// Command of SCIP 1.1 with a mistake, and the status to answer with.
    Invalid(u8),
}

/// Wrong number of bytes for the command.
const LENGTH: Command = Command::Invalid(b'1');
/// A control code, baud rate, step or cluster count that does not exist.
const PARAMETER: Command = Command::Invalid(b'4');
/// A starting point greater than the end point.
const ORDER: Command = Command::Invalid(b'5');

impl Command {
    /// Parses a command line without its terminator (p. 4 to 6), which may have been cut.
    pub(crate) fn parse(line: &[u8], too_long: bool) -> Self {
        match Self::parse_whole(line) {
            Self::Undefined => Self::Undefined,
            _ if too_long => LENGTH,
            command => command,
        }
    }

    fn parse_whole(line: &[u8]) -> Self {
        match line {
            b"V" => Self::Version,
            b"SCIP2.0" => Self::Scip2,
            b"L0" => Self::Laser(false),
            b"L1" => Self::Laser(true),
            [b'L', _] => PARAMETER,
            // The seven bytes of the reserved area have no effect (p. 5).
            [b'S', digits @ .., _, _, _, _, _, _, _] if digits.len() == 6 => {
                baud_rate(digits).map_or(PARAMETER, Self::BaudRate)
            }
            [b'G', digits @ ..] if digits.len() == 8 => scan(digits).unwrap_or(PARAMETER),
            [b'V' | b'L' | b'S' | b'G', ..] => LENGTH,
            _ => Self::Undefined,
        }
    }
}

fn scan(digits: &[u8]) -> Option<Command> {
    let point = |place| number(digits.get(place)?).filter(|point| *point <= 768);
    let (start, end) = (point(0..3)?, point(3..6)?);
    // The text allows 00 without defining it; drivers treat it as 01.
    let cluster = number(digits.get(6..8)?)?.max(1);
    Some(if start > end { ORDER } else { Command::Scan(Steps { start, end, cluster }) })
}
