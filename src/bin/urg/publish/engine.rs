//! The engine that carries messages, whichever it is. A thread opens it, however
//! long that takes, watches whether it reaches the network, and closes it in good
//! order. An [`Outlet`] publishes from any task, and never waits.
//!
//! A thread, because opening and closing block, and because zenoh refuses both in
//! a tokio runtime of one thread.

use std::net::IpAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;

use clap::ValueEnum;
use tokio::runtime::Handle;
use tokio::sync::oneshot;

use crate::failure::Failure;
use crate::output::notice::notice;

/// The pause between two attempts to open an engine.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// The pause between two looks at an open engine.
const WATCH_INTERVAL: Duration = Duration::from_millis(500);

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
    pub(crate) router: String,
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
    pub(crate) parameters: Vec<(&'static str, ParameterValue)>,
}

/// The value of a parameter.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(not(feature = "ros2"), expect(dead_code, reason = "only DDS has parameters"))]
pub(crate) enum ParameterValue {
    Integer(i64),
    Float(f64),
    Text(String),
}

/// The topic of the diagnostics of all nodes.
pub(super) const DIAGNOSTICS_TOPIC: &str = "/diagnostics";

/// An open engine.
pub(super) trait Engine: Sized {
    /// Opens the engine with a publisher of each topic of each node. Blocks.
    /// Fails if the network is not there (yet).
    fn open(
        settings: &EngineSettings,
        nodes: &[NodeSpec],
        runtime: &Handle,
    ) -> Result<(Self, Vec<NodePublishers>), String>;

    /// Returns why nobody can be reached, if that is so.
    fn unreachable(&self) -> Option<String>;

    /// Takes the nodes out of the graph, and ends. Blocks. The publishers are gone
    /// by then.
    fn close(self);
}

/// Publishes messages on one topic.
pub(super) trait Publish: Send + Sync {
    /// Publishes an encoded message. Does not block; false if the engine did not
    /// take the message.
    fn publish(&self, message: Vec<u8>) -> bool;
}

/// The publishers of one node.
pub(super) struct NodePublishers {
    pub(super) scans: Box<dyn Publish>,
    pub(super) diagnostics: Box<dyn Publish>,
}

/// The publishers of all nodes, in order; `None` before the engine reaches the
/// network, and after the end.
type Shared = Arc<RwLock<Option<Vec<NodePublishers>>>>;

/// One node's way to the network. Messages for which there is no network are
/// dropped and counted: an old scan is of no use.
#[derive(Clone)]
pub(crate) struct Outlet {
    node: usize,
    publishers: Shared,
    counts: Arc<Counts>,
}

#[derive(Debug, Default)]
struct Counts {
    published: AtomicU64,
    dropped: AtomicU64,
}

impl Outlet {
    /// Publishes an encoded `sensor_msgs/msg/LaserScan`.
    pub(crate) fn publish_scan(&self, message: Vec<u8>) {
        let published = self.publish(message, |node| &node.scans);
        let count = if published { &self.counts.published } else { &self.counts.dropped };
        count.fetch_add(1, Ordering::Relaxed);
    }

    /// Publishes an encoded `diagnostic_msgs/msg/DiagnosticArray`.
    pub(crate) fn publish_diagnostics(&self, message: Vec<u8>) {
        self.publish(message, |node| &node.diagnostics);
    }

    fn publish(
        &self,
        message: Vec<u8>,
        topic: impl FnOnce(&NodePublishers) -> &Box<dyn Publish>,
    ) -> bool {
        let publishers = self.publishers.read().unwrap_or_else(PoisonError::into_inner);
        let node = publishers.as_ref().and_then(|nodes| nodes.get(self.node));
        node.is_some_and(|node| topic(node).publish(message))
    }

    /// Returns the number of scans that the engine took.
    pub(crate) fn published(&self) -> u64 {
        self.counts.published.load(Ordering::Relaxed)
    }

    /// Returns the number of scans that were dropped for want of a network.
    pub(crate) fn dropped(&self) -> u64 {
        self.counts.dropped.load(Ordering::Relaxed)
    }
}

