//! The engine that carries messages, whichever it is: its settings, what it must
//! be able to do, and the [`Outlet`] that publishes through it from any task and
//! never waits.

use std::net::IpAddr;
use std::sync::{Arc, PoisonError, RwLock};

use clap::ValueEnum;

use super::counts::ScanCounts;

/// The engines that this program knows, built in or not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum EngineName {
    /// DDS, as ROS 2 uses it by default (feature `ros2`)
    Dds,
    /// zenoh, as `rmw_zenoh` uses it (feature `zenoh`)
    Zenoh,
}

/// The delivery that readers can ask for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Qos {
    /// Lost messages are sent again; serves every reader
    Reliable,
    /// Lost messages are not sent again; serves only best-effort readers
    Sensor,
}

/// The way into a zenoh network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Mode {
    /// Everything goes through the router
    Client,
    /// Readers are reached without the router, once it has introduced them
    Peer,
}

/// Settings of an engine. One that has no use for a setting ignores it.
#[derive(Debug, Clone)]
pub(crate) struct EngineSettings {
    pub(crate) domain: u16,
    pub(crate) qos: Qos,
    /// Messages that are kept for a reader that missed them.
    pub(crate) depth: usize,
    /// The only local address to use; all of them without it.
    pub(crate) interface: Option<IpAddr>,
    #[cfg_attr(not(feature = "zenoh"), expect(dead_code, reason = "only zenoh has a router"))]
    pub(crate) router: String,
    #[cfg_attr(not(feature = "zenoh"), expect(dead_code, reason = "only zenoh has a router"))]
    pub(crate) mode: Mode,
}

/// A node to be: its names, and its read-only parameters.
#[derive(Debug, Clone)]
pub(crate) struct NodeSpec {
    /// Absolute, `/` for none.
    pub(crate) namespace: String,
    pub(crate) name: String,
    /// The absolute name of the topic of its scans.
    pub(crate) scan_topic: String,
    #[cfg_attr(not(feature = "ros2"), expect(dead_code, reason = "only DDS has parameters"))]
    pub(crate) parameters: Vec<(&'static str, ParameterValue)>,
}

/// The value of a parameter.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum ParameterValue {
    Integer(i64),
    Float(f64),
    Text(String),
}

/// The topic of the diagnostics of all nodes.
pub(super) const DIAGNOSTICS_TOPIC: &str = "/diagnostics";

/// An open engine.
pub(super) trait Engine: Sized {
    /// Opens the engine with a publisher of each topic of each node, which counts its
    /// scans. Blocks. Fails if the network is not there (yet).
    fn open(
        settings: &EngineSettings,
        nodes: &[NodeSpec],
        counts: &[Arc<ScanCounts>],
    ) -> Result<(Self, Vec<NodePublishers>), String>;

    /// Returns a line for the user if some readers cannot be reached: why, and what
    /// becomes of the scans. May block for some seconds.
    fn unreachable(&mut self) -> Option<String>;

    /// Returns true if the network has changed so that the engine uses it only after it
    /// was opened again.
    fn is_outdated(&self) -> bool {
        false
    }

    /// Takes the nodes out of the graph, and ends. Blocks. The publishers are gone
    /// by then.
    fn close(self);
}

/// Publishes messages on one topic.
pub(super) trait Publish: Send + Sync {
    /// Publishes an encoded message, or drops it, and counts which. Does not block.
    fn publish(&self, message: Vec<u8>);
}

/// The publishers of one node.
pub(super) struct NodePublishers {
    pub(super) scans: Box<dyn Publish>,
    pub(super) diagnostics: Box<dyn Publish>,
}

/// The publishers of all nodes, in order; `None` before the engine reaches the
/// network, and after the end.
pub(super) type Shared = Arc<RwLock<Option<Vec<NodePublishers>>>>;

/// One node's way to the network. Messages for which there is no network are
/// dropped: an old scan is of no use.
#[derive(Clone)]
pub(crate) struct Outlet {
    node: usize,
    publishers: Shared,
    counts: Arc<ScanCounts>,
}

impl Outlet {
    /// Returns an outlet of the node at this place, which counts the scans that have no
    /// publisher.
    pub(super) fn new(node: usize, publishers: &Shared, counts: Arc<ScanCounts>) -> Self {
        Self { node, publishers: Arc::clone(publishers), counts }
    }

    /// Publishes an encoded `sensor_msgs/msg/LaserScan`.
    pub(crate) fn publish_scan(&self, message: Vec<u8>) {
        if !self.publish(message, |node| &node.scans) {
            self.counts.add_dropped();
        }
    }

    /// Publishes an encoded `diagnostic_msgs/msg/DiagnosticArray`.
    pub(crate) fn publish_diagnostics(&self, message: Vec<u8>) {
        self.publish(message, |node| &node.diagnostics);
    }

    /// Returns false if there is no publisher.
    fn publish(
        &self,
        message: Vec<u8>,
        topic: impl FnOnce(&NodePublishers) -> &Box<dyn Publish>,
    ) -> bool {
        let publishers = self.publishers.read().unwrap_or_else(PoisonError::into_inner);
        let node = publishers.as_ref().and_then(|nodes| nodes.get(self.node));
        node.is_some_and(|node| {
            topic(node).publish(message);
            true
        })
    }

    /// Returns the counts of scans so far.
    pub(crate) fn counts(&self) -> &ScanCounts {
        &self.counts
    }
}
