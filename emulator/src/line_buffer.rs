//! [`LineBuffer`]: cuts the bytes that arrive at the sensor into command lines.

use tokio::time::Instant;

/// Number of bytes to keep of a line. The longest command, `%MD` with a text of the host, has 33.
/// A host that never ends its line must not cost more memory.
const MAX_LINE_BYTES: usize = 64;

/// Command line whose terminator has arrived.
#[derive(Debug)]
pub(crate) struct CommandLine {
    /// When the terminator had arrived.
    pub(crate) at: Instant,
    /// Line without its terminator, cut to `MAX_LINE_BYTES`.
    pub(crate) bytes: Vec<u8>,
    /// Its terminator.
    pub(crate) end: u8,
    /// True if it was cut.
    pub(crate) too_long: bool,
    /// True if the two ends of the line had different baud rates.
    pub(crate) garbled: bool,
    /// True if its first byte arrived while an earlier command was unanswered.
    pub(crate) overlapping: bool,
    /// True if it arrived while an earlier command of its kind was unanswered.
    pub(crate) repeated: bool,
}

impl CommandLine {
    /// Letters that tell which command it is, in SCIP 2.
    pub(crate) fn kind(&self) -> &[u8] {
        let letters = if self.bytes.starts_with(b"%") { 3 } else { 2 };
        self.bytes.get(..letters).unwrap_or(&self.bytes)
    }

    /// Returns true for the command of one scan, in either protocol.
    pub(crate) fn asks_for_scan(&self) -> bool {
        self.bytes.starts_with(b"G")
    }
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
    /// Adds one byte, which arrived at `at`, maybe garbled, or while an earlier command was
    /// unanswered. Returns the line if the byte was its terminator.
    pub(crate) fn push(
        &mut self,
        byte: u8,
        at: Instant,
        garbled: bool,
        overlapping: bool,
    ) -> Option<CommandLine> {
        self.garbled |= garbled;
        self.overlapping |= overlapping && self.bytes.is_empty();
        if byte != b'\n' && byte != b'\r' {
            if self.bytes.len() < MAX_LINE_BYTES {
                self.bytes.push(byte);
            } else {
                self.too_long = true;
            }
            return None;
        }
        let Self { bytes, too_long, garbled, overlapping } = std::mem::take(self);
        Some(CommandLine { at, bytes, end: byte, too_long, garbled, overlapping, repeated: false })
    }
}
