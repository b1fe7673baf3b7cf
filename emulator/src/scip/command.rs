//! Command lines: cut out of the bytes that arrive, and parsed.

use tokio::time::Instant;

use tokio_scip::BaudRate;

/// Number of bytes to keep of a line. The longest command, `S`, has 14. A host that never
/// ends its line must not cost more memory.
const MAX_LINE_BYTES: usize = 64;

/// Command line after parsing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum HostCommand {
    Version,
    Laser(bool),
    BaudRate(BaudRate),
    Scan {
        start: u16,
        end: u16,
        cluster: u16,
    },
    /// `SCIP2.0`, which asks a sensor to switch to SCIP 2.
    Scip2,
    /// Terminator without a command.
    Empty,
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

impl HostCommand {
    /// Parses a command line without its terminator (p. 4 to 6).
    pub(super) fn parse(line: &[u8]) -> Self {
        match line {
            [] => Self::Empty,
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

fn baud_rate(digits: &[u8]) -> HostCommand {
    match digits {
        b"019200" => HostCommand::BaudRate(BaudRate::B19200),
        b"057600" => HostCommand::BaudRate(BaudRate::B57600),
        b"115200" => HostCommand::BaudRate(BaudRate::B115200),
        b"250000" => HostCommand::BaudRate(BaudRate::B250000),
        b"500000" => HostCommand::BaudRate(BaudRate::B500000),
        b"750000" => HostCommand::BaudRate(BaudRate::B750000),
        _ => HostCommand::Invalid(Mistake::Parameter),
    }
}

fn scan(start: Option<u16>, end: Option<u16>, cluster: Option<u16>) -> HostCommand {
    match (start, end, cluster) {
        (Some(start @ 0..=768), Some(end @ 0..=768), Some(_)) if start > end => {
            HostCommand::Invalid(Mistake::Order)
        }
        // The text allows 00 without defining it; drivers treat it as 01.
        (Some(start @ 0..=768), Some(end @ 0..=768), Some(cluster)) => {
            HostCommand::Scan { start, end, cluster: cluster.max(1) }
        }
        _ => HostCommand::Invalid(Mistake::Parameter),
    }
}

fn number(digits: &[u8]) -> Option<u16> {
    digits.iter().try_fold(0, |number, digit| {
        digit.is_ascii_digit().then(|| number * 10 + u16::from(digit - b'0'))
    })
}

/// Command line whose terminator has arrived.
#[derive(Debug)]
pub(crate) struct ArrivedCommand {
    /// When the terminator had arrived.
    pub(crate) at: Instant,
    /// Line without its terminator, cut to `MAX_LINE_BYTES`.
    pub(crate) bytes: Vec<u8>,
    pub(crate) command: HostCommand,
    /// True if the two ends of the line had different baud rates.
    pub(crate) garbled: bool,
    /// True if its first byte arrived while an earlier command was unanswered.
    pub(crate) overlapping: bool,
}

/// Line buffer of the sensor.
#[derive(Debug, Default)]
pub(crate) struct LineBuffer {
    bytes: Vec<u8>,
    too_long: bool,
    garbled: bool,
    overlapping: bool,
}

impl LineBuffer {
    /// Returns true if no byte of the next line has arrived.
    pub(crate) fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Records that the line began while an earlier command was unanswered.
    pub(crate) fn mark_overlapping(&mut self) {
        self.overlapping = true;
    }

    /// Adds one byte. Returns the line if the byte was its terminator.
    pub(crate) fn push(&mut self, byte: u8, at: Instant, garbled: bool) -> Option<ArrivedCommand> {
        self.garbled |= garbled;
        if byte != b'\n' && byte != b'\r' {
            if self.bytes.len() < MAX_LINE_BYTES {
                self.bytes.push(byte);
            } else {
                self.too_long = true;
            }
            return None;
        }
        let Self { bytes, too_long, garbled, overlapping } = std::mem::take(self);
        let command = match HostCommand::parse(&bytes) {
            HostCommand::Undefined => HostCommand::Undefined,
            _ if too_long => HostCommand::Invalid(Mistake::Length),
            command => command,
        };
        Some(ArrivedCommand { at, bytes, command, garbled, overlapping })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_line_without_a_terminator_keeps_64_bytes() {
        let now = Instant::now();
        let mut line = LineBuffer::default();
        for _ in 0..1_000_000 {
            assert!(line.push(b'V', now, false).is_none());
        }
        assert!(line.bytes.capacity() <= 2 * MAX_LINE_BYTES);
        let arrived = line.push(b'\r', now, false).unwrap();
        assert_eq!(arrived.bytes, [b'V'; MAX_LINE_BYTES]);
        assert_eq!(arrived.command, HostCommand::Invalid(Mistake::Length));
        assert!(line.is_empty());
    }
}
