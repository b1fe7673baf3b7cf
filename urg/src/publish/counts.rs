//! Counters of one node's scans, for diagnostics.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// Counters of published, dropped and lost scans, updated from any thread.
#[derive(Debug, Default)]
pub(crate) struct ScanCounts {
    published: AtomicU64,
    dropped: AtomicU64,
    possibly_lost: AtomicU64,
    /// Number of readers plus one; zero means unknown.
    readers: AtomicU64,
    restarts: AtomicU64,
    last_published: Mutex<Option<Instant>>,
}

impl ScanCounts {
    #[cfg_attr(
        not(any(feature = "ros2", feature = "zenoh", feature = "foxglove")),
        expect(dead_code, reason = "without an engine nothing is published")
    )]
    pub(super) fn add_published(&self) {
        self.published.fetch_add(1, Ordering::Relaxed);
        *self.last_published.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
    }

    pub(super) fn add_dropped(&self) {
        self.dropped.fetch_add(1, Ordering::Relaxed);
    }

    #[cfg_attr(not(feature = "zenoh"), expect(dead_code, reason = "only zenoh has a router"))]
    pub(super) fn add_possibly_lost(&self, scans: u64) {
        self.possibly_lost.fetch_add(scans, Ordering::Relaxed);
    }

    #[cfg_attr(not(feature = "ros2"), expect(dead_code, reason = "only DDS knows its readers"))]
    pub(super) fn set_readers(&self, readers: usize) {
        self.readers.store(readers as u64 + 1, Ordering::Relaxed);
    }

    pub(super) fn add_restart(&self) {
        self.restarts.fetch_add(1, Ordering::Relaxed);
    }

    /// Number of readers, if the engine knows it.
    pub(super) fn readers(&self) -> Option<u64> {
        self.readers.load(Ordering::Relaxed).checked_sub(1)
    }

    /// Number of restarts of a dead engine.
    pub(super) fn restarts(&self) -> u64 {
        self.restarts.load(Ordering::Relaxed)
    }

    /// Time of the last scan passed to the network.
    pub(super) fn last_published(&self) -> Option<Instant> {
        *self.last_published.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of scans passed to the network.
    pub(super) fn published(&self) -> u64 {
        self.published.load(Ordering::Relaxed)
    }

    /// Number of scans dropped because the network was away or too slow.
    pub(super) fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Number of scans in transit when the network was lost. Some of them may have arrived.
    pub(super) fn possibly_lost(&self) -> u64 {
        self.possibly_lost.load(Ordering::Relaxed)
    }
}
