//! Times as text. Points in time are in UTC, so that they are the same for every reader.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use humantime::format_rfc3339_seconds;

/// Formats a time as `2026-01-31 23:59:59 UTC`.
pub(crate) fn utc(time: SystemTime) -> String {
    format_rfc3339_seconds(within_calendar(time)).to_string().replace('T', " ").replace('Z', " UTC")
}

/// Formats seconds as `1:02:03`, or as `2:03` below an hour.
pub(crate) fn clock(seconds: f64) -> String {
    let seconds = seconds as u64;
    let (hours, minutes, seconds) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
    match hours {
        0 => format!("{minutes}:{seconds:02}"),
        _ => format!("{hours}:{minutes:02}:{seconds:02}"),
    }
}

/// Returns the start of 1970 for a time before 1970 or after 9999.
fn within_calendar(time: SystemTime) -> SystemTime {
    /// Start of the year 10000.
    const END: Duration = Duration::from_secs(253_402_300_800);
    let since = time.duration_since(UNIX_EPOCH).ok().filter(|since| *since < END);
    UNIX_EPOCH + since.unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_is_written_to_the_second_in_utc() {
        let time = SystemTime::UNIX_EPOCH + Duration::from_millis(1_709_210_096_999);
        assert_eq!(utc(time), "2024-02-29 12:34:56 UTC");
    }

    #[test]
    fn a_time_beyond_the_calendar_is_the_epoch() {
        // The year 11476. RFC 3339 ends in 9999, Windows times in 30827.
        let time = SystemTime::UNIX_EPOCH + Duration::from_secs(300_000_000_000);
        assert_eq!(utc(time), "1970-01-01 00:00:00 UTC");
    }
}
