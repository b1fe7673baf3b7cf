//! [`RecentTimes`]: when the latest scans came, for the jitter of the last seconds.

use std::collections::VecDeque;
use std::time::Duration;

use tokio::time::Instant;

use crate::stream::jitter::Jitter;

/// The times of the latest scans.
#[derive(Debug, Default)]
pub(super) struct RecentTimes(VecDeque<Instant>);

impl RecentTimes {
    /// Older scans than this are forgotten.
    const SPAN: Duration = Duration::from_secs(10);

    pub(super) fn push(&mut self, at: Instant) {
        self.0.push_back(at);
        while self.0.front().is_some_and(|first| *first + Self::SPAN < at) {
            self.0.pop_front();
        }
    }

    /// Forgets all: the interval that follows is that of a lost link.
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    pub(super) fn jitter(&self) -> Option<Jitter> {
        Jitter::of(self.0.iter().copied())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_is_that_of_the_latest_ten_seconds() {
        let begin = Instant::now();
        let mut times = RecentTimes::default();
        assert_eq!(times.jitter(), None);
        for millis in [0, 5_000, 5_090, 5_200, 15_080] {
            times.push(begin + Duration::from_millis(millis));
        }
        // The first two are older than that, as seen from the last one.
        let jitter = times.jitter().unwrap();
        assert!((jitter.min - 0.11).abs() < 1e-9 && (jitter.max - 9.88).abs() < 1e-9);
        assert!((jitter.deviation - (9.88 - 0.11) / 2.0).abs() < 1e-9, "{jitter:?}");
        times.clear();
        times.push(begin + Duration::from_secs(16));
        assert_eq!(times.jitter(), None);
    }
}
