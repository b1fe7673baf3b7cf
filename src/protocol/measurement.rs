//! [`Measurement`]: the meaning of the value that a scan has for one direction.

use std::fmt;

use super::Codes;

/// Result of a measurement in one direction.
///
/// As data (feature `serde`): `{"distance":1234}`, `{"error":6}`, `"saturated"`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize), serde(rename_all = "snake_case"))]
pub enum Measurement {
    /// A distance in millimetres that the sensor [can measure](super::Geometry::distances).
    Distance(u32),
    /// No distance, and why.
    Error(ErrorCode),
    /// A value above all distances, which is no error code of the sensor's model. In SCIP 1.1 it is
    /// 4095, all twelve bits set: the protocol text ends the range at 4094, the sensors' firmware
    /// line at 4095. No capture of a real sensor has this value. In SCIP 2 it is also the longest
    /// distance, except of a UTM, UST or UAM.
    Saturated(#[cfg_attr(feature = "serde", serde(skip))] u32),
}

impl Measurement {
    /// Value as the sensor sent it.
    pub const fn value(self) -> u32 {
        match self {
            Self::Distance(value) | Self::Saturated(value) => value,
            Self::Error(code) => code.value,
        }
    }

    /// Distance in millimetres, or `None` for an error or saturation.
    pub const fn distance(self) -> Option<u32> {
        match self {
            Self::Distance(millimetres) => Some(millimetres),
            _ => None,
        }
    }

    /// Range in metres as REP 117 of ROS defines it: a distance as it is, `+Inf` where the object
    /// may be beyond the range, `NaN` for every other error code. Do not take `+Inf` as free space.
    ///
    /// A saturated value is `+Inf`, and so are some error codes: 0, 6 and 16 in SCIP 1.1; in SCIP 2 0 of
    /// a URG, 1 of a UTM-30LX, 65533 of a UST, and 65534 of a UAM.
    pub fn range(self) -> f32 {
        match self {
            Self::Distance(millimetres) => (f64::from(millimetres) / 1000.0) as f32,
            Self::Error(code) if !code.is_beyond_range() => f32::NAN,
            Self::Error(_) | Self::Saturated(_) => f32::INFINITY,
        }
    }
}

/// Why a distance is missing: a value that means so on this model. In SCIP 1.1 it is in 0..=19
/// (C-42-3320-A p. 7), in SCIP 2 a number that depends on the model, or a value below all distances. As
/// data (feature `serde`) it is its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[cfg_attr(feature = "serde", derive(serde::Serialize), serde(into = "u32"))]
pub struct ErrorCode {
    pub(super) value: u32,
    pub(super) codes: Codes,
}

impl ErrorCode {
    /// Its meaning. In SCIP 1.1 these are the words of the protocol text (p. 7).
    pub const fn meaning(self) -> &'static str {
        match self.codes.meaning(self.value) {
            Some(meaning) => meaning,
            None => "value below the measurable distances",
        }
    }

    /// Returns true if too little light came back: codes 1 to 5 in SCIP 1.1, 1 and 2 of a URG in SCIP 2.
    pub const fn is_low_intensity(self) -> bool {
        matches!((self.codes, self.value), (Codes::Scip1, 1..=5) | (Codes::Urg, 1 | 2))
    }

    /// Returns true if an object may be beyond the range.
    const fn is_beyond_range(self) -> bool {
        matches!(
            (self.codes, self.value),
            (Codes::Scip1, 0 | 6 | 16)
                | (Codes::Urg, 0)
                | (Codes::Utm, 1)
                | (Codes::Ethernet, 65_533)
                | (Codes::Uam, 65_534)
        )
    }
}

impl fmt::Display for ErrorCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "error code {}: {}", self.value, self.meaning())
    }
}

impl From<ErrorCode> for u32 {
    fn from(code: ErrorCode) -> Self {
        code.value
    }
}
