//! [`Jitter`]: how evenly scans come.

use serde::Serialize;
use tokio::time::Instant;

/// The spread of the intervals between scans, in seconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Jitter {
    pub(crate) min: f64,
    pub(crate) max: f64,
    /// The standard deviation.
    pub(crate) deviation: f64,
}

impl Jitter {
    /// Returns the spread of the intervals between times; `None` for less than two.
    pub(crate) fn of(times: impl Iterator<Item = Instant> + Clone) -> Option<Self> {
        let pairs = times.clone().zip(times.skip(1));
        let intervals = pairs.map(|(one, next)| next.saturating_duration_since(one).as_secs_f64());
        let count = intervals.clone().count();
        if count == 0 {
            return None;
        }
        let mean = intervals.clone().sum::<f64>() / count as f64;
        let square = intervals.clone().map(|one| (one - mean).powi(2)).sum::<f64>();
        Some(Self {
            min: intervals.clone().fold(f64::INFINITY, f64::min),
            max: intervals.fold(0.0, f64::max),
            deviation: (square / count as f64).sqrt(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_is_that_of_the_intervals() {
        let begin = Instant::now();
        let times =
            [0, 100, 190, 300].map(|millis| begin + std::time::Duration::from_millis(millis));
        let jitter = Jitter::of(times.into_iter()).unwrap();
        assert!((jitter.min - 0.09).abs() < 1e-9 && (jitter.max - 0.11).abs() < 1e-9);
        assert!((jitter.deviation - (0.0002_f64 / 3.0).sqrt()).abs() < 1e-9, "{jitter:?}");
        assert_eq!(Jitter::of([begin].into_iter()), None);
    }
}
