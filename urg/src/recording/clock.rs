//! [`Clock`]: whether the times of scans advance. Other programs write times that do not: all 0, all
//! the same, or in another order.

use std::time::SystemTime;

use serde::Serialize;

use crate::format::counted;
use crate::format::time::utc;

/// Times of the scans read so far.
#[derive(Debug, Clone, Default, Serialize)]
pub(crate) struct Clock {
    #[serde(skip)]
    latest: Option<SystemTime>,
    /// Number of times.
    #[serde(skip)]
    scans: u64,
    /// Number of times that equal the one before.
    pub(crate) equal: u64,
    /// Number of times that are earlier than the one before.
    pub(crate) backward: u64,
}

impl Clock {
    pub(crate) fn add(&mut self, time: SystemTime) {
        if let Some(latest) = self.latest.replace(time) {
            self.equal += u64::from(time == latest);
            self.backward += u64::from(time < latest);
        }
        self.scans += 1;
    }

    /// Returns true if there are several scans and only one time.
    pub(crate) fn stands(&self) -> bool {
        self.scans > 1 && self.equal == self.scans - 1
    }

    /// Describes what is wrong with these times, except `known` of them that run backwards.
    pub(crate) fn fault(&self, name: &str, known: u64) -> Option<String> {
        let backward = self.backward.saturating_sub(known);
        if self.stands() {
            let time = utc(self.latest.unwrap_or(SystemTime::UNIX_EPOCH));
            return Some(format!("all {} scans have the same {name}, {time}", self.scans));
        }
        let faults = [(self.equal, "equal to"), (backward, "earlier than")]
            .into_iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, what)| format!("{} {what} the one before", counted(count, name)));
        Some(faults.collect::<Vec<_>>().join(", ")).filter(|text| !text.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn times_that_do_not_advance_are_described() {
        let fault = |seconds: &[u64], known| {
            let mut clock = Clock::default();
            for since in seconds {
                clock.add(SystemTime::UNIX_EPOCH + Duration::from_secs(*since));
            }
            clock.fault("stamp", known).unwrap_or_default()
        };
        assert_eq!(fault(&[], 0), "");
        assert_eq!(fault(&[7], 0), "");
        assert_eq!(fault(&[7, 8, 9], 0), "");
        assert_eq!(
            fault(&[0, 0, 0], 0),
            "all 3 scans have the same stamp, 1970-01-01 00:00:00 UTC"
        );
        assert_eq!(
            fault(&[7, 7, 8, 6, 5], 0),
            "1 stamp equal to the one before, 2 stamps earlier than the one before"
        );
        assert_eq!(fault(&[7, 6], 1), "");
    }
}
