//! [`RateMeter`]: the rate that a schedule reaches. Tells whether a shortfall comes from
//! the link's capacity or from failures.

use std::time::Duration;

use tokio::time::Instant;

use crate::stats::Shortfall;
use crate::{BaudRate, Rate, Window};

/// Span to average the rate over.
const RATE_SPAN: Duration = Duration::from_secs(3);
/// Number of spans without a shortfall (a minute) before it is reported again.
const SPANS_BETWEEN_REPORTS: u32 = 20;

/// Measures the achieved rate, span by span.
#[derive(Debug)]
pub(crate) struct RateMeter {
    rate: Rate,
    since: Instant,
    scans: u32,
    failures: u32,
    /// Shortest time between the request of a scan and its arrival.
    quickest: Duration,
    revolution: Duration,
    /// Latest finished span since the link was found.
    span: Option<Span>,
    /// Number of spans since each of [`KINDS`] last occurred.
    spans_since: [u32; 3],
}

const KINDS: [Shortfall; 3] = [Shortfall::Line, Shortfall::Sensor, Shortfall::Loss];

/// Result of one span.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Span {
    /// Scans per second.
    pub(crate) reached: f64,
    /// Polls that failed.
    pub(crate) failed: u32,
    pub(crate) shortfall: Option<Shortfall>,
    pub(crate) baud_rate: Option<BaudRate>,
}

impl RateMeter {
    pub(crate) fn new(rate: Rate, now: Instant) -> Self {
        Self {
            rate,
            since: now,
            scans: 0,
            failures: 0,
            quickest: Duration::MAX,
            revolution: Duration::ZERO,
            span: None,
            spans_since: [SPANS_BETWEEN_REPORTS; 3],
        }
    }

    pub(crate) fn span(&self) -> Option<Span> {
        self.span
    }

    /// Counts a scan that came after `latency`, of a motor that takes `revolution` for one.
    pub(crate) fn count_scan(&mut self, latency: Duration, revolution: Duration) {
        self.scans += 1;
        self.quickest = self.quickest.min(latency);
        self.revolution = revolution;
    }

    pub(crate) fn count_failure(&mut self) {
        self.failures += 1;
    }

    /// Ends the span of polls of `window` if it is over, and returns it. `baud_rate` is the line's, if it has one.
    pub(crate) fn finish_span(
        &mut self,
        now: Instant,
        window: Window,
        baud_rate: Option<BaudRate>,
    ) -> Option<Span> {
        let span = now.saturating_duration_since(self.since);
        if span < RATE_SPAN {
            return None;
        }
        let reached = f64::from(self.scans) / span.as_secs_f64();
        let shortfall = match self.failures {
            _ if self.rate.is_reached_by(reached) => None,
            0 => self.slowness(window, baud_rate),
            _ => Some(Shortfall::Loss),
        };
        self.span = Some(Span { reached, failed: self.failures, shortfall, baud_rate });
        self.restart(now);
        self.span
    }

    /// Returns what is too slow, even for the quickest reply: the line if the rate could be reached
    /// without it, or if it takes longer than the sensor.
    fn slowness(&self, window: Window, baud_rate: Option<BaudRate>) -> Option<Shortfall> {
        let wire_time = baud_rate.map(|baud_rate| window.wire_time(baud_rate));
        let wire_time = wire_time.unwrap_or_default();
        let can_reach = |each: Duration| self.rate.is_reached_by(1.0 / each.as_secs_f64());
        let quickest = self.quickest.max(self.revolution);
        let without_line = quickest.saturating_sub(wire_time).max(self.revolution);
        match can_reach(quickest) {
            true => None,
            false if can_reach(without_line) || wire_time > without_line => Some(Shortfall::Line),
            false => Some(Shortfall::Sensor),
        }
    }

    /// Returns true if a span falls short for a reason that did not occur within the last
    /// [`SPANS_BETWEEN_REPORTS`].
    pub(crate) fn is_news(&mut self, span: Span) -> bool {
        let mut is_news = false;
        for (kind, since) in KINDS.into_iter().zip(&mut self.spans_since) {
            if span.shortfall == Some(kind) {
                is_news = *since >= SPANS_BETWEEN_REPORTS;
                *since = 0;
            } else {
                *since = since.saturating_add(1);
            }
        }
        is_news
    }

    /// Forgets the latest span, because the link is lost.
    pub(crate) fn clear(&mut self) {
        self.span = None;
    }

    /// Starts a new span.
    pub(crate) fn restart(&mut self, now: Instant) {
        (self.since, self.scans, self.failures) = (now, 0, 0);
        self.quickest = Duration::MAX;
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn window() -> Window {
        Window::new(0..=384).unwrap()
    }

    fn at(rate: Rate) -> RateMeter {
        RateMeter::new(rate, Instant::now())
    }

    #[test]
    fn a_shortfall_is_reported_once_each_time() {
        let mut meter = at(Rate::hz(10.0));
        let mut is_news =
            |shortfall| meter.is_news(Span { reached: 5.0, failed: 0, shortfall, baud_rate: None });
        let slow = Some(Shortfall::Line);
        assert_eq!([is_news(slow), is_news(slow)], [true, false]);
        let loss = Some(Shortfall::Loss);
        assert_eq!([is_news(loss), is_news(loss)], [true, false]);
        assert!((0..20).all(|_| !is_news(None)));
        assert!(is_news(slow));
    }

    #[test]
    fn a_span_blames_what_it_has_evidence_for() {
        let [quick, slow] = [80, 120].map(Duration::from_millis);
        let revolution = Duration::from_millis(100);
        // A reply takes 69 and 11 ms.
        let (usb, line, fast_line) = (None, Some(BaudRate::B115200), Some(BaudRate::B750000));
        for (scans, took, baud_rate, failures, expected) in [
            (30, slow, usb, 0, None),
            (29, slow, usb, 1, None),
            (25, slow, usb, 0, Some(Shortfall::Sensor)),
            (25, slow, line, 0, Some(Shortfall::Line)),
            (25, slow, fast_line, 0, Some(Shortfall::Sensor)),
            // A busy computer sends polls late.
            (25, quick, usb, 0, None),
            (25, slow, usb, 5, Some(Shortfall::Loss)),
        ] {
            let mut meter = at(Rate::hz(10.0));
            (0..scans).for_each(|_| meter.count_scan(took, revolution));
            (0..failures).for_each(|_| meter.count_failure());
            let since = meter.since;
            assert_eq!(meter.finish_span(since + Duration::from_millis(2999), window(), usb), None);
            let span = meter.finish_span(since + RATE_SPAN, window(), baud_rate).unwrap();
            assert_eq!(span.shortfall, expected, "{scans} {took:?} {failures}");
            assert_eq!(span.failed, failures);
        }
        let mut faster = at(Rate::hz(20.0));
        (0..30).for_each(|_| faster.count_scan(quick, revolution));
        let span = faster.finish_span(faster.since + RATE_SPAN, window(), fast_line).unwrap();
        assert_eq!(span.shortfall, Some(Shortfall::Sensor), "the motor turns no faster");
    }
}