/// An engine on its thread. Dropping it closes the engine without waiting.
#[derive(Debug)]
pub(crate) struct RunningEngine {
    /// Its end asks the thread to end.
    stop: mpsc::Sender<()>,
    ended: oneshot::Receiver<()>,
}

impl RunningEngine {
    /// Starts an engine, and returns an outlet for each node. Fails if this
    /// program was built without it.
    pub(crate) fn start(
        engine: EngineName,
        settings: EngineSettings,
        nodes: Vec<NodeSpec>,
    ) -> Result<(Self, Vec<Outlet>), Failure> {
        match engine {
            #[cfg(feature = "ros2")]
            EngineName::Dds => start::<super::dds::Dds>(settings, nodes),
            #[cfg(feature = "zenoh")]
            EngineName::Zenoh => start::<super::zenoh::Zenoh>(settings, nodes),
            #[cfg(not(feature = "ros2"))]
            EngineName::Dds => Err(not_built_in("dds", "ros2")),
            #[cfg(not(feature = "zenoh"))]
            EngineName::Zenoh => Err(not_built_in("zenoh", "zenoh")),
        }
    }

    /// Takes the nodes out of the graph, and waits for that.
    pub(crate) async fn close(self) {
        drop(self.stop);
        // An error, too, means that the thread has ended.
        let _ = self.ended.await;
    }
}

#[cfg(not(all(feature = "ros2", feature = "zenoh")))]
fn not_built_in(engine: &str, feature: &str) -> Failure {
    Failure::Usage(format!(
        "`--engine {engine}` needs an urg that was built with the feature `{feature}`: \
         `cargo install tokio-scip --features {feature}`"
    ))
}

fn start<E: Engine>(
    settings: EngineSettings,
    nodes: Vec<NodeSpec>,
) -> Result<(RunningEngine, Vec<Outlet>), Failure> {
    let publishers = Shared::default();
    let outlet =
        |node| Outlet { node, publishers: Arc::clone(&publishers), counts: Arc::default() };
    let outlets = (0..nodes.len()).map(outlet).collect();
    let (stop, stopped) = mpsc::channel();
    let (end, ended) = oneshot::channel();
    let runtime = Handle::current();
    std::thread::Builder::new()
        .name("engine".to_owned())
        .spawn(move || {
            run::<E>(&settings, &nodes, &publishers, &runtime, &stopped);
            let _ = end.send(());
        })
        .map_err(|error| Failure::of("cannot start the engine's thread", &error))?;
    Ok((RunningEngine { stop, ended }, outlets))
}

/// Runs an engine until it is stopped.
fn run<E: Engine>(
    settings: &EngineSettings,
    nodes: &[NodeSpec],
    shared: &Shared,
    runtime: &Handle,
    stop: &mpsc::Receiver<()>,
) {
    let stopped = |wait| !matches!(stop.recv_timeout(wait), Err(RecvTimeoutError::Timeout));
    let set = |publishers| {
        *shared.write().unwrap_or_else(PoisonError::into_inner) = publishers;
    };
    let mut network = Network::default();
    let (engine, publishers) = loop {
        match E::open(settings, nodes, runtime) {
            Ok(opened) => break opened,
            Err(why) => network.report(Some(why)),
        }
        if stopped(RETRY_INTERVAL) {
            return;
        }
    };
    set(Some(publishers));
    loop {
        network.report(engine.unreachable());
        if stopped(WATCH_INTERVAL) {
            break;
        }
    }
    set(None);
    engine.close();
}

/// Reports the loss of the network once, and its return.
#[derive(Debug, Default)]
struct Network {
    away: bool,
}

impl Network {
    fn report(&mut self, unreachable: Option<String>) {
        let away = unreachable.is_some();
        match (self.away, unreachable) {
            (false, Some(why)) => {
                notice(format_args!("{why}; waiting for it, scans are dropped until then"));
            }
            (true, None) => notice("the network is back: scans are published"),
            (true, Some(_)) | (false, None) => {}
        }
        self.away = away;
    }
}
