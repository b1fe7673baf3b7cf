//! Values of `--split` and `--keep`, a time or a size, and of `--sync`, a time.

use std::str::FromStr;
use std::time::Duration;

use bytesize::ByteSize;

use crate::args::duration;

/// Limit of a file, or of all files, as a time or a size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SplitLimit {
    Duration(Duration),
    Bytes(u64),
}

/// Parses the time between two syncs. 0 leaves syncing to the system.
pub(super) fn sync_interval(text: &str) -> Result<Duration, &'static str> {
    match text {
        "0" | "0s" => Ok(Duration::ZERO),
        text => duration(text),
    }
}

/// Minimum size: a smaller file has no room beside its schemas.
const MIN_BYTES: u64 = 10_000;

impl FromStr for SplitLimit {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        // A number alone could be seconds or bytes.
        if let Ok(duration) = duration(text)
            && text.contains(|letter: char| letter.is_alphabetic() || letter == ':')
        {
            return Ok(Self::Duration(duration));
        }
        match text.parse().ok().filter(|_| text.ends_with('B')) {
            Some(ByteSize(bytes)) if bytes >= MIN_BYTES => Ok(Self::Bytes(bytes)),
            Some(_) => Err("expected a size of at least 10kB, such as 500MB or 2GB"),
            None => Err("expected a time or a size with its unit, such as 30m, 1h, 500MB or 2GB"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_times_or_sizes() {
        assert_eq!("1h".parse(), Ok(SplitLimit::Duration(Duration::from_secs(3600))));
        assert_eq!("1GB".parse(), Ok(SplitLimit::Bytes(1_000_000_000)));
        assert_eq!("1.5 MB".parse(), Ok(SplitLimit::Bytes(1_500_000)));
        assert_eq!("10kB".parse(), Ok(SplitLimit::Bytes(10_000)));
        for text in ["", "1", "20000", "0h", "1B", "9kB", "-1GB", "GB", "nanGB", "infGB", "1e30GB"]
        {
            assert!(text.parse::<SplitLimit>().is_err(), "{text}");
        }
    }
}
