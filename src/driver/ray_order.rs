//! [`RayOrder`]: begins each scan after the last ray of the scan before.
//!
//! A late reply makes late stamps. The next scan, in time, would begin before the late one has ended,
//! which no motor can do; Cartographer drops such points. So its stamps become later, too.

use std::time::Duration;

use tokio::time::Instant;

use crate::scan::Scan;

/// Tenths of the nominal revolution that a revolution takes at least.
const SHORTEST_REVOLUTION: u64 = 9;

/// Latest ray of a link. Its scans are in the order of their polls.
#[derive(Debug, Default)]
pub(crate) struct RayOrder {
    /// When the latest poll was sent, and the earliest time of the next scan's first ray.
    latest: Option<(Instant, Instant)>,
    /// Sensor's clock of the latest scan, if it tells.
    clock: Option<u32>,
    /// Nanoseconds by which scans have come faster than the motor turns.
    ahead: u64,
}

impl RayOrder {
    /// Makes the stamps of a scan later if it would begin before the latest ray. A sensor that answers
    /// faster than its motor turns shows a revolution twice: then scans overlap.
    pub(crate) fn arrange(&mut self, scan: &mut Scan) {
        if scan.meta.sensor_clock.is_some() && self.is_out_of_order(scan) {
            return;
        }
        let mut first_ray = scan.first_ray_at();
        if let Some((requested, earliest)) = self.latest {
            let since = nanos(scan.meta.requested_at.saturating_duration_since(requested));
            let revolution = nanos(scan.scan_time());
            let ahead = self.ahead + revolution / 10 * SHORTEST_REVOLUTION;
            self.ahead = ahead.saturating_sub(since).min(3 * revolution);
            if self.ahead <= 2 * revolution && first_ray < earliest {
                first_ray = scan.postpone(earliest);
            }
        }
        // An increment after the last ray.
        let window = scan.window();
        let swept = window.points() as u32 * u32::from(window.cluster_count());
        self.latest = Some((scan.meta.requested_at, first_ray + scan.turn_time(2 * swept)));
    }

    /// Returns true for another window of the latest revolution, and for a scan of a stream that is
    /// older than one that was asked for.
    #[cold]
    fn is_out_of_order(&mut self, scan: &Scan) -> bool {
        let clock = scan.meta.sensor_clock;
        self.latest.is_some_and(|(requested, _)| scan.meta.requested_at < requested)
            || std::mem::replace(&mut self.clock, clock) == clock
    }
}

/// Cheaper to reckon with than a [`Duration`]. Overflows after 584 years.
fn nanos(time: Duration) -> u64 {
    time.as_nanos() as u64
}
