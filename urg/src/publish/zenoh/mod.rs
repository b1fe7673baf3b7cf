//! Zenoh engine, compatible with `rmw_zenoh`: one session, with liveliness tokens that add each
//! node and topic to the ROS graph.
//!
//! zenoh drops messages silently, so `put` blocks until the link has room, and messages are
//! dropped and counted in our own queue.
//!
//! - `graph` formats keys, tokens and metadata.
//! - `router` checks whether the router answers.

mod graph;
mod router;

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub;
use zenoh::qos::CongestionControl;
use zenoh::{Config, Session, Wait};

use self::graph::{Gid, GraphNode, attachment, gid};
use self::router::InTransit;
use super::engine::{Engine, EngineSettings, Mode, Opened, Reopen, Unavailable};
use super::send_queue::SendQueue;
use super::topic::Topic;

/// Setting for how long a put waits for room, in microseconds.
const WAIT_BEFORE_DROP: &str = "transport/link/tx/queue/congestion_control/drop/wait_before_drop";

/// Silence after which the other side closes a link, in milliseconds. zenoh sends four
/// keep-alives in that time.
const LEASE: u32 = 2_000;

pub(super) fn run(
    settings: &Arc<EngineSettings>,
    queue: &Arc<SendQueue>,
    opened: &Opened,
) -> Result<(), Unavailable> {
    let config = config(settings)
        .map_err(|error| Unavailable::Permanently(format!("cannot set up zenoh: {error}")))?;
    let local_address = router::local_address(&settings.router);
    let session = zenoh::open(config)
        .wait()
        .map_err(|_| format!("no zenoh router answers at {}", settings.router))?;
    let (tokens, publishers) = declare(&session, settings, &queue.topics)
        .map_err(|error| format!("cannot publish over zenoh: {error}"))?;
    let zenoh = Zenoh {
        settings: Arc::clone(settings),
        session: session.clone(),
        local_address,
        queue: Arc::clone(queue),
        in_transit: queue.topics.iter().map(|topic| InTransit::new(&topic.counts)).collect(),
    };
    // An error means that the program ends.
    let _ = opened.send(Ok(Box::new(zenoh)));
    while let Some(message) = queue.pop() {
        let Some((publisher, gid)) = publishers.get(message.topic) else { continue };
        // Counted before `put`, so that a scan waiting there counts as in transit.
        message.counts.lock().add_published();
        let metadata = attachment(message.sequence, message.published_at, *gid);
        // Fails only after the session has ended.
        let _ = publisher.put(message.payload).attachment(metadata).wait();
    }
    drop(publishers);
    for token in tokens {
        // An error means that the session has ended.
        let _ = token.undeclare().wait();
    }
    let _ = session.close().wait();
    Ok(())
}

struct Zenoh {
    settings: Arc<EngineSettings>,
    session: Session,
    /// Address of the link to the router, when the session was opened.
    local_address: Option<IpAddr>,
    queue: Arc<SendQueue>,
    in_transit: Vec<InTransit>,
}

impl Engine for Zenoh {
    /// zenoh closes a link with `SO_LINGER`: on a dead link that takes 10 s. By the time another
    /// session is opened, this one sends nothing more: its queue is closed and empty, and the
    /// router has dropped the silent link.
    fn may_overlap(&self) -> bool {
        true
    }

    fn check(&mut self) -> Result<Option<String>, Reopen> {
        let consequence = match self.settings.mode {
            Mode::Client => {
                let answers = router::answers(&self.session);
                self.queue.set_connected(answers);
                let update = if answers { InTransit::confirm } else { InTransit::lose };
                self.in_transit.iter_mut().for_each(update);
                // zenoh itself keeps the dead link for 10 s.
                let address = (!answers).then(|| router::local_address(&self.settings.router));
                if address.flatten().is_some_and(|now| Some(now) != self.local_address) {
                    return Err(Reopen::Outdated("this machine has another address".to_owned()));
                }
                (!answers).then_some("waiting for it, scans are dropped until then")
            }
            Mode::Peer => {
                let has_router = self.session.info().routers_zid().wait().next().is_some();
                (!has_router).then_some("readers that are connected already still get scans")
            }
        };
        if self.session.is_closed() {
            return Err(Reopen::Dead("the zenoh session has ended".to_owned()));
        }
        let router = &self.settings.router;
        Ok(consequence.map(|text| format!("no zenoh router answers at {router}; {text}")))
    }
}

type Publisher = (pubsub::Publisher<'static>, Gid);

/// Declares nodes and publishers. Returns a publisher for each of `topics`, in their order.
fn declare(
    session: &Session,
    settings: &EngineSettings,
    topics: &[Topic],
) -> zenoh::Result<(Vec<LivelinessToken>, Vec<Publisher>)> {
    let mut tokens = Vec::new();
    let token = |key: &str| session.liveliness().declare_token(key.to_owned()).wait();
    let session_id = &session.zid().to_string();
    let mut publishers = Vec::new();
    for (index, topic) in topics.iter().enumerate() {
        let Some(names) = settings.nodes.get(topic.node) else { continue };
        let node = GraphNode { domain: settings.domain, session_id, number: topic.node, names };
        // Topics of a node are numbered from 1.
        let earlier = topics.iter().take(index).filter(|other| other.node == topic.node);
        let entity = earlier.count() + 1;
        if entity == 1 {
            tokens.push(token(&node.token(0, "NN"))?);
        }
        let publisher_token = node.publisher_token(topic, entity);
        let publisher = session
            .declare_publisher(node.key(topic))
            // With `Block`, the router would also wait for a reader that hangs.
            .congestion_control(CongestionControl::Drop)
            .wait()?;
        tokens.push(token(&publisher_token)?);
        publishers.push((publisher, gid(&publisher_token)));
    }
    Ok((tokens, publishers))
}

/// Builds a configuration with the relevant defaults of `rmw_zenoh`. Uses no multicast. A peer
/// listens on localhost, unless you set `--interface`.
fn config(settings: &EngineSettings) -> zenoh::Result<Config> {
    let mut config = Config::default();
    let mut set =
        |key: &str, value: serde_json::Value| config.insert_json5(key, &value.to_string());
    let router = match (settings.mode, settings.interface) {
        (Mode::Client, Some(address)) => {
            format!("{}#bind={}", settings.router, SocketAddr::new(address, 0))
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
            // Longer than zenoh waits for a silent router, so that zenoh counts what it drops.
            set(WAIT_BEFORE_DROP, 60_000_000.into())?;
            // Otherwise the system buffers up to 4 MiB on a slow link, which delays scans.
            set("transport/link/tcp/so_sndbuf", 65_536.into())?;
        }
        Mode::Peer => {
            let listen = match settings.interface {
                Some(address) => format!("tcp/{}", SocketAddr::new(address, 0)),
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
