//! zenoh as `rmw_zenoh` speaks it: one session, and for each node a liveliness
//! token that puts it into the ROS graph, and one for each of its topics.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::time::SystemTime;

use tokio_scip::ros::MessageType;
use twox_hash::XxHash3_128;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;
use zenoh::{Config, Session, Wait};

use super::engine::{
    DIAGNOSTICS_TOPIC, Engine, EngineSettings, Mode, NodePublishers, NodeSpec, Publish, Qos,
};

/// Diagnostics that a reader is asked to keep.
const DIAGNOSTICS_DEPTH: usize = 10;

/// A session with the tokens of its nodes.
pub(super) struct Zenoh {
    session: Session,
    tokens: Vec<LivelinessToken>,
    router: String,
    /// True if messages can get out. A client without its router loses them.
    connected: Arc<AtomicBool>,
    mode: Mode,
}

impl Engine for Zenoh {
    fn open(
        settings: &EngineSettings,
        specs: &[NodeSpec],
    ) -> Result<(Self, Vec<NodePublishers>), String> {
        let config = config(settings).map_err(|error| format!("cannot set up zenoh: {error}"))?;
        let session = zenoh::open(config)
            .wait()
            .map_err(|_| format!("no zenoh router answers at {}", settings.router))?;
        let mut zenoh = Self {
            session,
            tokens: Vec::new(),
            router: settings.router.clone(),
            connected: Arc::new(AtomicBool::new(true)),
            mode: settings.mode,
        };
        let publishers = specs
            .iter()
            .enumerate()
            .map(|(number, spec)| zenoh.add_node(number, spec, settings))
            .collect::<zenoh::Result<_>>()
            .map_err(|error| format!("cannot publish over zenoh: {error}"))?;
        Ok((zenoh, publishers))
    }

    fn unreachable(&self) -> Option<String> {
        let has_router = self.session.info().routers_zid().wait().next().is_some();
        self.connected.store(has_router || self.mode == Mode::Peer, Ordering::Relaxed);
        (!has_router).then(|| {
            let without = match self.mode {
                Mode::Client => "waiting for it, scans are dropped until then",
                Mode::Peer => "readers that are connected already still get scans",
            };
            format!("no zenoh router answers at {}; {without}", self.router)
        })
    }

    fn close(self) {
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
            scans: self.add_publisher(&graph, &scans)?,
            diagnostics: self.add_publisher(&graph, &diagnostics)?,
        })
    }

    fn add_publisher(
        &mut self,
        graph: &GraphNode<'_>,
        topic: &Topic<'_>,
    ) -> zenoh::Result<Box<dyn Publish>> {
        let publisher = self
            .session
            .declare_publisher(topic.key(graph.domain))
            .congestion_control(CongestionControl::Drop)
            .wait()?;
        let token = graph.publisher_token(topic);
        self.declare_token(&token)?;
        Ok(Box::new(ZenohPublisher {
            publisher,
            gid: gid(&token),
            sequence: AtomicI64::new(1),
            connected: Arc::clone(&self.connected),
        }))
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
    // A full link drops at once, so that no sensor waits for it. 16 batches of 64 KiB,
    // the most there can be, hold the scans of 300 sensors; with the default of 2, a
    // sixth of the scans of 100 sensors was dropped on a busy machine.
    set("transport/link/tx/queue/size/data", 16.into())?;
    set("transport/link/tx/queue/congestion_control/drop/wait_before_drop", 0.into())?;
    match settings.mode {
        Mode::Client => {
            set("mode", "client".into())?;
            set("listen/endpoints", serde_json::json!([]))?;
            // One attempt; the caller repeats it.
            set("connect/timeout_ms", 0.into())?;
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
        }
    }
    Ok(config)
}

/// A node's place in the ROS graph.
struct GraphNode<'a> {
    domain: u16,
    session_id: String,
    number: usize,
    spec: &'a NodeSpec,
}

