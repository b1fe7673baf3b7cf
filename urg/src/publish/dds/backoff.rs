//! Limits how often DDS is reopened for a reason that may come back at once, because each
//! reopening costs all readers about a second.

use std::time::{Duration, Instant};

/// Pause after the first reopening, and after the second.
const SHORTEST: Duration = Duration::from_secs(20);

/// Number of times that the pause doubles, up to 320 s.
const MAX_DOUBLINGS: u32 = 4;

#[derive(Debug, Default)]
pub(super) struct Backoff {
    last: Option<Instant>,
    /// Number of reopenings in a row, each soon after the one before.
    streak: u32,
}

impl Backoff {
    /// Returns true if DDS may be reopened at `now`. The caller then reopens it.
    pub(super) fn allows(&mut self, now: Instant) -> bool {
        let since = self.last.map(|last| now - last);
        let wait = SHORTEST * 2_u32.pow(self.streak.saturating_sub(1).min(MAX_DOUBLINGS));
        if since.is_some_and(|since| since < wait) {
            return false;
        }
        let is_soon = since.is_some_and(|since| since < 3 * wait);
        self.streak = if is_soon { self.streak + 1 } else { 0 };
        self.last = Some(now);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seconds at which DDS is reopened, if there is a reason every `period` seconds.
    fn reopened(period: usize) -> Vec<u64> {
        let (mut backoff, start) = (Backoff::default(), Instant::now());
        let due = (0..2_000).step_by(period);
        due.filter(|at| backoff.allows(start + Duration::from_secs(*at))).collect()
    }

    #[test]
    fn pauses_double_while_the_reason_comes_back() {
        assert_eq!(reopened(1), [0, 20, 40, 80, 160, 320, 640, 960, 1280, 1600, 1920]);
        assert_eq!(reopened(30), [0, 30, 60, 120, 210, 390, 720, 1050, 1380, 1710]);
    }

    #[test]
    fn a_rare_reason_is_never_delayed() {
        assert_eq!(reopened(60).len(), 2_000_usize.div_ceil(60));
    }
}
