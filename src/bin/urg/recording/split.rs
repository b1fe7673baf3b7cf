//! [`SplitLimit`]: the value of `--split`, a time or a size.

use std::str::FromStr;
use std::time::Duration;

use crate::args::duration;

/// The length of a file of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SplitLimit {
    Duration(Duration),
    Bytes(u64),
}

/// Sizes, the longest names first: `kB` ends in `B`.
const UNITS: [(&str, u64); 3] = [("GB", 1_000_000_000), ("MB", 1_000_000), ("kB", 1_000)];
/// A smaller file holds less than its definitions take.
const MIN_BYTES: u64 = 10_000;

impl FromStr for SplitLimit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        for (unit, bytes) in UNITS {
            if let Some(number) = text.strip_suffix(unit) {
                let bytes =
                    number.trim_end().parse::<f64>().ok().map(|number| number * bytes as f64);
                let range = MIN_BYTES as f64..1e18;
                return match bytes.filter(|bytes| range.contains(bytes)) {
                    Some(bytes) => Ok(Self::Bytes(bytes as u64)),
                    None => {
                        Err("expected a size of at least 10kB, such as 500MB or 2GB".to_owned())
                    }
                };
            }
        }
        duration(text).map(Self::Duration).map_err(|_| {
            "expected a time or a size with its unit, such as 30m, 1h, 500MB or 2GB".to_owned()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_is_a_time_or_a_size() {
        let hour = SplitLimit::Duration(Duration::from_secs(3600));
        assert_eq!("1h".parse(), Ok(hour));
        assert_eq!("1GB".parse(), Ok(SplitLimit::Bytes(1_000_000_000)));
        assert_eq!("1.5 MB".parse(), Ok(SplitLimit::Bytes(1_500_000)));
        assert_eq!("10kB".parse(), Ok(SplitLimit::Bytes(10_000)));
        for text in ["", "1", "0h", "1B", "9kB", "-1GB", "GB", "nanGB", "infGB", "1e30GB", "1TB"] {
            assert!(text.parse::<SplitLimit>().is_err(), "{text}");
        }
    }
}
