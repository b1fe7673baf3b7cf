//! Lines and their sums.

use super::command::LINE;
use crate::protocol::{MalformedError, Text};

/// First of the 64 characters that carry 6 bits (p. 6).
pub(super) const FIRST_CHARACTER: u8 = 0x30;

/// First bytes in quotes, safe to show.
pub(super) fn quoted(bytes: &[u8]) -> String {
    format!("\"{}\"", Text::excerpt(bytes))
}

/// Sum of a line's bytes: its low six bits, as a character (p. 9).
pub(super) fn sum(bytes: &[u8]) -> u8 {
    (bytes.iter().fold(0u8, |sum, &byte| sum.wrapping_add(byte)) & 63) + FIRST_CHARACTER
}

/// Returns true if at least three lines are data of SCIP 2: 64 characters and their sum.
pub(crate) fn has_data(bytes: &[u8]) -> bool {
    let lines = bytes.split(|&byte| byte == b'\n').filter_map(<[u8]>::split_last);
    lines.filter(|(found, data)| data.len() == 64 && **found == sum(data)).nth(2).is_some()
}

/// Checks the sum at the end of a line.
fn check_sum(line: usize, expected: u8, found: u8) -> Result<(), MalformedError> {
    if expected == found {
        return Ok(());
    }
    let (expected, found) = (format!("the sum 0x{expected:02x}"), format!("0x{found:02x}"));
    Err(MalformedError::in_scip2(line, expected, found))
}

/// Checks a line of this number of characters, and returns them without their sum.
pub(super) fn characters(
    bytes: &[u8],
    line: usize,
    expected: usize,
) -> Result<&[u8], MalformedError> {
    let Some((&found, characters)) =
        bytes.split_last().filter(|_| expected > 0 && bytes.len() == expected + 1)
    else {
        let expected = if expected > 0 { format!("{} bytes", expected + 1) } else { "none".into() };
        return Err(MalformedError::in_scip2(line, expected, format!("{} bytes", bytes.len())));
    };
    if let Some(at) = characters.iter().position(|byte| byte.wrapping_sub(FIRST_CHARACTER) >= 64) {
        let found = characters.get(at..).unwrap_or_default();
        return Err(MalformedError::in_scip2(line, "characters from '0' to 'o'", quoted(found)));
    }
    check_sum(line, sum(characters), found).map(|()| characters)
}

/// Checks lines that hold this number of characters together.
pub(super) fn block(data: &[u8], first_line: usize, count: usize) -> Result<(), MalformedError> {
    let (mut left, mut line) = (count, first_line);
    for bytes in data.split(|&byte| byte == b'\n') {
        left -= characters(bytes, line, left.min(LINE))?.len();
        line += 1;
    }
    match left {
        0 => Ok(()),
        _ => Err(MalformedError::in_scip2(line, format!("{left} more characters"), "the end")),
    }
}

/// Decodes a number, upper six bits first.
pub(super) fn number(characters: &[u8]) -> u128 {
    characters
        .iter()
        .fold(0, |number, &byte| number << 6 | u128::from(byte.wrapping_sub(FIRST_CHARACTER) & 63))
}

/// Checks a line of a key, a colon, a value, a semicolon and a sum, and returns key and value. The
/// semicolon has no part in the sum; with `may_end_early`, neither may the text from `<-` on.
pub(super) fn pair(
    (line, bytes): (usize, &[u8]),
    may_end_early: bool,
) -> Result<(&[u8], &[u8]), MalformedError> {
    let malformed = || MalformedError::in_scip2(line, "key:value; and a sum", quoted(bytes));
    let [pair @ .., b';', found] = bytes else { return Err(malformed()) };
    // The sum does not see bit 6: it may have changed a letter into a control character.
    let is_text = pair.iter().all(|byte| matches!(byte, b' '..=b'~'));
    let colon = pair.iter().position(|&byte| byte == b':').filter(|_| is_text);
    let (key, value) = colon.and_then(|at| pair.split_at_checked(at)).ok_or_else(malformed)?;
    let arrow = pair.windows(2).position(|two| two == b"<-").filter(|_| may_end_early);
    if arrow.and_then(|at| pair.get(..at)).is_none_or(|part| sum(part) != *found) {
        check_sum(line, sum(pair), *found)?;
    }
    Ok((key, value.get(1..).unwrap_or_default().trim_ascii()))
}
