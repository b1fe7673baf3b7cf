//! Validates a frame against its command: the whole echo, the status, and for `G` every
//! line, every character and the number of points.
//!
//! SCIP 1.1 has no checksum, so every other sign of damage is checked. A frame that
//! passes has exactly the shape that its command asked for.

use std::iter::repeat_n;
use std::sync::Arc;

use super::scip2::has_data;
use super::window::BLOCK;
use super::{Command, MalformedError, ReplyError, Status, Text, Version};

/// First of the 64 characters that carry 6 bits (p. 5).
const FIRST_CHARACTER: u8 = 0x30;
const FIRST_PAIR: u16 = u16::from_le_bytes([FIRST_CHARACTER; 2]);

/// Complete, well-formed reply to a [`Command`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reply {
    /// Status of the reply.
    pub status: Status,
    /// Data of a successful `V`, otherwise empty.
    text: Vec<u8>,
    /// Values of a successful `G`, otherwise empty.
    values: Arc<[u16]>,
}

impl Reply {
    /// Validates `frame`, a reply without its terminator, against `command`, and decodes it.
    ///
    /// # Errors
    ///
    /// Returns a [`ReplyError`] unless the frame is exactly what a SCIP 1.1 sensor
    /// answers to this command: the same bytes back, a status of one character, data of
    /// the right shape after success, and no data after any other status.
    pub fn parse(command: &Command, frame: &[u8]) -> Result<Self, ReplyError> {
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
        let (text, values) = match (data, status.is_ok(), command) {
            (Some(data), true, Command::Distances(window)) => {
                (Vec::new(), decode(data, window.points())?)
            }
            (None | Some([]), true, Command::Version) | (None, true, Command::Distances(_)) => {
                return Err(MalformedError::NoData.into());
            }
            (Some(data), true, Command::Version) => (data.to_vec(), Arc::default()),
            (None, ..) => (Vec::new(), Arc::default()),
            (Some(data), ..) => {
                return Err(MalformedError::UnexpectedData { status, bytes: data.len() }.into());
            }
        };
        Ok(Self { status, text, values })
    }

    /// Finds the reply to `command` at the end of `frame`, whatever precedes it. A reply that was
    /// cut short has no terminator, so the next reply follows it in the same frame.
    ///
    /// Use it only if no older reply to `command` can be on its way, and for any command
    /// but `V`, whose reply has no fixed length.
    ///
    /// # Errors
    ///
    /// The errors of [`Reply::parse`] for the whole frame, if it does not end with the reply.
    #[doc(hidden)]
    pub fn parse_end(command: &Command, frame: &[u8]) -> Result<Self, ReplyError> {
        // With data and without. Both lengths include the two LFs.
        let lengths = [command.reply_len() - 2, command.bytes().len() + 2];
        lengths
            .into_iter()
            .filter_map(|length| frame.len().checked_sub(length))
            .filter_map(|start| frame.get(start..))
            .find_map(|tail| Self::parse(command, tail).ok())
            .map_or_else(|| Self::parse(command, frame), Ok)
    }

    /// Values of a successful `G`, 0..=4095 each, by step. Empty for any other reply.
    pub fn values(&self) -> &[u16] {
        &self.values
    }

    pub(crate) fn into_values(self) -> Arc<[u16]> {
        self.values
    }

    /// Iterates over the lines of a successful `V` after the status, except empty ones.
    fn lines(&self) -> impl Iterator<Item = &[u8]> {
        self.text.split(|&byte| byte == b'\n').filter(|line| !line.is_empty())
    }

    /// Frame of a reply to `V`, as it was parsed.
    pub(crate) fn version_frame(&self) -> Vec<u8> {
        [&b"V\n"[..], &[self.status.character(), b'\n'], &self.text].concat()
    }
}

impl Version {
    /// Parses the lines of a reply to `V`. Never fails: see [`Version`].
    pub fn from_reply(reply: &Reply) -> Self {
        Self::from_lines(reply.lines())
    }
}

