//! Times as text. Points in time are in UTC: the same for every reader, wherever
//! they are.

use std::time::SystemTime;

use jiff::Timestamp;

/// Returns `2026-01-31 23:59:59 UTC`.
pub(crate) fn utc(time: SystemTime) -> String {
    timestamp(time).strftime("%Y-%m-%d %H:%M:%S UTC").to_string()
}

/// Returns `2026-01-31T235959Z`, which any file system takes as part of a name.
pub(crate) fn file_name(time: SystemTime) -> String {
    timestamp(time).strftime("%Y-%m-%dT%H%M%SZ").to_string()
}

/// Returns `1:02:03`, or `2:03` below an hour.
pub(crate) fn clock(seconds: f64) -> String {
    let seconds = seconds as u64;
    let (hours, minutes, seconds) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
    match hours {
        0 => format!("{minutes}:{seconds:02}"),
        _ => format!("{hours}:{minutes:02}:{seconds:02}"),
    }
}

/// Converts `time`; 1970 if the system's clock is at a year that no calendar has.
fn timestamp(time: SystemTime) -> Timestamp {
    Timestamp::try_from(time).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_time_is_written_to_the_second_in_utc() {
        let time = SystemTime::UNIX_EPOCH + Duration::from_millis(1_709_210_096_999);
        assert_eq!(utc(time), "2024-02-29 12:34:56 UTC");
        assert_eq!(file_name(time), "2024-02-29T123456Z");
    }

    #[test]
    fn a_time_beyond_the_calendar_is_the_epoch() {
        // The year 11476: calendars end with 9999, times of Windows with 30827.
        let time = SystemTime::UNIX_EPOCH + Duration::from_secs(300_000_000_000);
        assert_eq!(utc(time), "1970-01-01 00:00:00 UTC");
    }
}
