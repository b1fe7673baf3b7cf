//! Zenoh engine, compatible with `rmw_zenoh`: one session, with liveliness tokens that add each
//! node and topic to the ROS graph.
//!
//! - `graph` formats keys and tokens.
//! - `sender` sends queued messages.
//! - `router` checks whether the router answers.
//! - `kept` serves the static transforms to late readers.

mod graph;
mod kept;
mod router;
mod sender;

use std::sync::Arc;

use tokio_scip::ros::MessageType;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::CongestionControl;
use zenoh::{Config, Session, Wait};

use self::graph::{GraphNode, Topic, gid};
use self::kept::Kept;
use self::router::InTransit;
use self::sender::Sender;
use super::counts::ScanCounts;
use super::engine::{
    DIAGNOSTICS_TOPIC, Engine, EngineSettings, Health, MessagePublisher, Mode, NodePublishers,
    NodeSpec, Qos, STATIC_TRANSFORMS_TOPIC,
};

/// Number of diagnostics to keep, as announced to readers.
const DIAGNOSTICS_DEPTH: usize = 10;

/// Setting for how long a put waits for room, in microseconds.
const WAIT_BEFORE_DROP: &str = "transport/link/tx/queue/congestion_control/drop/wait_before_drop";

/// Silence after which the other side closes a link, in milliseconds. zenoh sends four
/// keep-alives in that time.
const LEASE: u32 = 2_000;

/// Session with the tokens of its nodes.
pub(super) struct Zenoh {
    session: Session,
    tokens: Vec<LivelinessToken>,
    sender: Sender,
    /// Serves late readers until dropped.
    _transforms: Option<Kept>,
    in_transit: Vec<InTransit>,
    router: String,
    mode: Mode,
}

impl Engine for Zenoh {
    type Memory = ();

    fn open(
        settings: &EngineSettings,
        specs: &[NodeSpec],
        counts: &[Arc<ScanCounts>],
        (): &(),
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
            _transforms: None,
            in_transit: counts.iter().map(|counts| InTransit::new(Arc::clone(counts))).collect(),
            router: settings.router.clone(),
            mode: settings.mode,
        };
        let publishers = specs
            .iter()
            .zip(counts)
            .enumerate()
            .map(|(number, (spec, counts))| zenoh.add_node(number, spec, counts, settings))
            .collect::<zenoh::Result<Vec<_>>>()
            .and_then(|publishers| {
                zenoh.add_transforms(specs, settings)?;
                Ok(publishers)
            })
            .map_err(|error| format!("cannot publish over zenoh: {error}"))?;
        Ok((zenoh, publishers))
    }

    fn look(&mut self) -> Health {
        let without = match self.mode {
            Mode::Client => {
                let answers = router::answers(&self.session);
                self.sender.set_connected(answers);
                let note = if answers { InTransit::confirm } else { InTransit::lose };
                self.in_transit.iter_mut().for_each(note);
                (!answers).then_some("waiting for it, scans are dropped until then")
            }
            Mode::Peer => {
                let has_router = self.session.info().routers_zid().wait().next().is_some();
                (!has_router).then_some("readers that are connected already still get scans")
            }
        };
        if self.session.is_closed() {
            return Health::Dead("the zenoh session has ended".to_owned());
        }
        if self.sender.is_stuck() {
            return Health::Dead("zenoh no longer takes scans".to_owned());
        }
        match without {
            Some(without) => Health::Unreachable(format!(
                "no zenoh router answers at {}; {without}",
                self.router
            )),
            None => Health::Works,
        }
    }

    fn close(mut self) {
        self.sender.close();
        // No answer confirms the last scans.
        self.in_transit.iter_mut().for_each(InTransit::lose);
        for token in self.tokens {
            // An error means that the session is already closed.
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
            is_kept: false,
            entity: 1,
        };
        let diagnostics = Topic {
            name: DIAGNOSTICS_TOPIC,
            message: &MessageType::DIAGNOSTIC_ARRAY,
            qos: Qos::Reliable,
            depth: DIAGNOSTICS_DEPTH,
            is_kept: false,
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

    /// Publishes the static transforms of all sensors, as the first node.
    fn add_transforms(
        &mut self,
        specs: &[NodeSpec],
        settings: &EngineSettings,
    ) -> zenoh::Result<()> {
        let (Some(spec), Some(message)) = (specs.first(), settings.static_transforms()) else {
            return Ok(());
        };
        let session_id = self.session.zid().to_string();
        let graph = GraphNode { domain: settings.domain, session_id, number: 0, spec };
        let topic = Topic {
            name: STATIC_TRANSFORMS_TOPIC,
            message: &MessageType::TF_MESSAGE,
            qos: Qos::Reliable,
            depth: 1,
            is_kept: true,
            entity: 3,
        };
        let token = graph.publisher_token(&topic);
        self.declare_token(&token)?;
        let key = topic.key(settings.domain);
        self._transforms = Some(Kept::publish(&self.session, key, message, gid(&token))?);
        Ok(())
    }

    /// Creates a publisher. `queue` is the topic's index in the sender's queue.
    fn add_publisher(
        &mut self,
        graph: &GraphNode<'_>,
        topic: &Topic<'_>,
        queue: usize,
        counts: Arc<ScanCounts>,
    ) -> zenoh::Result<Box<dyn MessagePublisher>> {
        let publisher = self
            .session
            .declare_publisher(topic.key(graph.domain))
            // With `Block`, the router would also wait for a reader that hangs.
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

/// Builds a configuration with the relevant defaults of `rmw_zenoh`. Uses no multicast. A peer
/// listens on localhost, unless you set `--interface`.
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
    // A lost link's unacknowledged scans wait in the system's TCP buffer. When the link is back,
    // the other side has closed it, and they are discarded.
    set("transport/link/tx/lease", LEASE.into())?;
    match settings.mode {
        Mode::Client => {
            set("mode", "client".into())?;
            set("listen/endpoints", serde_json::json!([]))?;
            // One attempt: the caller retries.
            set("connect/timeout_ms", 0.into())?;
            // Longer than zenoh waits for a silent router, so that zenoh drops no message
            // without counting it.
            set(WAIT_BEFORE_DROP, 60_000_000.into())?;
            // Otherwise the system buffers up to 4 MiB on a slow link, which delays scans.
            set("transport/link/tcp/so_sndbuf", 65_536.into())?;
        }
        Mode::Peer => {
            let listen = match settings.interface {
                Some(address) => format!("tcp/{}", std::net::SocketAddr::new(address, 0)),
                None => "tcp/localhost:0".to_owned(),
            };
            set("mode", "peer".into())?;
            set("listen/endpoints", serde_json::json!([listen]))?;
            // Retry forever, in the background.
            set("connect/timeout_ms", (-1).into())?;
            set("connect/exit_on_failure", false.into())?;
            // Drop messages that a full link cannot take: a reader that hangs must not delay
            // the others. 16 batches of 64 KiB, zenoh's maximum, hold the scans of 300 sensors.
            set(WAIT_BEFORE_DROP, 0.into())?;
            set("transport/link/tx/queue/size/data", 16.into())?;
        }
    }
    Ok(config)
}
