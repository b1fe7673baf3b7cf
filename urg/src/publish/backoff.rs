//! Limits how often an engine is reopened for a reason that may come back at once, because each
//! reopening costs all readers about a second.

use std::time::{Duration, Instant};

const SHORTEST: Duration = Duration::from_secs(20);
const LONGEST: Duration = Duration::from_secs(320);

#[derive(Debug, Default)]
pub(super) struct Backoff {
    last: Option<Instant>,
    /// Pause after the last reopening.
    pause: Duration,
}

impl Backoff {
    /// Returns true if the engine may be reopened at `now`. The caller then reopens it.
    pub(super) fn allows(&mut self, now: Instant) -> bool {
        let since = self.last.map_or(Duration::MAX, |last| now - last);
        if since < self.pause {
            return false;
        }
        let is_soon = since < 3 * self.pause;
        self.pause = if is_soon { LONGEST.min(2 * self.pause) } else { SHORTEST };
        self.last = Some(now);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_double_while_the_reason_comes_back() {
        for (period, expected) in [
            (1, &[0, 20, 60, 140, 300, 620, 940, 1260, 1580, 1900][..]),
            (30, &[0, 30, 90, 180, 360, 690, 1020, 1350, 1680]),
            (500, &[0, 500, 1000, 1500]),
        ] {
            let (mut backoff, start) = (Backoff::default(), Instant::now());
            let due = (0..2_000).step_by(period);
            let reopened = due.filter(|at| backoff.allows(start + Duration::from_secs(*at)));
            assert_eq!(reopened.collect::<Vec<_>>(), expected, "every {period} s");
        }
    }
}
