//! [`Rate`]: the number of scans a second that a stream asks for.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use crate::protocol::ParameterError;

/// Resolution of the timer: a millisecond.
const SHORTEST_PERIOD: Duration = Duration::from_millis(1);
const LONGEST_PERIOD: Duration = Duration::from_secs(24 * 60 * 60);
/// Fraction of a rate that counts as reached.
const REACHED: f64 = 0.95;
/// Enough decimals to distinguish periods of a day that differ by a nanosecond.
const MAX_DECIMALS: usize = 20;

/// Number of scans per second that a stream asks for.
///
/// A URG makes about ten revolutions per second, a UTM or UST 40. [`Rate::hz(10.0)`](Rate::hz) gets a
/// scan of almost every revolution of a URG, [`Rate::UNLIMITED`] of every revolution of any model. The
/// line may carry fewer: see [`Window::wire_time`](crate::Window::wire_time).
///
/// As text and as data (feature `serde`) it is `10 Hz`, `0.5 Hz` or `max`. In data, you
/// may also write a number, or a text without the unit.
///
/// ```
/// use std::time::Duration;
/// use tokio_scip::Rate;
///
/// assert_eq!("10 Hz".parse(), Ok(Rate::hz(10.0)));
/// assert_eq!(Rate::every(Duration::from_millis(100)), Rate::hz(10.0));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize), serde(try_from = "TextOrNumber"))]
pub struct Rate(Option<Duration>);

impl Rate {
    /// No limit: as fast as the sensor answers. From a sensor of SCIP 2 each scan once. As text: `max`.
    pub const UNLIMITED: Self = Self(None);

    /// Creates a rate of `hz` scans per second: above 0, at most 1,000. Less than one a day becomes one.
    ///
    /// # Panics
    ///
    /// Panics on NaN, on 0 and less, and above 1,000. For a number that does not come from your own
    /// source code use [`Rate::try_from`], or parse a text: `"10".parse::<Rate>()`.
    #[track_caller]
    pub fn hz(hz: f64) -> Self {
        let rate = valid(hz);
        assert!(rate.is_some(), "invalid rate {hz} Hz: expected more than 0 and at most 1000 Hz");
        rate.unwrap_or(Self::UNLIMITED)
    }

    /// Creates a rate of one scan per `period`, clamped to 1 ms and a day.
    pub const fn every(period: Duration) -> Self {
        let nanos = period.as_nanos();
        if nanos < SHORTEST_PERIOD.as_nanos() {
            Self(Some(SHORTEST_PERIOD))
        } else if nanos > LONGEST_PERIOD.as_nanos() {
            Self(Some(LONGEST_PERIOD))
        } else {
            Self(Some(period))
        }
    }

    /// Time between two scans, or `None` for [`Rate::UNLIMITED`].
    pub const fn period(self) -> Option<Duration> {
        self.0
    }

    /// Returns true if `hz` is at least 95 % of this rate, or this is [`Rate::UNLIMITED`].
    pub fn is_reached_by(self, hz: f64) -> bool {
        self.0.is_none_or(|period| hz * period.as_secs_f64() >= REACHED)
    }
}

/// Same as [`Rate::hz`], for any number.
impl TryFrom<f64> for Rate {
    type Error = ParameterError;

    fn try_from(hz: f64) -> Result<Self, ParameterError> {
        valid(hz).ok_or_else(|| invalid(hz))
    }
}

/// Writes the fewest digits that parse back to the same rate.
impl fmt::Display for Rate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(period) = self.0 else { return f.write_str("max") };
        let hz = 1.0 / period.as_secs_f64();
        let text = |decimals| format!("{hz:.decimals$} Hz");
        let exact = (0..MAX_DECIMALS).map(text).find(|text| text.parse() == Ok(*self));
        f.write_str(&exact.unwrap_or_else(|| text(MAX_DECIMALS)))
    }
}

fn invalid(found: impl ToString) -> ParameterError {
    let expected = "more than 0 and at most 1000 Hz, such as 10, or max";
    ParameterError::new("rate", expected, found)
}

/// Parses scans per second with or without the unit, such as `10`, `10Hz` or `0.5 Hz`, or `max`.
impl FromStr for Rate {
    type Err = ParameterError;

    fn from_str(text: &str) -> Result<Self, ParameterError> {
        if text == "max" {
            return Ok(Self::UNLIMITED);
        }
        let number = text.strip_suffix("Hz").or(text.strip_suffix("hz")).unwrap_or(text).trim_end();
        let hz = number.parse().ok().and_then(valid);
        hz.ok_or_else(|| invalid(text))
    }
}

/// Creates the rate of `hz` scans per second, if `hz` is valid.
fn valid(hz: f64) -> Option<Rate> {
    let period = Duration::try_from_secs_f64(1.0 / hz).unwrap_or(LONGEST_PERIOD);
    (hz > 0.0 && hz <= 1000.0).then(|| Rate::every(period))
}

#[cfg(feature = "serde")]
impl serde::Serialize for Rate {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Rate as data: `10`, `0.5`, `"10 Hz"` or `"max"`.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
#[serde(untagged)]
enum TextOrNumber {
    Number(f64),
    Text(String),
}

#[cfg(feature = "serde")]
impl TryFrom<TextOrNumber> for Rate {
    type Error = ParameterError;

    fn try_from(data: TextOrNumber) -> Result<Self, ParameterError> {
        match data {
            TextOrNumber::Number(hz) => hz.try_into(),
            TextOrNumber::Text(text) => text.parse(),
        }
    }
}
