//! [`Reply`]: the form that replies have in both protocols, and their 6-bit characters.

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
