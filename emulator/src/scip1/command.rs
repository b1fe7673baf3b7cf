//! [`Command`]: a command line after parsing.

use tokio_scip::BaudRate;

use crate::body::Steps;

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
    /// Command of SCIP 1.1 with a mistake.
    Invalid(Mistake),
}

/// Mistake in an invalid command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Mistake {
    /// Wrong number of bytes for the command.
    Length,
    /// A control code, baud rate, step or cluster count that does not exist.
    Parameter,
    /// A starting point greater than the end point.
    Order,
}

impl Command {
    /// Parses a command line without its terminator (p. 4 to 6), which may have been cut.
    pub(crate) fn parse(line: &[u8], too_long: bool) -> Self {
        match Self::parse_whole(line) {
            Self::Undefined => Self::Undefined,
            _ if too_long => Self::Invalid(Mistake::Length),
            command => command,
        }
    }

    fn parse_whole(line: &[u8]) -> Self {
        match line {
            b"V" => Self::Version,
            b"SCIP2.0" => Self::Scip2,
            b"L0" => Self::Laser(false),
            b"L1" => Self::Laser(true),
            [b'L', _] => Self::Invalid(Mistake::Parameter),
            // The seven bytes of the reserved area have no effect (p. 5).
            [b'S', digits @ .., _, _, _, _, _, _, _] if digits.len() == 6 => baud_rate(digits),
            [b'G', s0, s1, s2, e0, e1, e2, c0, c1] => {
                scan(number(&[*s0, *s1, *s2]), number(&[*e0, *e1, *e2]), number(&[*c0, *c1]))
            }
            [b'V' | b'L' | b'S' | b'G', ..] => Self::Invalid(Mistake::Length),
            _ => Self::Undefined,
        }
    }
}

fn baud_rate(digits: &[u8]) -> Command {
    match digits {
        b"019200" => Command::BaudRate(BaudRate::B19200),
        b"057600" => Command::BaudRate(BaudRate::B57600),
        b"115200" => Command::BaudRate(BaudRate::B115200),
        b"250000" => Command::BaudRate(BaudRate::B250000),
        b"500000" => Command::BaudRate(BaudRate::B500000),
        b"750000" => Command::BaudRate(BaudRate::B750000),
        _ => Command::Invalid(Mistake::Parameter),
    }
}

fn scan(start: Option<u16>, end: Option<u16>, cluster: Option<u16>) -> Command {
    match (start, end, cluster) {
        (Some(start @ 0..=768), Some(end @ 0..=768), Some(_)) if start > end => {
            Command::Invalid(Mistake::Order)
        }
        // The text allows 00 without defining it; drivers treat it as 01.
        (Some(start @ 0..=768), Some(end @ 0..=768), Some(cluster)) => {
            Command::Scan(Steps { start, end, cluster: cluster.max(1) })
        }
        _ => Command::Invalid(Mistake::Parameter),
    }
}

fn number(digits: &[u8]) -> Option<u16> {
    digits.iter().try_fold(0, |number, digit| {
        digit.is_ascii_digit().then(|| number * 10 + u16::from(digit - b'0'))
    })
}
