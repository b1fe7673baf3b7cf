//! [`Backoff`]: how long to wait before retrying something that failed.

use std::time::Duration;

/// Delays that double, with jitter, so that drivers on one USB hub do not all retry at once.
pub(crate) struct Backoff {
    shortest: Duration,
    longest: Duration,
    next: Duration,
}

impl Backoff {
    pub(crate) fn new((shortest, longest): (Duration, Duration)) -> Self {
        Self { shortest, longest, next: shortest }
    }

    /// Starts over with the shortest delay if a link that lasted this long has outlasted the
    /// next delay: a flapping link keeps backing off.
    pub(crate) fn restart_if_outlasted(&mut self, up: Duration) {
        if up > self.next {
            self.restart();
        }
    }

    /// Starts over with the shortest delay.
    pub(crate) fn restart(&mut self) {
        self.next = self.shortest;
    }

    /// Returns the delay plus up to 10 % jitter, even beyond the longest, then doubles it.
    pub(crate) fn next(&mut self) -> Duration {
        let wait = self.next;
        self.next = (wait * 2).min(self.longest);
        wait.mul_f64(1.0 + 0.1 * fastrand::f64())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn waits_double_up_to_the_longest() {
        let mut longest_first = Duration::ZERO;
        for _ in 0..100 {
            let mut backoff = Backoff::new((ms(100), ms(1000)));
            for wait in [100, 200, 400, 800, 1000, 1000] {
                let next = backoff.next();
                assert!((ms(wait)..=ms(wait) * 11 / 10).contains(&next), "{wait}: {next:?}");
                if wait == 100 {
                    longest_first = longest_first.max(next);
                }
            }
        }
        assert!(longest_first > ms(105), "the random part is small: {longest_first:?}");
    }
}
