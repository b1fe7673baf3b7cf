//! [`RateMeter`]: the rate that a schedule reaches. Tells whether a shortfall comes from
//! the link's capacity or from failures.

use std::time::Duration;

use tokio::time::Instant;

use crate::BaudRate;
use crate::stats::{ScheduleStats, Shortfall};

/// Span to average the rate over.
const RATE_SPAN: Duration = Duration::from_secs(3);
/// Number of spans without a shortfall (a minute) before it is reported again.
const SPANS_BETWEEN_REPORTS: u32 = 20;

/// Measures the achieved rate, span by span.
#[derive(Debug)]
pub(crate) struct RateMeter {
    since: Instant,
    /// Number of scans after the one that began the span, or `None` before that one.
    scans: Option<u32>,
    failures: u32,
    /// Shortest time between the request of a scan and its arrival.
    quickest: Duration,
    revolution: Duration,
    /// Number of spans since each of [`KINDS`] last occurred.
    spans_since: [u32; 3],
}

const KINDS: [Shortfall; 3] = [Shortfall::Line, Shortfall::Sensor, Shortfall::Loss];

impl RateMeter {
    pub(crate) fn new(now: Instant) -> Self {
        Self {
            since: now,
            scans: None,
            failures: 0,
            quickest: Duration::MAX,
            revolution: Duration::ZERO,
            spans_since: [SPANS_BETWEEN_REPORTS; 3],
        }
    }

    /// Counts a scan that came at `now` after `latency`, of a motor that takes `revolution` for one.
    pub(crate) fn count_scan(&mut self, now: Instant, latency: Duration, revolution: Duration) {
        self.since = self.scans.map_or(now, |_| self.since);
        self.scans = Some(self.scans.map_or(0, |scans| scans + 1));
        self.quickest = self.quickest.min(latency);
        self.revolution = revolution;
    }

    pub(crate) fn count_failure(&mut self) {
        self.failures += 1;
    }

    /// If the span is over, records it in `stats`, begins the next one and returns true.
    pub(crate) fn finish_span(
        &mut self,
        now: Instant,
        baud_rate: Option<BaudRate>,
        stats: &mut ScheduleStats,
    ) -> bool {
        let span = now.saturating_duration_since(self.since);
        if span < RATE_SPAN {
            return false;
        }
        let reached = f64::from(self.scans.unwrap_or(0)) / span.as_secs_f64();
        (stats.baud_rate, stats.revolution) = (baud_rate, self.revolution.as_secs_f32());
        stats.shortfall = match self.failures {
            _ if stats.rate.is_reached_by(reached) => None,
            0 => self.slowness(stats),
            _ => Some(Shortfall::Loss),
        };
        (stats.reached, stats.failed) = (Some(reached), self.failures);
        (self.since, self.scans, self.failures) = (now, self.scans.map(|_| 0), 0);
        self.quickest = Duration::MAX;
        true
    }

    /// Returns what is too slow, even for the quickest reply: the line if the rate could be reached
    /// without it, or if it takes longer than the sensor.
    fn slowness(&self, stats: &ScheduleStats) -> Option<Shortfall> {
        let window = &stats.window;
        let wire_time = stats.baud_rate.map(|rate| window.wire_time(rate, stats.protocol));
        let wire_time = wire_time.unwrap_or_default();
        let line_can = stats.baud_rate.is_none_or(|baud_rate| stats.carries(window, baud_rate));
        let can_reach = |each: Duration| stats.rate.is_reached_by(1.0 / each.as_secs_f64());
        let quickest = self.quickest.max(self.revolution);
        let without_line = quickest.saturating_sub(wire_time).max(self.revolution);
        match can_reach(quickest) && line_can {
            true => None,
            false if can_reach(without_line) || wire_time > without_line => Some(Shortfall::Line),
            false => Some(Shortfall::Sensor),
        }
    }

    /// True if the latest span falls short for a reason not seen in the last [`SPANS_BETWEEN_REPORTS`].
    pub(crate) fn is_news(&mut self, shortfall: Option<Shortfall>) -> bool {
        let mut is_news = false;
        for (kind, since) in KINDS.into_iter().zip(&mut self.spans_since) {
            if shortfall == Some(kind) {
                is_news = *since >= SPANS_BETWEEN_REPORTS;
                *since = 0;
            } else {
                *since = since.saturating_add(1);
            }
        }
        is_news
    }

    /// Starts anew with the next scan.
    pub(crate) fn restart(&mut self, now: Instant) {
        (self.since, self.scans, self.failures) = (now, None, 0);
        self.quickest = Duration::MAX;
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::{Rate, Window};

    #[test]
    fn a_span_blames_what_it_has_evidence_for() {
        let [quick, slow] = [80, 120].map(Duration::from_millis);
        let revolution = Duration::from_millis(100);
        // A reply takes 69 and 11 ms.
        let window = Window::new(0..=384).unwrap();
        let (usb, line, fast_line) = (None, Some(BaudRate::B115200), Some(BaudRate::B750000));
        for (rate, scans, took, baud_rate, failures, expected) in [
            (10.0, 30, slow, usb, 0, None),
            (10.0, 29, slow, usb, 1, None),
            (10.0, 25, slow, usb, 0, Some(Shortfall::Sensor)),
            (10.0, 25, slow, line, 0, Some(Shortfall::Line)),
            (10.0, 25, slow, fast_line, 0, Some(Shortfall::Sensor)),
            // A busy computer sends polls late.
            (10.0, 25, quick, usb, 0, None),
            (10.0, 25, slow, usb, 5, Some(Shortfall::Loss)),
            // The motor turns no faster.
            (20.0, 30, quick, fast_line, 0, Some(Shortfall::Sensor)),
        ] {
            let (mut meter, mut stats) =
                (RateMeter::new(Instant::now()), ScheduleStats::new(window, Rate::hz(rate)));
            (0..=scans).for_each(|_| meter.count_scan(meter.since, took, revolution));
            (0..failures).for_each(|_| meter.count_failure());
            let end = meter.since + RATE_SPAN;
            assert!(!meter.finish_span(end - Duration::from_millis(1), usb, &mut stats));
            assert!(meter.finish_span(end, baud_rate, &mut stats));
            assert_eq!(stats.shortfall, expected, "{scans} {took:?} {failures}");
            assert_eq!(stats.failed, failures);
        }
    }
}
