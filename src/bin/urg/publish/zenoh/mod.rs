//! zenoh as `rmw_zenoh` speaks it: one session, and for each node a liveliness
//! token that puts it into the ROS graph, and one for each of its topics. `graph`
//! writes their keys, `sender` sends messages, as many as `send_queue` keeps, and
//! `router` watches the router.

mod graph;
mod router;
mod send_queue;
mod sender;

use std::sync::Arc;

use tokio_scip::ros::MessageType;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::CongestionControl;
use zenoh::{Config, Session, Wait};

use self::graph::{GraphNode, Topic, gid};
use self::router::InTransit;
use self::sender::Sender;
use super::counts::ScanCounts;
use super::engine::{
    DIAGNOSTICS_TOPIC, Engine, EngineSettings, Mode, NodePublishers, NodeSpec, Publish, Qos,
};

/// Diagnostics that a reader is asked to keep.
const DIAGNOSTICS_DEPTH: usize = 10;

/// The setting of how long a put waits for room, in microseconds.
const WAIT_BEFORE_DROP: &str = "transport/link/tx/queue/congestion_control/drop/wait_before_drop";

/// A session with the tokens of its nodes.
pub(super) struct Zenoh {
    session: Session,
    tokens: Vec<LivelinessToken>,
    sender: Sender,
    in_transit: Vec<InTransit>,
    router: String,
    mode: Mode,
}

impl Engine for Zenoh {
    fn open(
        settings: &EngineSettings,
        specs: &[NodeSpec],
        counts: &[Arc<ScanCounts>],
    ) -> Result<(Self, Vec<NodePublishers>), String> {
        let config = config(settings).map_err(|error| format!("cannot set up zenoh: {error}"))?;
        let session = zenoh::open(config)
            .wait()
            .map_err(|_| format!("no zenoh router answers at {}", settings.router))?;
        let depths = specs.iter().flat_map(|_| [settings.depth, DIAGNOSTICS_DEPTH]);
        let mut zenoh = Self {
            session,
            tokens: Vec::new(),
            sender: Sender::start(depths)?,
            in_transit: counts.iter().map(|counts| InTransit::new(Arc::clone(counts))).collect(),
            router: settings.router.clone(),
            mode: settings.mode,
        };
        let publishers = specs
            .iter()
            .zip(counts)
            .enumerate()
            .map(|(number, (spec, counts))| zenoh.add_node(number, spec, counts, settings))
            .collect::<zenoh::Result<_>>()
            .map_err(|error| format!("cannot publish over zenoh: {error}"))?;
        Ok((zenoh, publishers))
    }

    fn unreachable(&mut self) -> Option<String> {
        let without = match self.mode {
            Mode::Client => {
                let answers = router::answers(&self.session);
                self.sender.set_connected(answers);
                let note = if answers { InTransit::confirm } else { InTransit::lose };
                self.in_transit.iter_mut().for_each(note);
                (!answers).then_some("waiting for it, scans are dropped until then")?
            }
            Mode::Peer => {
                let has_router = self.session.info().routers_zid().wait().next().is_some();
                (!has_router).then_some("readers that are connected already still get scans")?
            }
        };
        Some(format!("no zenoh router answers at {}; {without}", self.router))
    }

    fn close(mut self) {
        self.sender.close();
        // Nothing says that the last ones arrived.
        self.in_transit.iter_mut().for_each(InTransit::lose);
        for token in self.tokens {
            // A failure means that the session is closed already.
            let _ = token.undeclare().wait();
        }
        let _ = self.session.close().wait();
    }
}

