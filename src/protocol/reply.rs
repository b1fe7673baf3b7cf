//! Validates a frame against its command: the whole echo, the status, and for `G` every
//! line, every character and the number of points.
//!
//! SCIP 1.1 has no checksum, so every other sign of damage is checked. A frame that
//! passes has exactly the shape that its command asked for.

use std::sync::Arc;

use super::malformed::{foreign, no_status};
use super::window::BLOCK;
use super::{Command, MalformedError, ReplyError, Status, Window};

/// First of the 64 characters that carry 6 bits (p. 5).
const FIRST_CHARACTER: u8 = 0x30;
const FIRST_PAIR: u16 = u16::from_le_bytes([FIRST_CHARACTER; 2]);

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
            Some([]) => return Err(MalformedError::NoStatus.into()),
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
                Err(MalformedError::NoData.into())
            }
            (Some(data), true, Command::Version) => Ok(Self { status, data, points: 0 }),
            (None, ..) => Ok(Self { status, data: &[], points: 0 }),
            (Some(data), ..) => {
                Err(MalformedError::UnexpectedData { status, bytes: data.len() }.into())
            }
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
    let (mut decoder, mut ends) = (Decoder::default(), 0);
    for ([line @ .., end], values) in lines.iter().zip(whole.as_chunks_mut().0) {
        decoder.line(line, values);
        ends |= end ^ b'\n';
    }
    decoder.last_line(last, rest);
    right_length && ends == 0 && decoder.saw_only_characters()
}

/// Fails at the first place where the data differs from the shape of `expected`
/// characters.
fn find_fault(data: &[u8], expected: usize) -> Result<(), MalformedError> {
    let mut left = expected;
    for (index, line) in data.split(|&byte| byte == b'\n').enumerate() {
        let expected = left.min(BLOCK);
        if line.len() != expected || expected == 0 {
            return Err(MalformedError::LineLength { line: index, expected, found: line.len() });
        }
        let stray = line.iter().enumerate().find(|(_, byte)| !is_character(**byte));
        if let Some((column, &found)) = stray {
            return Err(MalformedError::Character { line: index, column, found });
        }
        left -= expected;
    }
    if left == 0 { Ok(()) } else { Err(MalformedError::Short { expected, found: expected - left }) }
}

/// Number of values in a successful reply to `command`.
fn points(command: &Command) -> usize {
    match command {
        Command::Distances(window) => window.points(),
        _ => 0,
    }
}

/// Returns true for the 64 characters that carry 6 bits: `0` to `o`.
const fn is_character(byte: u8) -> bool {
    byte.wrapping_sub(FIRST_CHARACTER) < 64
}

/// Decodes values of two characters each, upper six bits first (p. 5), and checks all
/// bytes at the end. Bytes that are not [characters](is_character) decode to an arbitrary
/// 12-bit value.
///
/// No branch depends on a value, so that the compiler can use vector instructions.
#[derive(Debug, Default)]
struct Decoder {
    /// Decoded pairs of each column, combined by OR.
    seen: [u16; 32],
}

impl Decoder {
    /// Decodes a full line.
    fn line(&mut self, line: &[u8; 64], values: &mut [u16; 32]) {
        // Copied to a local, which stays in registers.
        let mut seen = self.seen;
        decode_line(line, values, &mut seen);
        self.seen = seen;
    }

    /// Decodes a line of at most 64 bytes.
    fn last_line(&mut self, line: &[u8], values: &mut [u16]) {
        decode_line(line, values, &mut self.seen);
    }

    /// Checks that all bytes were characters.
    fn saw_only_characters(&self) -> bool {
        let seen = self.seen.iter().fold(0, |all, pair| all | pair);
        seen.to_le_bytes().iter().all(|&byte| byte < 64)
    }
}

/// Subtracts from both bytes of a pair at once, as one little-endian number. A borrow
/// from the upper byte does no harm: only characters give results below 64 in both bytes.
#[inline(always)]
fn decode_line(line: &[u8], values: &mut [u16], seen: &mut [u16; 32]) {
    for ((pair, value), seen) in line.as_chunks().0.iter().zip(values).zip(seen) {
        let sixes = u16::from_le_bytes(*pair).wrapping_sub(FIRST_PAIR);
        *seen |= sixes;
        *value = (sixes << 6 | sixes >> 8) & 0x0fff;
    }
}
