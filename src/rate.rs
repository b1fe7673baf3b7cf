//! [`Rate`]: how often a stream asks for a scan.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

/// The timer's resolution is a millisecond.
const SHORTEST: Duration = Duration::from_millis(1);
const LONGEST: Duration = Duration::from_secs(24 * 60 * 60);

/// How often a stream asks for a scan.
///
/// A URG turns ten times a second: [`Rate::hz(10.0)`](Rate::hz) is every turn.
/// What the line can carry may be less, see [`Window::wire_time`](crate::Window::wire_time).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Rate(Option<Duration>);

impl Rate {
    /// As fast as the sensor answers.
    pub const MAX: Self = Self(None);

    /// So many scans a second. Anything outside of once a day to 1,000 a
    /// second is taken as the nearest of the two; what is not a number is taken
    /// as once a day. To refuse such input instead, parse it:
    /// `"10".parse::<Rate>()`.
    pub fn hz(hz: f64) -> Self {
        let period = if hz > 0.0 { Duration::try_from_secs_f64(1.0 / hz).ok() } else { None };
        Self::every(period.unwrap_or(LONGEST))
    }

    /// A scan each `period`, 1 ms to a day; anything else is taken as the
    /// nearest of the two.
    pub const fn every(period: Duration) -> Self {
        let nanos = period.as_nanos();
        if nanos < SHORTEST.as_nanos() {
            Self(Some(SHORTEST))
        } else if nanos > LONGEST.as_nanos() {
            Self(Some(LONGEST))
        } else {
            Self(Some(period))
        }
    }

    /// The time between two scans, or `None` for [`Rate::MAX`].
    pub const fn period(self) -> Option<Duration> {
        self.0
    }
}

impl fmt::Display for Rate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            None => f.write_str("max"),
            Some(period) => {
                let hz = 1.0 / period.as_secs_f64();
                write!(f, "{} Hz", (hz * 1000.0).round() / 1000.0)
            }
        }
    }
}

/// A text that is no rate.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{found:?} is no rate: use a number of scans a second above 0 and up to 1000, such as 10, or max"
)]
pub struct InvalidRate {
    found: String,
}

impl FromStr for Rate {
    type Err = InvalidRate;

    fn from_str(text: &str) -> Result<Self, InvalidRate> {
        let number = text.trim_end_matches("Hz").trim_end();
        match number.parse::<f64>() {
            _ if text == "max" => Ok(Self::MAX),
            Ok(hz) if hz > 0.0 && hz <= 1000.0 => Ok(Self::hz(hz)),
            _ => Err(InvalidRate { found: text.to_owned() }),
        }
    }
}