impl Zenoh {
    fn add_node(
        &mut self,
        number: usize,
        spec: &NodeSpec,
        counts: &Arc<ScanCounts>,
        settings: &EngineSettings,
    ) -> zenoh::Result<NodePublishers> {
        let session_id = self.session.zid().to_string();
        let graph = GraphNode { domain: settings.domain, session_id, number, spec };
        self.declare_token(&graph.node_token())?;
        let scans = Topic {
            name: &spec.scan_topic,
            message: &MessageType::LASER_SCAN,
            qos: settings.qos,
            depth: settings.depth,
            entity: 1,
        };
        let diagnostics = Topic {
            name: DIAGNOSTICS_TOPIC,
            message: &MessageType::DIAGNOSTIC_ARRAY,
            qos: Qos::Reliable,
            depth: DIAGNOSTICS_DEPTH,
            entity: 2,
        };
        Ok(NodePublishers {
            scans: self.add_publisher(&graph, &scans, 2 * number, Arc::clone(counts))?,
            // Only scans are counted.
            diagnostics: self.add_publisher(
                &graph,
                &diagnostics,
                2 * number + 1,
                Arc::default(),
            )?,
        })
    }

    /// `queue` is the place of the topic's messages in the queue of the sender.
    fn add_publisher(
        &mut self,
        graph: &GraphNode<'_>,
        topic: &Topic<'_>,
        queue: usize,
        counts: Arc<ScanCounts>,
    ) -> zenoh::Result<Box<dyn Publish>> {
        let publisher = self
            .session
            .declare_publisher(topic.key(graph.domain))
            // `Block` would make the router, too, wait for a reader that hangs.
            .congestion_control(CongestionControl::Drop)
            .wait()?;
        let token = graph.publisher_token(topic);
        self.declare_token(&token)?;
        Ok(self.sender.publisher(queue, publisher, gid(&token), counts))
    }

    fn declare_token(&mut self, key: &str) -> zenoh::Result<()> {
        let token = self.session.liveliness().declare_token(key.to_owned()).wait()?;
        self.tokens.push(token);
        Ok(())
    }
}

/// Returns the settings that `rmw_zenoh` has by default, as far as they matter
/// here. No multicast; a peer listens on this machine only, unless an interface
/// is named.
fn config(settings: &EngineSettings) -> zenoh::Result<Config> {
    let mut config = Config::default();
    let mut set =
        |key: &str, value: serde_json::Value| config.insert_json5(key, &value.to_string());
    let router = match (settings.mode, settings.interface) {
        (Mode::Client, Some(address)) => {
            format!("{}#bind={}", settings.router, std::net::SocketAddr::new(address, 0))
        }
        _ => settings.router.clone(),
    };
    set("connect/endpoints", serde_json::json!([router]))?;
    set("scouting/multicast/enabled", false.into())?;
    match settings.mode {
        Mode::Client => {
            set("mode", "client".into())?;
            set("listen/endpoints", serde_json::json!([]))?;
            // One attempt; the caller repeats it.
            set("connect/timeout_ms", 0.into())?;
            // The sender waits for room on the link, longer than zenoh waits for a silent
            // router: zenoh drops nothing that is not counted.
            set(WAIT_BEFORE_DROP, 60_000_000.into())?;
            // The system would keep up to 4 MiB for a slow link, and scans be late by that.
            set("transport/link/tcp/so_sndbuf", 65_536.into())?;
        }
        Mode::Peer => {
            let listen = match settings.interface {
                Some(address) => format!("tcp/{}", std::net::SocketAddr::new(address, 0)),
                None => "tcp/localhost:0".to_owned(),
            };
            set("mode", "peer".into())?;
            set("listen/endpoints", serde_json::json!([listen]))?;
            // For ever, and behind its back.
            set("connect/timeout_ms", (-1).into())?;
            set("connect/exit_on_failure", false.into())?;
            // One reader that hangs must not delay the others: what a full link does not
            // take is dropped. 16 batches of 64 KiB, the most there can be, hold the scans of
            // 300 sensors.
            set(WAIT_BEFORE_DROP, 0.into())?;
            set("transport/link/tx/queue/size/data", 16.into())?;
        }
    }
    Ok(config)
}
