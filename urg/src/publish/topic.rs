//! Topics of a node, and what was published on them.

use std::sync::Arc;
use std::time::Instant;

use clap::ValueEnum;
use parking_lot::Mutex;
use urg_recording::ros::MessageType;

/// Delivery that the publisher offers to readers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Qos {
    /// Resends lost messages; serves every reader
    Reliable,
    /// Does not resend lost messages; serves only best-effort readers
    Sensor,
}

/// Topic of one node. Several nodes may publish on a topic of the same name.
#[derive(Debug)]
pub(super) struct Topic {
    pub(super) node: usize,
    /// Absolute.
    pub(super) name: String,
    pub(super) message: MessageType,
    pub(super) qos: Qos,
    pub(super) depth: usize,
    /// Only message of the topic, which late readers get too (transient local). It is published
    /// again at regular intervals, because only DDS keeps it.
    pub(super) kept: Option<Vec<u8>>,
    pub(super) counts: Arc<Counts>,
}

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

impl Topic {
    pub(super) fn new(node: usize, name: &str, message: MessageType, depth: usize) -> Self {
        let (qos, kept, counts) = (Qos::Reliable, None, Arc::default());
        Self { node, name: name.to_owned(), message, qos, depth, kept, counts }
    }
}
