//! A moment of the wall clock as people write it, in UTC: the same for everybody
//! who reads it, wherever they are.

use std::fmt;
use std::time::SystemTime;

/// A moment, to the second.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Utc {
    days: u64,
    second: u64,
}

impl From<SystemTime> for Utc {
    fn from(time: SystemTime) -> Self {
        // A clock that was never set shows 1970.
        let seconds = time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default().as_secs();
        Self { days: seconds / 86_400, second: seconds % 86_400 }
    }
}

impl Utc {
    /// Year, month and day of the Gregorian calendar.
    fn date(self) -> (u64, u64, u64) {
        // Years that begin in March have their leap day at the end; 400 of them
        // have 146,097 days, and 1970 begins 719,468 days after 0000-03-01.
        let days = self.days + 719_468;
        let (era, day) = (days / 146_097, days % 146_097);
        let year = (day - day / 1_460 + day / 36_524 - day / 146_096) / 365;
        let day = day - (365 * year + year / 4 - year / 100);
        // Months from March on have 31, 30, 31, 30, 31 days, over and over.
        let month = (5 * day + 2) / 153;
        let day = day - (153 * month + 2) / 5 + 1;
        let (month, next) = if month < 10 { (month + 3, 0) } else { (month - 9, 1) };
        (era * 400 + year + next, month, day)
    }

    /// As a part of a file's name: `2026-01-31T235959Z`.
    pub(crate) fn file_name(self) -> String {
        let (year, month, day) = self.date();
        let (hour, minute, second) = self.clock();
        format!("{year:04}-{month:02}-{day:02}T{hour:02}{minute:02}{second:02}Z")
    }

    fn clock(self) -> (u64, u64, u64) {
        (self.second / 3600, self.second / 60 % 60, self.second % 60)
    }
}

/// `2026-01-31 23:59:59 UTC`.
impl fmt::Display for Utc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (year, month, day) = self.date();
        let (hour, minute, second) = self.clock();
        write!(f, "{year:04}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02} UTC")
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        for (seconds, text) in [
            (0, "1970-01-01 00:00:00 UTC"),
            (951_782_399, "2000-02-28 23:59:59 UTC"),
            (951_782_400, "2000-02-29 00:00:00 UTC"),
            (951_868_800, "2000-03-01 00:00:00 UTC"),
            (1_735_689_599, "2024-12-31 23:59:59 UTC"),
            (1_709_210_096, "2024-02-29 12:34:56 UTC"),
            (4_107_542_400, "2100-03-01 00:00:00 UTC"),
        ] {
            let utc = Utc::from(SystemTime::UNIX_EPOCH + Duration::from_secs(seconds));
            assert_eq!(utc.to_string(), text);
        }
        let utc = Utc::from(SystemTime::UNIX_EPOCH + Duration::from_secs(1_709_210_096));
        assert_eq!(utc.file_name(), "2024-02-29T123456Z");
    }
}
