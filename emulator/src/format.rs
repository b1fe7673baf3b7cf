//! What both protocols write alike: the form of a [`Reply`], its 6-bit characters, and the digits of
//! a command.

use tokio_scip::BaudRate;

/// Length of a line of data, except for the last one (C-42-3320-A p. 3, C-42-03320B p. 13).
pub(crate) const BLOCK_BYTES: usize = 64;

/// Reply being written: echo, status, lines, and a line feed more than the last line's.
#[derive(Debug)]
pub(crate) struct Reply(Vec<u8>);

impl Reply {
    pub(crate) fn new(echo: &[u8], status: &[u8]) -> Self {
        let mut reply = Self(Vec::with_capacity(256));
        reply.line(echo);
        reply.line(status);
        reply
    }

    pub(crate) fn line(&mut self, line: &[u8]) {
        self.0.extend_from_slice(line);
        self.0.push(b'\n');
    }

    pub(crate) fn end(mut self) -> Vec<u8> {
        self.0.push(b'\n');
        self.0
    }
}

/// Encodes the low six bits as a character from `0` to `o`.
pub(crate) fn sextet(bits: u32) -> u8 {
    (bits & 0x3F) as u8 + 0x30
}

/// Parses a number of decimal digits.
pub(crate) fn number(digits: &[u8]) -> Option<u16> {
    digits.iter().try_fold(0, |number, digit| {
        digit.is_ascii_digit().then(|| number * 10 + u16::from(digit - b'0'))
    })
}

/// Baud rate of a command's six digits.
pub(crate) fn baud_rate(digits: &[u8]) -> Option<BaudRate> {
    match digits {
        b"019200" => Some(BaudRate::B19200),
        b"057600" => Some(BaudRate::B57600),
        b"115200" => Some(BaudRate::B115200),
        b"250000" => Some(BaudRate::B250000),
        b"500000" => Some(BaudRate::B500000),
        b"750000" => Some(BaudRate::B750000),
        _ => None,
    }
}