/// Decodes the data of a `G` reply with this number of `points`. Fails if [`find_fault`] finds a
/// fault, but checks many times as fast.
fn decode(data: &[u8], points: usize) -> Result<Arc<[u16]>, MalformedError> {
    let mut values: Arc<[u16]> = repeat_n(0, points).collect();
    let is_whole = Arc::get_mut(&mut values).is_some_and(|values| decode_into(data, values));
    if !is_whole {
        find_fault(data, points * 2)?;
    }
    Ok(values)
}

/// Decodes the data into `values`. Returns true if it has the right shape for their number.
fn decode_into(data: &[u8], values: &mut [u16]) -> bool {
    let (lines, last) = data.as_chunks::<{ BLOCK + 1 }>();
    let right_length = data.len() == 2 * values.len() + lines.len() && !last.is_empty();
    let Some((whole, rest)) = values.split_at_mut_checked(lines.len() * BLOCK / 2) else {
        return false;
    };
    let (mut seen, mut ends) = ([0; BLOCK / 2], 0);
    for ([line @ .., end], values) in lines.iter().zip(whole.as_chunks_mut::<{ BLOCK / 2 }>().0) {
        ends |= end ^ b'\n';
        for ((pair, value), seen) in line.as_chunks().0.iter().zip(values).zip(&mut seen) {
            *seen |= decode_pair(*pair, value);
        }
    }
    let mut seen = seen.iter().fold(0, |all, pair| all | pair);
    for (pair, value) in last.as_chunks().0.iter().zip(rest) {
        seen |= decode_pair(*pair, value);
    }
    right_length && ends == 0 && seen.to_le_bytes().iter().all(|&byte| byte < 64)
}

/// Decodes a value of two characters, upper six bits first (p. 5). Returns both as numbers: below 64
/// each, unless they are no [characters](is_character), which decode to an arbitrary 12-bit value.
///
/// Subtracts from both at once, as one little-endian number. A borrow from the upper byte does no
/// harm: only characters give results below 64 in both bytes. No branch depends on a value, so that
/// the compiler can use vector instructions.
#[inline(always)]
const fn decode_pair(pair: [u8; 2], value: &mut u16) -> u16 {
    let sixes = u16::from_le_bytes(pair).wrapping_sub(FIRST_PAIR);
    *value = (sixes << 6 | sixes >> 8) & 0x0fff;
    sixes
}

/// Fails at the first place where the data differs from the shape of `expected` characters.
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

/// Returns true for the 64 characters that carry 6 bits: `0` to `o`.
const fn is_character(byte: u8) -> bool {
    byte.wrapping_sub(FIRST_CHARACTER) < 64
}

/// Error for a reply whose status line, at the front of `rest`, is not one printable character.
fn no_status(rest: &[u8]) -> ReplyError {
    let (line, _) = split_line(rest);
    if is_scip2(line) {
        return ReplyError::Scip2 { status: line.into() };
    }
    MalformedError::Status { found: Text::excerpt(line) }.into()
}

/// Error for a frame that does not begin with its command.
fn foreign(frame: &[u8]) -> ReplyError {
    let (echo, rest) = split_line(frame);
    match rest.map(split_line) {
        // In SCIP 2, `MD` and `MS` stream automatically.
        Some((status, _)) if echo.first() == Some(&b'M') && is_scip2(status) => {
            ReplyError::Scip2 { status: status.into() }
        }
        // The end of a scan, whose beginning was lost.
        _ if has_data(frame) => ReplyError::Scip2 { status: "99b".into() },
        _ => ReplyError::Foreign { found: Text::excerpt(echo) },
    }
}

/// Splits off the first line. The rest is `None` without an LF.
fn split_line(bytes: &[u8]) -> (&[u8], Option<&[u8]>) {
    let length = bytes.iter().position(|&byte| byte == b'\n').unwrap_or(bytes.len());
    let (line, rest) = bytes.split_at_checked(length).unwrap_or((bytes, b""));
    (line, rest.get(1..))
}

/// Recognises a status of SCIP 2: two characters and their checksum. The checksum is the low six
/// bits of their sum, plus 0x30 (`99b`), or on some sensors the sum itself (`0Eu`).
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
