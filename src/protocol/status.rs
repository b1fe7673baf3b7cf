//! [`Status`]: the character of a reply that stands for success or a refusal.

use std::fmt;

use super::{Command, Text};

/// Status of a reply: one character, where only `0` means success (C-42-3320-A p. 3). As
/// data (feature `serde`) it is that character.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "serde", serde(into = "char"))]
pub struct Status(u8);

impl Status {
    /// `0`: success.
    pub(crate) const OK: Self = Self(b'0');

    /// Creates the status with this character.
    pub(crate) const fn new(character: u8) -> Self {
        Self(character)
    }

    /// Character as received.
    pub(crate) const fn character(self) -> u8 {
        self.0
    }

    /// Returns true for `0`.
    pub const fn is_ok(self) -> bool {
        matches!(self, Self::OK)
    }

    /// Meaning of this refusal of `command`, as drivers of real sensors know it.
    /// The protocol text defines only `0`.
    pub(crate) const fn meaning(self, command: &Command) -> Option<&'static str> {
        match (self.0, command) {
            (b'6', Command::Distances(_)) => Some("the laser is off"),
            (b'E', _) => Some("the sensor does not know the command"),
            _ => None,
        }
    }

    /// Returns true for `0`, and for a status of `L` or `S` that means "nothing to do":
    /// `2` for `L`, `3` for `S`.
    pub(crate) const fn is_ok_for(self, command: &Command) -> bool {
        match command {
            Command::LaserOn | Command::LaserOff => matches!(self.0, b'0' | b'2'),
            Command::BaudRate(_) => matches!(self.0, b'0' | b'3'),
            Command::Version | Command::Distances(_) => self.is_ok(),
        }
    }
}

impl From<Status> for char {
    fn from(status: Status) -> Self {
        status.0.into()
    }
}

impl From<Status> for Text {
    fn from(status: Status) -> Self {
        Self::from(&[status.0][..])
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "'{}'", Text::from(*self))
    }
}
