//! Command lines: taking them out of the bytes that arrive, and what they ask.
//!
//! Written from the protocol text alone, like `encode`.

use tokio::time::Instant;

use crate::BaudRate;

/// The longest command is `S` with 14 bytes; what goes on beyond this many is
/// no command, and is not kept.
const LONGEST: usize = 64;

/// What a command line asks for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Request {
    Version,
    Laser(bool),
    Speed(BaudRate),
    Scan {
        start: u16,
        end: u16,
        cluster: u16,
    },
    /// `SCIP2.0`, which is no command of SCIP 1.1.
    Scip2,
    /// A terminator and nothing before it.
    Empty,
    /// Not a command of the protocol.
    Undefined,
    /// A command, and something is wrong with it.
    Refused(Refusal),
}

/// What is wrong with a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Refusal {
    /// The number of bytes.
    Length,
    /// A control code, baud rate, step or cluster count that does not exist.
    Parameter,
    /// The starting point is bigger than the end point.
    Order,
}

impl Request {
    /// Reads a command line, without its terminator (p. 4 to 6).
    pub(super) fn parse(line: &[u8]) -> Self {
        match line {
            [] => Self::Empty,
            b"V" => Self::Version,
            b"SCIP2.0" => Self::Scip2,
            b"L0" => Self::Laser(false),
            b"L1" => Self::Laser(true),
            [b'L', _] => Self::Refused(Refusal::Parameter),
            // The seven bytes of the reserved area mean nothing (p. 5).
            [b'S', digits @ .., _, _, _, _, _, _, _] if digits.len() == 6 => speed(digits),
            [b'G', s0, s1, s2, e0, e1, e2, c0, c1] => {
                scan(number(&[*s0, *s1, *s2]), number(&[*e0, *e1, *e2]), number(&[*c0, *c1]))
            }
            [b'V' | b'L' | b'S' | b'G', ..] => Self::Refused(Refusal::Length),
            _ => Self::Undefined,
        }
    }
}

fn speed(digits: &[u8]) -> Request {
    match digits {
        b"019200" => Request::Speed(BaudRate::B19200),
        b"057600" => Request::Speed(BaudRate::B57600),
        b"115200" => Request::Speed(BaudRate::B115200),
        b"250000" => Request::Speed(BaudRate::B250000),
        b"500000" => Request::Speed(BaudRate::B500000),
        b"750000" => Request::Speed(BaudRate::B750000),
        _ => Request::Refused(Refusal::Parameter),
    }
}

fn scan(start: Option<u16>, end: Option<u16>, cluster: Option<u16>) -> Request {
    match (start, end, cluster) {
        (Some(start @ 0..=768), Some(end @ 0..=768), Some(_)) if start > end => {
            Request::Refused(Refusal::Order)
        }
        // A cluster count of 00 works like 01.
        (Some(start @ 0..=768), Some(end @ 0..=768), Some(cluster)) => {
            Request::Scan { start, end, cluster: cluster.max(1) }
        }
        _ => Request::Refused(Refusal::Parameter),
    }
}

fn number(digits: &[u8]) -> Option<u16> {
    digits.iter().try_fold(0, |number, digit| {
        digit.is_ascii_digit().then(|| number * 10 + u16::from(digit - b'0'))
    })
}

/// A command line that has arrived whole.
#[derive(Debug)]
pub(super) struct Arrived {
    /// When its terminator was in.
    pub(super) at: Instant,
    pub(super) bytes: Vec<u8>,
    pub(super) request: Request,
    /// Whether the line's ends had different speeds.
    pub(super) garbled: bool,
    /// Whether it began to arrive while an earlier one was unanswered.
    pub(super) overlapping: bool,
}

/// The sensor's line buffer.
#[derive(Debug, Default)]
pub(super) struct LineBuffer {
    bytes: Vec<u8>,
    too_long: bool,
    garbled: bool,
    overlapping: bool,
}

impl LineBuffer {
    /// Whether nothing of a line is in yet.
    pub(super) fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Notes that the line began while an earlier one was unanswered.
    pub(super) fn overlaps(&mut self) {
        self.overlapping = true;
    }

    /// Takes in one byte, and gives the line if it was a terminator.
    pub(super) fn push(&mut self, byte: u8, at: Instant, garbled: bool) -> Option<Arrived> {
        self.garbled |= garbled;
        if byte != b'\n' && byte != b'\r' {
            if self.bytes.len() < LONGEST {
                self.bytes.push(byte);
            } else {
                self.too_long = true;
            }
            return None;
        }
        let Self { bytes, too_long, garbled, overlapping } = std::mem::take(self);
        let request = match Request::parse(&bytes) {
            Request::Undefined => Request::Undefined,
            _ if too_long => Request::Refused(Refusal::Length),
            request => request,
        };
        Some(Arrived { at, bytes, request, garbled, overlapping })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn the_texts_commands_are_read() {
        let cases: [(&[u8], Request); 8] = [
            (b"V", Request::Version),
            (b"L0", Request::Laser(false)),
            (b"L1", Request::Laser(true)),
            (b"S0576001234567", Request::Speed(BaudRate::B57600)),
            (b"S115200abcdefg", Request::Speed(BaudRate::B115200)),
            (b"G00076801", Request::Scan { start: 0, end: 768, cluster: 1 }),
            (b"G00000000", Request::Scan { start: 0, end: 0, cluster: 1 }),
            (b"G04472599", Request::Scan { start: 44, end: 725, cluster: 99 }),
        ];
        for (line, request) in cases {
            assert_eq!(Request::parse(line), request, "{}", line.escape_ascii());
        }
    }

    #[test]
    fn what_is_no_command_is_told_from_what_is_a_bad_one() {
        let cases: [(&[u8], Request); 9] = [
            (b"", Request::Empty),
            (b"X", Request::Undefined),
            (b"v", Request::Undefined),
            (b"VV", Request::Refused(Refusal::Length)),
            (b"L2", Request::Refused(Refusal::Parameter)),
            (b"S057600", Request::Refused(Refusal::Length)),
            (b"S0384000000000", Request::Refused(Refusal::Parameter)),
            (b"G00076901", Request::Refused(Refusal::Parameter)),
            (b"G76800001", Request::Refused(Refusal::Order)),
        ];
        for (line, request) in cases {
            assert_eq!(Request::parse(line), request, "{}", line.escape_ascii());
        }
    }

    #[test]
    fn a_line_without_an_end_keeps_64_bytes() {
        let now = Instant::now();
        let mut line = LineBuffer::default();
        for _ in 0..1_000_000 {
            assert!(line.push(b'V', now, false).is_none());
        }
        assert!(line.bytes.capacity() <= 2 * LONGEST);
        let arrived = line.push(b'\r', now, false).unwrap();
        assert_eq!(arrived.bytes, [b'V'; LONGEST]);
        assert_eq!(arrived.request, Request::Refused(Refusal::Length));
        assert!(line.is_empty());
    }
}
