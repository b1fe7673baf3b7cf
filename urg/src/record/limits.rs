//! Values of `--split` and `--keep`, a time or a size, and of `--sync`, a time.

use std::str::FromStr;
use std::time::Duration;

use crate::args::duration;

/// Limit of a file, or of all files, as a time or a size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SplitLimit {
    Duration(Duration),
    Bytes(u64),
}

/// Time between two syncs. `None` leaves syncing to the system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct SyncInterval(pub(crate) Option<Duration>);

impl FromStr for SyncInterval {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "0" | "0s" => Ok(Self(None)),
            text => duration(text).map(Some).map(Self),
        }
    }
}

/// Units of size, in bytes.
const UNITS: [(&str, u64); 3] = [("GB", 1_000_000_000), ("MB", 1_000_000), ("kB", 1_000)];
/// Minimum size: a smaller file has no room beside its schemas.
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
    fn a_sync_interval_is_a_time_or_never() {
        assert_eq!("0".parse(), Ok(SyncInterval(None)));
        assert_eq!("500ms".parse(), Ok(SyncInterval(Some(Duration::from_millis(500)))));
        assert!("1".parse::<SyncInterval>().is_err());
    }

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
