//! Counters of the messages on one topic, for diagnostics.

use std::time::Instant;

use parking_lot::Mutex;

/// Counters that any thread updates.
pub(crate) type Counts = Mutex<Counted>;

/// Published, dropped and lost messages.
#[derive(Debug, Clone, Default)]
pub(crate) struct Counted {
    /// Number of messages passed to the network.
    pub(super) published: u64,
    /// When the last message was passed to the network.
    pub(super) last_published: Option<Instant>,
    /// Number of messages dropped because the network was away or too slow.
    pub(super) dropped: u64,
    /// Number of messages in transit when the network was lost. Some of them may have arrived.
    pub(super) possibly_lost: u64,
    /// Number of readers, if the engine knows it.
    pub(super) readers: Option<usize>,
    /// Number of times that the engine was opened again.
    pub(super) restarts: u64,
}

impl Counted {
    pub(super) fn add_published(&mut self) {
        self.published += 1;
        self.last_published = Some(Instant::now());
    }
}
