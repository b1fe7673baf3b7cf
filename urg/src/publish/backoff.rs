//! Limits how often an engine is reopened: each time costs all readers about a second.

use std::time::{Duration, Instant};

/// Shortest time between two.
const SHORTEST: Duration = Duration::from_secs(20);
/// Time between two in the long run.
const USUAL: Duration = Duration::from_secs(60);
/// How far ahead of the usual pace a series of outages may get.
const AHEAD: Duration = Duration::from_secs(9 * 60);

#[derive(Debug, Default)]
pub(super) struct Backoff {
    last: Option<Instant>,
    /// When the next one would be due, had each been followed by the usual time.
    due: Option<Instant>,
}

impl Backoff {
    /// Returns true if the engine may be reopened at `now`. The caller then reopens it.
    pub(super) fn allows(&mut self, now: Instant) -> bool {
        let due = self.due.map_or(now, |due| due.max(now));
        if self.last.is_some_and(|last| now - last < SHORTEST) || due - now > AHEAD {
            return false;
        }
        (self.last, self.due) = (Some(now), Some(due + USUAL));
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_series_of_outages_is_followed_by_pauses() {
        for (period, soon, later) in [(1u16, 20, 60), (35, 35, 70), (60, 60, 60), (500, 500, 500)] {
            let (mut backoff, start) = (Backoff::default(), Instant::now());
            let due = (0..20_000).step_by(period.into());
            let is_allowed = |at: &u16| backoff.allows(start + Duration::from_secs((*at).into()));
            let reopened: Vec<u16> = due.filter(is_allowed).collect();
            let pauses: Vec<_> = reopened.windows(2).map(|pair| pair[1] - pair[0]).collect();
            assert!(pauses.iter().all(|pause| (soon..=later).contains(pause)), "{pauses:?}");
            assert_eq!(pauses[..12], [soon; 12], "every {period} s");
            assert!(pauses.len() < 20_000 / 60 + 12, "every {period} s: {}", pauses.len());
        }
    }
}
