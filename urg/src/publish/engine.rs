//! Interface of an engine, its settings, and the [`Outlet`] that publishes through it
//! from any task without waiting.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::sync::mpsc::Sender;
use std::time::SystemTime;

use clap::ValueEnum;
use parking_lot::RwLock;
use urg_recording::ros::{self, MessageType, Transform};

use super::discovery::Discovery;
use super::names::NodeNames;
use super::send_queue::SendQueue;
use super::topic::{Counts, Qos, Topic};

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

impl EngineSettings {
    /// Lists the topics: scans and diagnostics of each node in turn, then the static transforms
    /// of all sensors, if there are any, as a topic of the first node.
    pub(super) fn topics(&self) -> Vec<Topic> {
        let mut topics = Vec::new();
        for (node, names) in self.nodes.iter().enumerate() {
            let scans = Topic::new(node, &names.topic, MessageType::LASER_SCAN, self.depth);
            topics.push(Topic { qos: self.qos, ..scans });
            let diagnostics = MessageType::DIAGNOSTIC_ARRAY;
            topics.push(Topic::new(node, "/diagnostics", diagnostics, DIAGNOSTICS_DEPTH));
        }
        if !self.transforms.is_empty() {
            let mut message = Vec::new();
            ros::write_transforms(&mut message, SystemTime::now(), &self.transforms);
            let transforms = Topic::new(0, "/tf_static", MessageType::TF_MESSAGE, 1);
            topics.push(Topic { kept: Some(message), ..transforms });
        }
        topics
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

/// Opens an engine, passes it to `opened`, and sends the messages of the queue until the queue is
/// closed and empty. Then removes the nodes from the ROS graph and closes the engine. Blocks.
pub(super) type Run = fn(&Arc<EngineSettings>, &Arc<SendQueue>, &Opened) -> Result<(), Unavailable>;

/// Receiver of an engine that is open, or of the reason why it cannot be opened.
pub(super) type Opened = Sender<Result<Box<dyn Engine>, Unavailable>>;

/// Open engine, as seen from outside the thread that sends.
pub(super) trait Engine: Send {
    /// Whether another engine may be opened while this one hangs as it closes.
    fn may_overlap(&self) -> bool {
        false
    }

    /// Checks whether the engine works. Called at regular intervals. May block for a few seconds. If it
    /// cannot reach some readers, returns a line that tells the user what happens to the scans.
    fn check(&mut self) -> Result<Option<String>, Reopen>;
}

/// Queue of the engine; `None` while it is not open.
pub(super) type Shared = Arc<RwLock<Option<Arc<SendQueue>>>>;

/// Publisher of one node that survives reopening of the engine. Drops messages while the engine
/// is not open: old scans are useless.
#[derive(Clone)]
pub(crate) struct Outlet {
    node: usize,
    queue: Shared,
    pub(super) counts: Arc<Counts>,
}

impl Outlet {
    pub(super) fn new(scans: &Topic, queue: &Shared) -> Self {
        Self { node: scans.node, queue: Arc::clone(queue), counts: Arc::clone(&scans.counts) }
    }

    /// Publishes an encoded message on one of the node's topics.
    pub(crate) fn publish(&self, topic: NodeTopic, message: Vec<u8>) {
        match (&*self.queue.read(), topic) {
            (Some(queue), _) => queue.publish(2 * self.node + topic as usize, message),
            (None, NodeTopic::Scans) => self.counts.lock().dropped += 1,
            (None, NodeTopic::Diagnostics) => {}
        }
    }
}
