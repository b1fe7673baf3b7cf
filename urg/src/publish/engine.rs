//! Interface of an engine, its settings, and the [`Outlet`] that publishes through it from any
//! task without waiting.

use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::SystemTime;

use clap::ValueEnum;
use tokio_scip::ros::{self, Transform};

use super::counts::ScanCounts;
use super::discovery::Discovery;

/// Engines, whether built in or not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum EngineName {
    /// DDS, as ROS 2 uses it by default (feature `ros2`)
    Dds,
    /// zenoh, as `rmw_zenoh` uses it (feature `zenoh`)
    Zenoh,
    /// WebSocket server for Foxglove and Lichtblick (feature `foxglove`)
    Foxglove,
}

/// Delivery that the publisher offers to readers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Qos {
    /// Resends lost messages; serves every reader
    Reliable,
    /// Does not resend lost messages; serves only best-effort readers
    Sensor,
}

/// Zenoh session mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Mode {
    /// Sends everything through the router
    Client,
    /// Sends directly to readers, which the router introduces
    Peer,
}

/// Settings of all engines. An engine ignores settings that do not apply to it.
#[derive(Debug, Clone)]
pub(crate) struct EngineSettings {
    #[cfg_attr(
        not(any(feature = "ros2", feature = "zenoh")),
        expect(dead_code, reason = "only a network of ROS has domains")
    )]
    pub(crate) domain: u16,
    #[cfg_attr(
        not(any(feature = "ros2", feature = "zenoh")),
        expect(dead_code, reason = "only a network of ROS has QoS")
    )]
    pub(crate) qos: Qos,
    /// Number of messages kept for readers that missed some.
    pub(crate) depth: usize,
    /// Static transforms of the sensors. Late readers get them too.
    pub(crate) transforms: Vec<Transform>,
    /// Only local address to use. Default: all.
    pub(crate) interface: Option<IpAddr>,
    #[cfg_attr(not(feature = "ros2"), expect(dead_code, reason = "only DDS looks for readers"))]
    pub(crate) discovery: Discovery,
    #[cfg_attr(not(feature = "zenoh"), expect(dead_code, reason = "only zenoh has a router"))]
    pub(crate) router: String,
    #[cfg_attr(not(feature = "zenoh"), expect(dead_code, reason = "only zenoh has a router"))]
    pub(crate) mode: Mode,
    #[cfg_attr(not(feature = "foxglove"), expect(dead_code, reason = "only Foxglove listens"))]
    pub(crate) listen: SocketAddr,
}

impl EngineSettings {
    /// Encodes the static transforms, if there are any.
    pub(super) fn static_transforms(&self) -> Option<Vec<u8>> {
        let mut message = Vec::new();
        ros::write_transforms(&mut message, SystemTime::now(), &self.transforms);
        (!self.transforms.is_empty()).then_some(message)
    }
}

/// Names of a ROS node to create.
#[derive(Debug, Clone)]
pub(crate) struct NodeSpec {
    /// Absolute; `/` if there is no namespace.
    pub(crate) namespace: String,
    pub(crate) name: String,
    /// Absolute name of the scan topic.
    pub(crate) scan_topic: String,
}

/// Diagnostics topic, shared by all nodes.
pub(super) const DIAGNOSTICS_TOPIC: &str = "/diagnostics";

/// Topic for the static transforms of all sensors. Published by the first node.
pub(super) const STATIC_TRANSFORMS_TOPIC: &str = "/tf_static";

/// Condition of an open engine.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Health {
    /// The engine delivers messages.
    Works,
    /// The engine cannot reach some readers. The line tells the user what happens to the scans.
    #[cfg_attr(
        not(any(feature = "ros2", feature = "zenoh")),
        expect(dead_code, reason = "only a network of ROS has readers to reach")
    )]
    Unreachable(String),
    /// The network has changed. The engine has to be reopened to use it.
    #[cfg_attr(not(feature = "ros2"), expect(dead_code, reason = "only DDS forgets readers"))]
    Outdated,
    /// The engine has stopped working, for this reason, and has to be reopened.
    Dead(String),
}

/// Open engine.
pub(super) trait Engine: Sized + Send + 'static {
    /// What an engine leaves to the one that is opened after it.
    type Memory: Default;

    /// Opens the engine with publishers for each node, which count their scans in `counts`.
    /// Blocks. The error explains why the network is unavailable; the caller retries.
    fn open(
        settings: &EngineSettings,
        nodes: &[NodeSpec],
        counts: &[Arc<ScanCounts>],
        memory: &Self::Memory,
    ) -> Result<(Self, Vec<NodePublishers>), String>;

    /// Checks from outside whether the engine works. Called at regular intervals. May block for
    /// a few seconds.
    fn look(&mut self) -> Health;

    /// Removes the nodes from the ROS graph, and stops the engine. Blocks. The caller drops the
    /// publishers first.
    fn close(self);
}

/// Publisher of one topic.
pub(super) trait MessagePublisher: Send + Sync {
    /// Publishes or drops an encoded message, and counts the outcome. Does not block.
    fn publish(&self, message: Vec<u8>);
}

/// Publishers of one node.
pub(super) struct NodePublishers {
    pub(super) scans: Box<dyn MessagePublisher>,
    pub(super) diagnostics: Box<dyn MessagePublisher>,
}

/// Publishers of all nodes, in order; `None` while the engine is not open.
pub(super) type Shared = Arc<RwLock<Option<Vec<NodePublishers>>>>;

/// Publisher of one node that survives reopening of the engine. Drops messages while the engine
/// is not open: old scans are useless.
#[derive(Clone)]
pub(crate) struct Outlet {
    node: usize,
    publishers: Shared,
    counts: Arc<ScanCounts>,
}

impl Outlet {
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

    /// Returns false if the engine is not open.
    fn publish(
        &self,
        message: Vec<u8>,
        topic: impl FnOnce(&NodePublishers) -> &Box<dyn MessagePublisher>,
    ) -> bool {
        let publishers = self.publishers.read().unwrap_or_else(PoisonError::into_inner);
        let node = publishers.as_ref().and_then(|nodes| nodes.get(self.node));
        node.is_some_and(|node| {
            topic(node).publish(message);
            true
        })
    }

    pub(crate) fn counts(&self) -> &ScanCounts {
        &self.counts
    }
}
