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
    /// line at 4095. No capture of a real sensor has this value.
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

    /// Range in metres as REP 117 of ROS defines it: a distance as it is, `+Inf` where
    /// the object may be beyond the range, `NaN` for every other error code. Do not take `+Inf` as
    /// free space.
    ///
    /// A saturated value is `+Inf`, and so are the error codes 0, 6 and 16 in SCIP 1.1; in SCIP 2 it
    /// is 0 of a URG, 1 of a UTM-30LX, and 65533 of a UST.
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
    value: u32,
    /// Codes of the model. `None` stands for SCIP 1.1.
    codes: Option<Codes>,
}

impl ErrorCode {
    /// Returns the error code with this number, if it is one of these codes.
    pub(super) const fn from_value(value: u32, codes: Option<Codes>) -> Option<Self> {
        let is_code = match codes {
            None => value < 20,
            Some(codes) => codes.meaning(value).is_some(),
        };
        if is_code { Some(Self { value, codes }) } else { None }
    }

    /// Creates the error code of a value below all distances.
    pub(super) const fn too_small(value: u32, codes: Option<Codes>) -> Self {
        Self { value, codes }
    }

    /// Its meaning. In SCIP 1.1 these are the words of the protocol text (p. 7).
    pub const fn meaning(self) -> &'static str {
        if let Some(codes) = self.codes {
            return match codes.meaning(self.value) {
                Some(meaning) => meaning,
                None => "value below the measurable distances",
            };
        }
        match self.value {
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

    /// Returns true if too little light came back: the codes 1 to 5 in SCIP 1.1, and 1 and 2 of a URG
    /// in SCIP 2.
    pub const fn is_low_intensity(self) -> bool {
        match self.codes {
            None => matches!(self.value, 1..=5),
            Some(Codes::Urg) => matches!(self.value, 1 | 2),
            Some(_) => false,
        }
    }

    /// Returns true if an object may be beyond the range.
    const fn is_beyond_range(self) -> bool {
        match self.codes {
            None => matches!(self.value, 0 | 6 | 16),
            Some(Codes::Urg) => self.value == 0,
            Some(Codes::Utm) => self.value == 1,
            Some(Codes::Ethernet) => self.value == 65_533,
            Some(Codes::Unknown) => false,
        }
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
