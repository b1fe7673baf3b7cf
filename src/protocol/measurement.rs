//! [`Measurement`]: the meaning of the value that a scan has for one direction.

use std::fmt;

/// Value above all distances (p. 7): all 12 bits set.
const SATURATED: u32 = 4095;

/// Result of a measurement in one direction.
///
/// As data (feature `serde`): `{"distance":1234}`, `{"error":6}`, `"saturated"`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize), serde(rename_all = "snake_case"))]
pub enum Measurement {
    /// A distance in millimetres, 20..=4094 (C-42-3320-A p. 7).
    Distance(u32),
    /// No distance, and why (p. 7).
    Error(ErrorCode),
    /// All twelve bits set, 4095. The protocol text ends the range at 4094, the sensors'
    /// firmware line at 4095. No capture of a real sensor has this value.
    Saturated,
}

impl Measurement {
    /// Value as the sensor sent it.
    pub const fn value(self) -> u32 {
        match self {
            Self::Distance(millimetres) => millimetres,
            Self::Error(code) => code.0 as u32,
            Self::Saturated => SATURATED,
        }
    }

    /// Distance in millimetres, or `None` for an error or saturation.
    pub const fn distance(self) -> Option<u32> {
        match self {
            Self::Distance(millimetres) => Some(millimetres),
            _ => None,
        }
    }

    /// Range in metres as REP 117 of ROS defines it: a distance as it is, `+Inf` where
    /// the object may be beyond the range (error codes 0, 6 and 16, and saturated), `NaN`
    /// for every other error code. Do not take `+Inf` as free space.
    pub fn range(self) -> f32 {
        match self {
            Self::Distance(millimetres) => (f64::from(millimetres) / 1000.0) as f32,
            Self::Error(code) if !code.is_beyond_range() => f32::NAN,
            Self::Error(_) | Self::Saturated => f32::INFINITY,
        }
    }
}

/// Why a distance is missing: a value in 0..=19 (C-42-3320-A p. 7). As data (feature
/// `serde`) it is its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[cfg_attr(feature = "serde", derive(serde::Serialize), serde(into = "u8"))]
pub struct ErrorCode(u8);

impl ErrorCode {
    /// Returns the error code with this number, if it is one.
    pub(super) const fn from_value(value: u32) -> Option<Self> {
        if value < 20 { Some(Self(value as u8)) } else { None }
    }

    /// Its meaning, in the words of the protocol text (p. 7).
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

    /// Returns true if an object may be beyond the range: error codes 0, 6 and 16.
    pub(crate) const fn is_beyond_range(self) -> bool {
        matches!(self.0, 0 | 6 | 16)
    }
}

impl fmt::Display for ErrorCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "error code {}: {}", self.0, self.meaning())
    }
}

impl From<ErrorCode> for u8 {
    fn from(code: ErrorCode) -> Self {
        code.0
    }
}