impl GraphNode<'_> {
    /// Entities are numbered within the session: three for each node.
    fn entity(&self, entity: usize) -> usize {
        self.number * 3 + entity
    }

    fn token(&self, entity: usize, kind: &str) -> String {
        let Self { domain, session_id, spec, .. } = self;
        let (node, entity) = (self.entity(0), self.entity(entity));
        let (namespace, name) = (mangled(&spec.namespace), &spec.name);
        format!("@ros2_lv/{domain}/{session_id}/{node}/{entity}/{kind}/%/{namespace}/{name}")
    }

    fn node_token(&self) -> String {
        self.token(0, "NN")
    }

    fn publisher_token(&self, topic: &Topic<'_>) -> String {
        let token = self.token(topic.entity, "MP");
        let name = mangled(topic.name);
        let (message, hash) = (topic.message.dds_name(), topic.message.hash());
        // What differs from ROS's default: nothing where it is reliable.
        let reliability = match topic.qos {
            Qos::Reliable => "",
            Qos::Sensor => "2",
        };
        format!("{token}/{name}/{message}/{hash}/{reliability}::,{}:,:,:,,", topic.depth)
    }
}

/// A topic of a node.
struct Topic<'a> {
    /// Absolute.
    name: &'a str,
    message: &'a MessageType,
    qos: Qos,
    depth: usize,
    /// Its number within the node.
    entity: usize,
}

impl Topic<'_> {
    /// Returns the key of its messages.
    fn key(&self, domain: u16) -> String {
        let name = self.name.trim_start_matches('/');
        format!("{domain}/{name}/{}/{}", self.message.dds_name(), self.message.hash())
    }
}

/// Returns a name without slashes, which separate the parts of a key.
fn mangled(name: &str) -> String {
    name.replace('/', "%")
}

/// Returns the identity of the publisher with this token.
fn gid(token: &str) -> [u8; 16] {
    XxHash3_128::oneshot(token.as_bytes()).to_le_bytes()
}

/// Publishes with the metadata that `rmw_zenoh` wants beside each message.
struct ZenohPublisher {
    publisher: Publisher<'static>,
    gid: [u8; 16],
    sequence: AtomicI64,
    connected: Arc<AtomicBool>,
}

impl Publish for ZenohPublisher {
    fn publish(&self, message: Vec<u8>) -> bool {
        if !self.connected.load(Ordering::Relaxed) {
            return false;
        }
        let sequence = self.sequence.fetch_add(1, Ordering::Relaxed);
        let attachment = attachment(sequence, SystemTime::now(), self.gid);
        self.publisher.put(message).attachment(attachment).wait().is_ok()
    }
}

/// Returns the metadata of a message: its number, the time, the publisher.
fn attachment(sequence: i64, time: SystemTime, gid: [u8; 16]) -> Vec<u8> {
    let since_1970 = time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let nanos = i64::try_from(since_1970.as_nanos()).unwrap_or(i64::MAX);
    let mut bytes = Vec::with_capacity(33);
    bytes.extend_from_slice(&sequence.to_le_bytes());
    bytes.extend_from_slice(&nanos.to_le_bytes());
    // The length of the array that follows.
    bytes.push(16);
    bytes.extend_from_slice(&gid);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metadata_has_the_form_of_rmw_zenoh() {
        let time = SystemTime::UNIX_EPOCH + std::time::Duration::from_nanos(258);
        let bytes = attachment(1, time, [7; 16]);
        assert_eq!(bytes.len(), 33);
        assert_eq!(bytes[..17], [1, 0, 0, 0, 0, 0, 0, 0, 2, 1, 0, 0, 0, 0, 0, 0, 16]);
        assert_eq!(bytes[17..], [7; 16]);
    }

    #[test]
    fn a_publisher_has_the_identity_that_others_compute_from_its_token() {
        let token = "@ros2_lv/7/1b42ce9e071392be9bd8b5c60d108967/0/1/MP/%/%/urg_node/%scan/\
                     sensor_msgs::msg::dds_::LaserScan_/RIHS01_64c191398013af96509d518dac71d5164f\
                     9382553fce5c1f8cca5be7924bd828/::,20:,:,:,,";
        let hex: String = gid(token).iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(hex, "7fdd3c7864607827008077793c63c525");
    }
}
