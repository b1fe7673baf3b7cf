//! [`RateMeter`]: the rate that a schedule reaches. Tells whether a shortfall comes from
//! the link's capacity or from failures.

use std::time::Duration;

use tokio::time::Instant;

/// Span to average the rate over.
const RATE_SPAN: Duration = Duration::from_secs(3);
/// Fraction of the requested rate that counts as reached.
const REACHED: f64 = 0.95;
/// Number of spans without a shortfall (a minute) before it is reported again. For the
/// same time after a loss, slowness is not reported: fences and deadlines cost time.
const SPANS_BETWEEN_REPORTS: u32 = 20;

/// Measures the achieved rate, span by span.
#[derive(Debug)]
pub(crate) struct RateMeter {
    since: Instant,
    scans: u32,
    failures: u32,
    /// Latest finished span since the link was found.
    span: Option<Span>,
    /// Number of spans since each kind of shortfall last occurred.
    since_slow: u32,
    since_loss: u32,
}

/// Result of one span.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Span {
    /// Scans per second.
    pub(crate) reached: f64,
    /// Polls that failed.
    pub(crate) failed: u32,
}

/// Why a rate is not reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Shortfall {
    /// Every poll succeeded: the line or the sensor cannot keep up.
    Slow,
    /// Polls failed, so the capacity of the line is unknown.
    Loss,
}

impl RateMeter {
    pub(crate) fn new(now: Instant) -> Self {
        Self {
            since: now,
            scans: 0,
            failures: 0,
            span: None,
            since_slow: SPANS_BETWEEN_REPORTS,
            since_loss: SPANS_BETWEEN_REPORTS,
        }
    }

    pub(crate) fn span(&self) -> Option<Span> {
        self.span
    }

    pub(crate) fn count_scan(&mut self) {
        self.scans += 1;
    }

    pub(crate) fn count_failure(&mut self) {
        self.failures += 1;
    }

    /// Ends the span if it is over, and returns it.
    pub(crate) fn finish_span(&mut self, now: Instant) -> Option<Span> {
        let span = now.saturating_duration_since(self.since);
        if span < RATE_SPAN {
            return None;
        }
        let reached = f64::from(self.scans) / span.as_secs_f64();
        self.span = Some(Span { reached, failed: self.failures });
        self.restart(now);
        self.span
    }

    /// Returns the cause if a span falls short of one poll per `period`. Stays silent
    /// about a cause found within the last [`SPANS_BETWEEN_REPORTS`].
    pub(crate) fn report(&mut self, span: Span, period: Duration) -> Option<Shortfall> {
        let is_short = span.reached * period.as_secs_f64() < REACHED;
        let shortfall = match (is_short, span.failed) {
            (false, _) => None,
            (true, 0) if self.since_loss < SPANS_BETWEEN_REPORTS => None,
            (true, 0) => Some(Shortfall::Slow),
            (true, _) => Some(Shortfall::Loss),
        };
        let mut news = None;
        for (kind, since) in
            [(Shortfall::Slow, &mut self.since_slow), (Shortfall::Loss, &mut self.since_loss)]
        {
            if shortfall == Some(kind) {
                news = shortfall.filter(|_| *since >= SPANS_BETWEEN_REPORTS);
                *since = 0;
            } else {
                *since = since.saturating_add(1);
            }
        }
        news
    }

    /// Forgets the latest span, because the link is lost.
    pub(crate) fn clear(&mut self) {
        self.span = None;
    }

    /// Starts a new span.
    pub(crate) fn restart(&mut self, now: Instant) {
        (self.since, self.scans, self.failures) = (now, 0, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_millis(100);

    #[test]
    fn a_shortfall_is_reported_once_and_again_after_it_was_gone() {
        let mut meter = RateMeter::new(Instant::now());
        let mut report = |reached| meter.report(Span { reached, failed: 0 }, PERIOD);
        assert_eq!(report(10.0), None);
        assert_eq!(report(5.0), Some(Shortfall::Slow));
        assert_eq!(report(5.0), None);
        assert_eq!((0..20).find_map(|_| report(9.6)), None);
        assert_eq!(report(5.0), Some(Shortfall::Slow));
    }

    #[test]
    fn the_rate_is_averaged_over_three_seconds() {
        let start = Instant::now();
        let mut meter = RateMeter::new(start);
        (0..30).for_each(|_| meter.count_scan());
        meter.count_failure();
        assert_eq!(meter.finish_span(start + Duration::from_millis(2999)), None);
        let span = Some(Span { reached: 10.0, failed: 1 });
        assert_eq!(meter.finish_span(start + Duration::from_secs(3)), span);
        assert_eq!(meter.report(Span { reached: 0.95, failed: 0 }, Duration::from_secs(1)), None);
    }

    #[test]
    fn a_span_with_failures_is_a_loss_and_no_lack_of_speed() {
        let mut meter = RateMeter::new(Instant::now());
        let mut report = |reached, failed| meter.report(Span { reached, failed }, PERIOD);
        assert_eq!(report(9.7, 1), None, "a scan lost now and then");
        assert_eq!(report(5.0, 3), Some(Shortfall::Loss));
        assert_eq!(report(5.0, 3), None);
        assert_eq!((0..20).find_map(|_| report(5.0, 0)), None, "what the loss has left");
        assert_eq!(report(5.0, 0), Some(Shortfall::Slow));
        assert_eq!(report(5.0, 3), Some(Shortfall::Loss));
    }
}
