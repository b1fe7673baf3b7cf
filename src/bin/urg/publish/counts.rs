//! [`ScanCounts`]: the number of scans of one node that were published, dropped, or lost on
//! the way.

use std::sync::atomic::{AtomicU64, Ordering};

/// Counters of scans. Whoever decides a scan's fate counts it, on any thread.
#[derive(Debug, Default)]
pub(crate) struct ScanCounts {
    published: AtomicU64,
    dropped: AtomicU64,
    possibly_lost: AtomicU64,
}

impl ScanCounts {
    /// Counts a scan that was passed to the network.
    #[cfg_attr(
        not(any(feature = "ros2", feature = "zenoh")),
        expect(dead_code, reason = "without an engine nothing is published")
    )]
    pub(super) fn add_published(&self) {
        self.published.fetch_add(1, Ordering::Relaxed);
    }

    /// Counts a scan that was dropped here.
    pub(super) fn add_dropped(&self) {
        self.dropped.fetch_add(1, Ordering::Relaxed);
    }

    /// Counts published scans that the network may not have delivered.
    #[cfg_attr(not(feature = "zenoh"), expect(dead_code, reason = "only zenoh has a router"))]
    pub(super) fn add_possibly_lost(&self, scans: u64) {
        self.possibly_lost.fetch_add(scans, Ordering::Relaxed);
    }

    /// Returns the number of scans that were passed to the network.
    pub(super) fn published(&self) -> u64 {
        self.published.load(Ordering::Relaxed)
    }

    /// Returns the number of scans that were dropped here: without a network, or because
    /// it was slower than the scans.
    pub(super) fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Returns the number of published scans that were under way when the network was
    /// lost. Some of them may have arrived.
    pub(super) fn possibly_lost(&self) -> u64 {
        self.possibly_lost.load(Ordering::Relaxed)
    }
}
