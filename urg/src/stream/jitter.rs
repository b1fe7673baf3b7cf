//! Measures how regularly scans arrive.

use std::collections::VecDeque;
use std::time::Duration;

use serde::Serialize;
use tokio::time::Instant;

/// Mean and spread of the intervals between scans, in seconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Jitter {
    pub(crate) mean: f64,
    pub(crate) min: f64,
    pub(crate) max: f64,
    pub(crate) deviation: f64,
}

impl Jitter {
    /// Computes the spread of the intervals. Needs at least two `times`.
    pub(crate) fn from_times(times: impl Iterator<Item = Instant> + Clone) -> Option<Self> {
        let pairs = times.clone().zip(times.skip(1));
        let intervals = pairs.map(|(one, next)| next.saturating_duration_since(one).as_secs_f64());
        let count = intervals.clone().count();
        if count == 0 {
            return None;
        }
        let mean = intervals.clone().sum::<f64>() / count as f64;
        let square = intervals.clone().map(|one| (one - mean).powi(2)).sum::<f64>();
        Some(Self {
            mean,
            min: intervals.clone().fold(f64::INFINITY, f64::min),
            max: intervals.fold(0.0, f64::max),
            deviation: (square / count as f64).sqrt(),
        })
    }
}

/// Arrival times of the latest scans.
#[derive(Debug, Clone, Default)]
pub(crate) struct RecentTimes(VecDeque<Instant>);

impl RecentTimes {
    /// Maximum age of a scan.
    const SPAN: Duration = Duration::from_secs(10);

    pub(crate) fn push(&mut self, at: Instant) {
        self.0.push_back(at);
        while self.0.front().is_some_and(|first| *first + Self::SPAN < at) {
            self.0.pop_front();
        }
    }

    /// Drops all times: the next interval includes the loss of the link.
    pub(crate) fn clear(&mut self) {
        self.0.clear();
    }

    pub(crate) fn jitter(&self) -> Option<Jitter> {
        Jitter::from_times(self.0.iter().copied())
    }

    /// Scans a second, for the time until the driver has measured the rate.
    pub(crate) fn rate(&self) -> Option<f64> {
        self.jitter().map(|jitter| 1.0 / jitter.mean).filter(|rate| rate.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_is_that_of_the_intervals() {
        let begin = Instant::now();
        let times = [0, 100, 190, 300].map(|millis| begin + Duration::from_millis(millis));
        let jitter = Jitter::from_times(times.into_iter()).unwrap();
        assert!((jitter.min - 0.09).abs() < 1e-9 && (jitter.max - 0.11).abs() < 1e-9);
        assert!((jitter.deviation - (0.0002_f64 / 3.0).sqrt()).abs() < 1e-9, "{jitter:?}");
        assert_eq!(Jitter::from_times([begin].into_iter()), None);
    }

    #[test]
    fn only_the_latest_ten_seconds_count() {
        let begin = Instant::now();
        let mut times = RecentTimes::default();
        assert_eq!(times.jitter(), None);
        for millis in [0, 5_000, 5_090, 5_200, 15_080] {
            times.push(begin + Duration::from_millis(millis));
        }
        let jitter = times.jitter().unwrap();
        assert!((jitter.min - 0.11).abs() < 1e-9 && (jitter.max - 9.88).abs() < 1e-9);
        assert!((times.rate().unwrap() - 2.0 / 9.99).abs() < 1e-9);
        times.clear();
        assert_eq!(times.rate(), None);
    }
}
