//! [`Label`]: the host's own text in a command, which the reply echoes.

use std::fmt;

use crate::protocol::{Bytes, ParameterError};

/// Characters of [numbered](Label::numbered) labels, six bits each.
const DIGITS: &[u8; 64] = b"0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz._";

/// Text of the host's own in a command: 1 to 16 letters, digits, blanks, `.`, `_`, `+` or `@` (p. 9).
/// The sensor echoes it, so you can tell the replies to equal commands apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Label(Bytes<{ Self::CAPACITY }>);

impl Label {
    pub(super) const CAPACITY: usize = 16;

    /// Creates the label with this text.
    ///
    /// # Errors
    ///
    /// [`ParameterError`] if the text is empty, longer than 16 characters, or has another character.
    pub fn new(text: &str) -> Result<Self, ParameterError> {
        let allowed = |byte: &u8| byte.is_ascii_alphanumeric() || b" ._+@".contains(byte);
        let mut bytes = Bytes::new();
        match bytes.push(text.as_bytes()) {
            Ok(()) if !text.is_empty() && bytes.iter().all(allowed) => Ok(Self(bytes)),
            _ => Err(ParameterError::new("label", "1 to 16 of A-Z a-z 0-9 ._+@ or blanks", text)),
        }
    }

    /// Creates a label of eight characters from a number: count up, and each command has a label of its
    /// own. Begin at a random number, so that no reply to an earlier program matches a request.
    ///
    /// Two labels differ in at least two characters, because the last one is a sum of the others. So
    /// no damaged byte turns a label into another one. They repeat after 4.4e12 numbers.
    pub fn numbered(mut number: u64) -> Self {
        let (mut digits, mut sum) = ([0; 8], 0);
        for slot in digits.iter_mut().take(7).rev() {
            *slot = digit(number);
            sum += number % 64;
            number /= 64;
        }
        digits[7] = digit(sum);
        let mut bytes = Bytes::new();
        // Never fails: there is room.
        let _ = bytes.push(&digits);
        Self(bytes)
    }

    /// Number of bytes.
    pub(super) fn len(&self) -> usize {
        self.0.len()
    }
}

impl fmt::Display for Label {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

fn digit(number: u64) -> u8 {
    DIGITS.get((number % 64) as usize).copied().unwrap_or_default()
}
