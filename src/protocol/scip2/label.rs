//! [`Label`]: the host's own text in a command, which the reply echoes.

use std::fmt;

use crate::protocol::Text;

/// Error for a number or a text that a command cannot carry.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("invalid {parameter} \"{found}\": expected {expected}")]
pub struct ParameterError {
    parameter: &'static str,
    expected: &'static str,
    found: Text,
}

impl ParameterError {
    pub(super) fn new(
        parameter: &'static str,
        expected: &'static str,
        found: impl ToString,
    ) -> Self {
        Self { parameter, expected, found: found.to_string().into() }
    }
}

/// Characters of the labels that [`Labels`] makes, six bits each.
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

    /// Bytes of the text.
    pub fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..self.length).unwrap_or_default()
    }
}

impl fmt::Display for Label {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(std::str::from_utf8(self.as_bytes()).unwrap_or_default())
    }
}

/// Source of labels that differ from each other: a number that counts up, in eight characters.
///
/// Two labels differ in at least two characters, because the last one is a sum of the others. So no
/// damaged byte turns a label into another one. The numbers repeat after 4.4e12 labels.
#[derive(Debug, Clone)]
pub struct Labels {
    next: u64,
}

impl Labels {
    /// Creates a source that begins at this number. Draw it at random, so that replies to another
    /// program, or to this one before it was restarted, match no request.
    pub const fn starting_at(random: u64) -> Self {
        Self { next: random }
    }

    /// Returns the next label.
    pub fn next_label(&mut self) -> Label {
        let (mut number, mut sum) = (self.next, 0);
        self.next = self.next.wrapping_add(1);
        let mut bytes = [0; Label::CAPACITY];
        for slot in bytes.iter_mut().take(7).rev() {
            *slot = digit(number);
            sum += number % 64;
            number /= 64;
        }
        bytes[7] = digit(sum);
        Label { bytes, length: 8 }
    }
}

fn digit(number: u64) -> u8 {
    DIGITS.get((number % 64) as usize).copied().unwrap_or_default()
}
