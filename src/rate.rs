//! [`Rate`]: how often a stream asks for a scan.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

/// The timer's resolution is a millisecond.
const SHORTEST: Duration = Duration::from_millis(1);
const LONGEST: Duration = Duration::from_secs(24 * 60 * 60);
/// They tell once a day from once a day and a nanosecond.
const DECIMALS: usize = 20;

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

/// In as few digits as give the same rate again when they are parsed.
impl fmt::Display for Rate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(period) = self.0 else { return f.write_str("max") };
        let hz = 1.0 / period.as_secs_f64();
        let text = |decimals| format!("{hz:.decimals$} Hz");
        let exact = (0..DECIMALS).map(text).find(|text| text.parse() == Ok(*self));
        f.write_str(&exact.unwrap_or_else(|| text(DECIMALS)))
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

/// Scans a second, such as `10` or `0.5`, or `max`.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_is_shown_in_few_digits() {
        for (rate, text) in [
            (Rate::hz(10.0), "10 Hz"),
            (Rate::hz(30.0), "30 Hz"),
            (Rate::hz(0.1), "0.1 Hz"),
            (Rate::hz(1000.0), "1000 Hz"),
            (Rate::every(Duration::from_secs(3000)), "0.0003333333333333 Hz"),
            (Rate::MAX, "max"),
        ] {
            assert_eq!(rate.to_string(), text);
        }
    }

    #[test]
    fn a_rate_as_text_is_the_same_rate_again() {
        let nanos = (SHORTEST.as_nanos() as u64, LONGEST.as_nanos() as u64);
        // From one end to the other, all orders of magnitude alike.
        let between = (0..5000).map(|n| {
            let part = f64::from(n) / 5000.0;
            (nanos.0 as f64 * (nanos.1 as f64 / nanos.0 as f64).powf(part)) as u64
        });
        for nanos in [nanos.0, nanos.0 + 1, nanos.1 - 1, nanos.1].into_iter().chain(between) {
            let rate = Rate::every(Duration::from_nanos(nanos));
            assert_eq!(rate.to_string().parse(), Ok(rate), "{rate}");
        }
    }
}
