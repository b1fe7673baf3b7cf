//! [`Label`]: the host's own text in a command, which the reply echoes.

use std::fmt;

use crate::protocol::ParameterError;

/// Characters of [numbered](Label::numbered) labels, six bits each.
const DIGITS: &[u8; 64] = b"0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz._";

/// Text of the host's own in a command: 1 to 16 letters, digits, blanks, `.`, `_`, `+` or `@` (p. 9).
/// The sensor echoes it, so you can tell the replies to equal commands apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Label {
    bytes: [u8; Self::CAPACITY],
    length: usize,
}

impl Label {
    pub(super) const CAPACITY: usize = 16;

    /// Creates the label with this text.
    ///
    /// # Errors
    ///
    /// [`ParameterError`] if the text is empty, longer than 16 characters, or has another character.
    pub fn new(text: &str) -> Result<Self, ParameterError> {
        let allowed = |byte: &u8| byte.is_ascii_alphanumeric() || b" ._+@".contains(byte);
        let mut bytes = [0; Self::CAPACITY];
        match bytes.get_mut(..text.len()) {
            Some(slot) if !text.is_empty() && text.as_bytes().iter().all(allowed) => {
                slot.copy_from_slice(text.as_bytes());
                Ok(Self { bytes, length: text.len() })
            }
            _ => Err(ParameterError::new("label", "1 to 16 of A-Z a-z 0-9 ._+@ or blanks", text)),
        }
    }

    /// Creates a label of eight characters from a number: count up, and each command has a label of
    /// its own. Begin at a random number, so that replies to another program, or to yours before it
    /// was restarted, match no request.
    ///
    /// Two labels differ in at least two characters, because the last one is a sum of the others. So
    /// no damaged byte turns a label into another one. They repeat after 4.4e12 numbers.
    pub fn numbered(mut number: u64) -> Self {
        let (mut bytes, mut sum) = ([0; Self::CAPACITY], 0);
        for slot in bytes.iter_mut().take(7).rev() {
            *slot = digit(number);
            sum += number % 64;
            number /= 64;
        }
        bytes[7] = digit(sum);
        Self { bytes, length: 8 }
    }

    /// Number of bytes.
    pub(super) const fn len(&self) -> usize {
        self.length
    }
}

impl fmt::Display for Label {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = self.bytes.get(..self.length).unwrap_or_default();
        f.write_str(std::str::from_utf8(text).unwrap_or_default())
    }
}

fn digit(number: u64) -> u8 {
    DIGITS.get((number % 64) as usize).copied().unwrap_or_default()
}
