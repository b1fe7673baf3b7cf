//! What a sensor says of one direction: the 6-bit characters, and what the
//! 12-bit number that they carry means.

use std::fmt;

/// The value above which no distance lies (p. 7); 4095 fills all 12 bits.
const SATURATED: u16 = 4095;

/// What was measured in one direction.
///
/// As data (feature `serde`): `{"distance":1234}`, `{"error":6}`, `"saturated"`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Measurement {
    /// A distance in millimetres, 20..=4094 (C-42-3320-A p. 7).
    Distance(u16),
    /// No distance, and why (p. 7).
    Error(ErrorCode),
    /// All twelve bits set, 4095. The text ends the range at 4094, the sensors'
    /// own description at 4095; captures never show it.
    Saturated,
}

impl Measurement {
    /// What a 12-bit value means. Bits above the twelfth are ignored.
    pub const fn from_value(value: u16) -> Self {
        match value & 0x0fff {
            code @ 0..=19 => Self::Error(ErrorCode(code as u8)),
            SATURATED => Self::Saturated,
            millimetres => Self::Distance(millimetres),
        }
    }

    /// The 12-bit value as the sensor sent it.
    pub const fn value(self) -> u16 {
        match self {
            Self::Distance(millimetres) => millimetres,
            Self::Error(code) => code.0 as u16,
            Self::Saturated => SATURATED,
        }
    }

    /// The distance in millimetres, if there is one.
    pub const fn distance(self) -> Option<u16> {
        match self {
            Self::Distance(millimetres) => Some(millimetres),
            _ => None,
        }
    }

    /// The range in metres after ROS REP 117: a distance as it is, `+Inf` where
    /// the object may be beyond the range (codes 0, 6 and 16, and saturated),
    /// `NaN` for every other code. `+Inf` is no proof of free space.
    pub fn range(self) -> f32 {
        match self {
            Self::Distance(millimetres) => f32::from(millimetres) / 1000.0,
            Self::Error(code) if !code.is_beyond_range() => f32::NAN,
            Self::Error(_) | Self::Saturated => f32::INFINITY,
        }
    }
}

/// Why there is no distance in a direction: one of the twenty codes 0..=19 of
/// the protocol text (C-42-3320-A p. 7). As data (feature `serde`) it is its
/// number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(into = "u8", try_from = "u8"))]
pub struct ErrorCode(u8);

impl ErrorCode {
    /// All twenty codes.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..=19).map(Self)
    }

    /// The code with this number, if it is in 0..=19.
    pub const fn new(number: u8) -> Option<Self> {
        if number <= 19 { Some(Self(number)) } else { None }
    }

    /// Its number, 0..=19.
    pub const fn number(self) -> u8 {
        self.0
    }

    /// What the protocol text says of it (p. 7).
    pub const fn meaning(self) -> &'static str {
        match self.0 {
            0 => "Possibility of detected object is at 22m",
            1..=5 => "Reflected light has low intensity",
            6 => "Possibility of detected object is at 5.7m",
            7 => "Distance data on the preceding and succeeding steps have errors",
            9 => "The same step had error in the last two scan",
            16 => "Possibility of detected object is in the range 4096mm~5.6m",
            18 => "Unspecified",
            19 => "Non-Measurable Distance",
            _ => "Others",
        }
    }

    /// True for the codes that mean a possible object beyond the range: 0, 6
    /// and 16.
    pub const fn is_beyond_range(self) -> bool {
        matches!(self.0, 0 | 6 | 16)
    }

    /// True for the codes that mean too little reflected light: 1 to 5.
    pub const fn is_low_intensity(self) -> bool {
        matches!(self.0, 1..=5)
    }
}

impl fmt::Display for ErrorCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "code {}: {}", self.0, self.meaning())
    }
}

impl From<ErrorCode> for u8 {
    fn from(code: ErrorCode) -> Self {
        code.0
    }
}

impl TryFrom<u8> for ErrorCode {
    type Error = UnknownErrorCode;

    fn try_from(number: u8) -> Result<Self, UnknownErrorCode> {
        Self::new(number).ok_or(UnknownErrorCode { found: number })
    }
}

/// A number that is no error code.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{found} is no error code: they are 0 to 19")]
pub struct UnknownErrorCode {
    found: u8,
}

/// The first of the 64 characters that carry 6 bits (p. 5).
const FIRST_CHARACTER: u8 = 0x30;
const FIRST_PAIR: u16 = u16::from_le_bytes([FIRST_CHARACTER; 2]);

/// True for the 64 characters that carry 6 bits: `0` to `o`.
pub(super) const fn is_character(byte: u8) -> bool {
    byte.wrapping_sub(FIRST_CHARACTER) < 64
}

/// Makes values of characters, two for each, upper six bits first (p. 5), and
/// tells afterwards whether all were [characters](is_character). Bytes that are
/// none make some value of 12 bits.
///
/// Nothing in here branches for a value: the compiler makes vector instructions
/// of it.
#[derive(Debug, Default)]
pub(super) struct Decoder {
    /// What is left of the pairs in each column, one over the other.
    seen: [u16; 32],
}

impl Decoder {
    /// Decodes a full line.
    pub(super) fn line(&mut self, line: &[u8; 64], values: &mut [u16; 32]) {
        // A copy, which nothing else can see: that stays in registers.
        let mut seen = self.seen;
        decode(line, values, &mut seen);
        self.seen = seen;
    }

    /// Decodes a line of at most 64 bytes.
    pub(super) fn last_line(&mut self, line: &[u8], values: &mut [u16]) {
        decode(line, values, &mut self.seen);
    }

    /// True if all bytes that came were characters.
    pub(super) fn saw_only_characters(&self) -> bool {
        let seen = self.seen.iter().fold(0, |all, pair| all | pair);
        seen.to_le_bytes().iter().all(|&byte| byte < 64)
    }
}

/// Takes both bytes of a pair at once, as one little-endian number. The
/// subtraction may borrow from the upper byte, and is exact all the same: each
/// result comes of one pair only, and those below 64 in both bytes of characters.
#[inline(always)]
fn decode(line: &[u8], values: &mut [u16], seen: &mut [u16; 32]) {
    for ((pair, value), seen) in line.as_chunks().0.iter().zip(values).zip(seen) {
        let sixes = u16::from_le_bytes(*pair).wrapping_sub(FIRST_PAIR);
        *seen |= sixes;
        *value = (sixes << 6 | sixes >> 8) & 0x0fff;
    }
}
