//! Interface of an engine, its settings and topics, and the [`Outlet`] that publishes through it
//! from any task without waiting.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::SystemTime;

use clap::ValueEnum;
use parking_lot::RwLock;
use urg_recording::ros::{self, MessageType, Transform};

use super::counts::Counts;
use super::discovery::Discovery;
use super::names::NodeNames;

/// Number of diagnostics kept for readers that missed some.
const DIAGNOSTICS_DEPTH: usize = 10;

/// Topics of every node, in their order.
#[derive(Debug, Clone, Copy)]
pub(crate) enum NodeTopic {
    Scans,
    Diagnostics,
}

/// Engines, whether built in or not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum EngineName {
    /// DDS, as ROS 2 uses it by default (feature `dds`)
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
#[derive(Debug)]
pub(crate) struct EngineSettings {
    /// ROS nodes to create, one per sensor.
    pub(crate) nodes: Vec<NodeNames>,
    pub(crate) domain: u16,
    pub(crate) qos: Qos,
    /// Number of scans kept for readers that missed some.
    pub(crate) depth: usize,
    /// Static transforms of the sensors. Late readers get them too.
    pub(crate) transforms: Vec<Transform>,
    /// Only local address to use. Default: all.
    pub(crate) interface: Option<IpAddr>,
    pub(crate) discovery: Discovery,
    pub(crate) router: String,
    pub(crate) mode: Mode,
    pub(crate) listen: SocketAddr,
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
    /// Whether late readers get the last message (transient local).
    pub(super) is_kept: bool,
    pub(super) counts: Arc<Counts>,
}

impl Topic {
    pub(super) fn has_scans(&self) -> bool {
        self.message == MessageType::LASER_SCAN
    }

    /// Depth and counters of the topic in a queue.
    pub(super) fn queue(&self) -> (usize, Arc<Counts>) {
        (self.depth, Arc::clone(&self.counts))
    }
}

impl EngineSettings {
    /// Lists the topics: scans and diagnostics of each node in turn, then the static transforms
    /// of all sensors, if there are any, as a topic of the first node.
    pub(super) fn topics(&self) -> Vec<Topic> {
        let topic = |node, name: &str, message| Topic {
            node,
            name: name.to_owned(),
            message,
            qos: Qos::Reliable,
            depth: 1,
            is_kept: false,
            counts: Arc::default(),
        };
        let mut topics = Vec::new();
        for (node, names) in self.nodes.iter().enumerate() {
            let scans = topic(node, &names.topic, MessageType::LASER_SCAN);
            topics.push(Topic { qos: self.qos, depth: self.depth, ..scans });
            let diagnostics = topic(node, "/diagnostics", MessageType::DIAGNOSTIC_ARRAY);
            topics.push(Topic { depth: DIAGNOSTICS_DEPTH, ..diagnostics });
        }
        if !self.transforms.is_empty() {
            let transforms = topic(0, "/tf_static", MessageType::TF_MESSAGE);
            topics.push(Topic { is_kept: true, ..transforms });
        }
        topics
    }

    /// Encodes the static transforms, the only message of a topic that is kept.
    pub(super) fn static_transforms(&self) -> Vec<u8> {
        let mut message = Vec::new();
        ros::write_transforms(&mut message, SystemTime::now(), &self.transforms);
        message
    }
}

/// Why an open engine has to be reopened.
#[derive(Debug)]
pub(super) enum Reopen {
    /// The engine works, but some readers get no scans, for this reason.
    Outdated(String),
    /// The same, but the reason may come back at once: it is not reopened too often.
    Wanted(String),
    /// The engine has stopped working, for this reason.
    Dead(String),
}

/// Why an engine cannot be opened.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Unavailable {
    /// It may open later.
    Now(String),
    Permanently(String),
}

impl From<String> for Unavailable {
    fn from(why: String) -> Self {
        Self::Now(why)
    }
}

pub(super) trait Engine: Send {
    /// Opens the engine. Blocks.
    fn open(settings: &Arc<EngineSettings>, topics: &Arc<[Topic]>) -> OpenedEngine
    where
        Self: Sized;

    /// Whether another engine may be opened while this one hangs in `close`.
    fn may_overlap(&self) -> bool {
        false
    }

    /// Checks from outside whether the engine works. Called at regular intervals. May block for
    /// a few seconds. If it cannot reach some readers, returns a line that tells the user what
    /// happens to the scans.
    fn check(&mut self) -> Result<Option<String>, Reopen>;

    /// Removes the nodes from the ROS graph, and stops the engine. Blocks. The caller drops the
    /// publisher first.
    fn close(self: Box<Self>);
}

pub(super) trait Publisher: Send + Sync {
    /// Publishes or drops an encoded message on the topic with this index, and counts the
    /// outcome. Does not block.
    fn publish(&self, topic: usize, message: Vec<u8>);
}

/// Engine that was opened, and its publisher.
pub(super) type Opened = (Box<dyn Engine>, Arc<dyn Publisher>);

pub(super) type OpenedEngine = Result<Opened, Unavailable>;

/// Publisher of the engine; `None` while it is not open.
pub(super) type Shared = Arc<RwLock<Option<Arc<dyn Publisher>>>>;

/// Publisher of one node that survives reopening of the engine. Drops messages while the engine
/// is not open: old scans are useless.
#[derive(Clone)]
pub(crate) struct Outlet {
    node: usize,
    publisher: Shared,
    counts: Arc<Counts>,
}

impl Outlet {
    pub(super) fn new(node: usize, publisher: &Shared, counts: &Arc<Counts>) -> Self {
        Self { node, publisher: Arc::clone(publisher), counts: Arc::clone(counts) }
    }

    /// Publishes an encoded message on one of the node's topics.
    pub(crate) fn publish(&self, topic: NodeTopic, message: Vec<u8>) {
        match (&*self.publisher.read(), topic) {
            (Some(publisher), _) => publisher.publish(2 * self.node + topic as usize, message),
            (None, NodeTopic::Scans) => self.counts.lock().dropped += 1,
            (None, NodeTopic::Diagnostics) => {}
        }
    }

    pub(crate) fn counts(&self) -> &Counts {
        &self.counts
    }
}
