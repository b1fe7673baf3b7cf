//! [`Motor`]: when the emulated sensor's revolutions end. Its period may drift, its phase jump.

use std::time::Duration;

use tokio::time::Instant;

/// Largest growth or shrinkage of the period in an hour, as a fraction. A faster drift
/// would bring the period to zero within days.
const MOST_DRIFT: f64 = 0.01;

/// Motor that turns from power-up on.
///
/// Revolution `n` since `origin` ends `n p (1 + n p d / 2)` after it, with the period `p`
/// at the origin and the drift `d`. A change of drift or phase moves the origin.
#[derive(Debug, Clone)]
pub(super) struct Motor {
    /// Period at power-up, and current period.
    initial: Duration,
    period: Duration,
    /// Growth of the period in a second, as a fraction.
    drift: f64,
    /// End of revolution `before`, counted from 1.
    origin: Instant,
    before: u64,
}

impl Motor {
    pub(super) fn new(period: Duration, drift_an_hour: f64, powered_at: Instant) -> Self {
        let drift = drift_an_hour.clamp(-MOST_DRIFT, MOST_DRIFT) / 3600.0;
        Self { initial: period, period, drift, origin: powered_at, before: 0 }
    }

    /// Restarts, as after power-up.
    pub(super) fn restart(&mut self, now: Instant) {
        (self.period, self.origin, self.before) = (self.initial, now, 0);
    }

    /// Sets the growth of the period in an hour, as a fraction.
    pub(super) fn set_drift(&mut self, now: Instant, drift_an_hour: f64) {
        let drift_an_hour = drift_an_hour.clamp(-MOST_DRIFT, MOST_DRIFT);
        let turns = self.turns(now);
        let end = self.end(self.before + turns);
        let even = self.period.as_secs_f64() * turns as f64;
        self.period = self.period.mul_f64(1.0 + self.drift * even);
        (self.origin, self.before) = (end, self.before + turns);
        self.drift = drift_an_hour / 3600.0;
    }

    /// Turns slower than at power-up by this many percent, from the latest end of a revolution on.
    pub(super) fn slow_down(&mut self, now: Instant, percent: u8) {
        self.set_drift(now, self.drift * 3600.0);
        self.period = self.initial * 100 / (100 - u32::from(percent.min(99)));
    }

    /// Delays all ends of revolutions after `now`.
    pub(super) fn delay(&mut self, now: Instant, by: Duration) {
        self.set_drift(now, self.drift * 3600.0);
        self.origin += by;
    }

    /// Duration of a revolution at the latest change of the motor.
    pub(super) fn period(&self) -> Duration {
        self.period
    }

    /// Number of revolutions since power-up that had ended at `at`.
    pub(super) fn finished(&self, at: Instant) -> u64 {
        self.before + self.turns(at)
    }

    /// End of the first revolution that ends after `at`.
    pub(super) fn next_end(&self, at: Instant) -> Instant {
        self.end(self.finished(at) + 1)
    }

    /// End of a revolution, counted from 1, since the latest change of the motor. For an
    /// earlier revolution, the time of the change.
    pub(super) fn end(&self, revolution: u64) -> Instant {
        self.origin + self.since_origin(revolution.saturating_sub(self.before))
    }

    /// Number of revolutions between the origin and `at`.
    fn turns(&self, at: Instant) -> u64 {
        let since = at.saturating_duration_since(self.origin);
        if self.drift == 0.0 {
            let turns = since.as_nanos().checked_div(self.period.as_nanos()).unwrap_or(0);
            return u64::try_from(turns).unwrap_or(u64::MAX);
        }
        let elapsed = since.as_secs_f64();
        let even = ((1.0 + 2.0 * self.drift * elapsed).max(0.0).sqrt() - 1.0) / self.drift;
        // Rounding may have moved an end to the other side of `at`.
        let turns = (even / self.period.as_secs_f64()).round() as u64;
        if self.since_origin(turns) <= since { turns } else { turns.saturating_sub(1) }
    }

    /// Duration of the first `turns` revolutions after the origin.
    fn since_origin(&self, turns: u64) -> Duration {
        let nanos = self.period.as_nanos() * u128::from(turns);
        let even = Duration::from_nanos(u64::try_from(nanos).unwrap_or(u64::MAX));
        let grown = even.mul_f64(even.as_secs_f64() * self.drift.abs() / 2.0);
        if self.drift < 0.0 { even.saturating_sub(grown) } else { even + grown }
    }
}
