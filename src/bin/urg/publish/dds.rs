//! DDS by `ros2-client`: one participant, and a node of its own for each sensor.

use std::sync::Arc;
use std::thread::JoinHandle;

use ros2_client::dds::rustdds::DomainParticipantBuilder;
use ros2_client::dds::{Context, Node, Publisher};
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{
    MessageTypeName, Name, NodeName, NodeOptions, ParameterValue, QosProfile, Spinner,
};
use serde::ser::{Serialize, SerializeTuple, Serializer};
use tokio::task::JoinSet;

use super::counts::ScanCounts;
use super::engine::{
    DIAGNOSTICS_TOPIC, Engine, EngineSettings, NodePublishers, NodeSpec,
    ParameterValue as Parameter, Publish, Qos,
};
use super::newcomers::Newcomers;

/// Bytes of CDR's header, which the engine writes itself.
const CDR_HEADER: usize = 4;

/// Diagnostics that are kept for a reader that missed them.
const DIAGNOSTICS_DEPTH: usize = 10;

/// With more nodes than this, none has parameters. Those of one node need 14 readers
/// and writers, and one of the readers gets the list of all nodes with each change of
/// it, so that the work grows with the cube of the nodes.
const MAX_NODES_WITH_PARAMETERS: usize = 16;

/// A participant with its nodes.
pub(super) struct Dds {
    nodes: Vec<Node>,
    parameters: Option<ParameterServer>,
    /// True if it could only join multicast groups of this machine.
    is_local: bool,
    /// Dropped last: this takes the participant out of the graph.
    _context: Context,
}

impl Engine for Dds {
    fn open(
        settings: &EngineSettings,
        specs: &[NodeSpec],
        counts: &[Arc<ScanCounts>],
    ) -> Result<(Self, Vec<NodePublishers>), String> {
        let mut builder = DomainParticipantBuilder::new(settings.domain);
        if let Some(interface) = settings.interface {
            builder =
                builder.with_only_networks([interface]).same_host_loopback(interface.is_loopback());
        }
        let is_local = settings.interface.is_none() && !is_in_network();
        let participant = builder.build().map_err(|error| failed("open DDS", &error))?;
        let mut newcomers = Newcomers::of(&participant);
        newcomers.wait_until_quiet();
        newcomers.wait_for_turn();
        let context = Context::from_domain_participant(participant)
            .map_err(|error| failed("open DDS", &error))?;
        let mut nodes = Vec::new();
        let mut publishers = Vec::new();
        for (spec, counts) in specs.iter().zip(counts) {
            newcomers.wait_until_quiet();
            let (node, its_publishers) = add_node(&context, spec, counts, settings)?;
            nodes.push(node);
            publishers.push(its_publishers);
        }
        newcomers.wait_until_quiet();
        let parameters = (nodes.len() <= MAX_NODES_WITH_PARAMETERS)
            .then(|| ParameterServer::start(&mut nodes))
            .transpose()?;
        Ok((Self { nodes, parameters, is_local, _context: context }, publishers))
    }

    /// DDS has no centre to lose. Readers on this machine need no network.
    fn unreachable(&mut self) -> Option<String> {
        self.is_local.then(|| {
            "this machine is in no network: until it is, only readers on it get scans".to_owned()
        })
    }

    /// The engine joins multicast groups only when it is opened.
    fn is_outdated(&self) -> bool {
        self.is_local && is_in_network()
    }

    fn close(self) {
        let Self { nodes, parameters, is_local: _, _context } = self;
        drop(nodes);
        if let Some(server) = parameters {
            // It holds the participant open. It panics only where the engine does.
            let _ = server.thread.join();
        }
    }
}

/// Returns true if an interface has an address that is not the loopback's. DDS uses
/// IPv4 only.
fn is_in_network() -> bool {
    let mut addresses = netdev::get_interfaces().into_iter().flat_map(|each| each.ipv4);
    addresses.any(|network| !network.addr().is_loopback())
}

/// Answers for the parameters of all nodes, until they are dropped. On a thread of its
/// own: the engine works here each time that a participant comes or goes, and the
/// sensors must not wait for that.
struct ParameterServer {
    thread: JoinHandle<()>,
}

impl ParameterServer {
    fn start(nodes: &mut [Node]) -> Result<Self, String> {
        let spinners = nodes.iter_mut().map(Node::spinner).collect::<Result<Vec<Spinner>, _>>();
        let spinners = spinners.map_err(|error| failed("create the services of a node", &error))?;
        let runtime = tokio::runtime::Builder::new_current_thread()
            .build()
            .map_err(|error| failed("serve parameters", &error))?;
        let serve = async move {
            let mut tasks = JoinSet::new();
            for spinner in spinners {
                // It fails if the participant does, and then publishing does, too.
                tasks.spawn(async move { drop(spinner.spin().await) });
            }
            while tasks.join_next().await.is_some() {}
        };
        let thread = std::thread::Builder::new()
            .name("parameters".to_owned())
            .spawn(move || runtime.block_on(serve))
            .map_err(|error| failed("serve parameters", &error))?;
        Ok(Self { thread })
    }
}

fn add_node(
    context: &Context,
    spec: &NodeSpec,
    counts: &Arc<ScanCounts>,
    settings: &EngineSettings,
) -> Result<(Node, NodePublishers), String> {
    let cannot = |what: &str, error: &dyn std::fmt::Display| {
        format!("cannot {what} of the node `{}`: {error}", spec.name)
    };
    let name = NodeName::new(&spec.namespace, &spec.name)
        .map_err(|error| cannot("take the name", &error))?;
    let mut node =
        context.new_node(name, options(spec)).map_err(|error| cannot("create the node", &error))?;
    let mut publisher = |topic: &str, package, message, qos: QosProfile, counts| {
        let name = Name::parse(topic).map_err(|error| cannot("take the topic", &error))?;
        let topic = node
            .create_topic(&name, MessageTypeName::new(package, message), &qos)
            .map_err(|error| cannot("create a topic", &error))?;
        let publisher = node
            .create_publisher::<Encoded>(&topic, Some(qos))
            .map_err(|error| cannot("create a publisher", &error))?;
        Ok::<Box<dyn Publish>, String>(Box::new(DdsPublisher { publisher, counts }))
    };
    let scans = publisher(
        &spec.scan_topic,
        "sensor_msgs",
        "LaserScan",
        qos_profile(settings.qos, settings.depth),
        Arc::clone(counts),
    )?;
    let diagnostics = publisher(
        DIAGNOSTICS_TOPIC,
        "diagnostic_msgs",
        "DiagnosticArray",
        qos_profile(Qos::Reliable, DIAGNOSTICS_DEPTH),
        // Only scans are counted.
        Arc::default(),
    )?;
    Ok((node, NodePublishers { scans, diagnostics }))
}

fn failed(what: &str, error: &dyn std::fmt::Display) -> String {
    format!("cannot {what}: {error}")
}

/// Returns the options of a node: no log topic, and parameters that nobody changes.
fn options(spec: &NodeSpec) -> NodeOptions {
    let mut options = NodeOptions::new().enable_rosout(false);
    let parameters: Vec<_> =
        spec.parameters.iter().map(|(name, value)| (*name, parameter(value))).collect();
    for (name, value) in &parameters {
        options = options.declare_parameter(name, value.clone());
    }
    options.parameter_validator(Box::new(move |name, value| {
        // Declaring a parameter sets it to its value.
        match parameters.iter().find(|(own, _)| *own == name) {
            Some((_, own)) if own != value => {
                Err(format!("{name} is read-only: start `urg publish` with another value"))
            }
            _ => Ok(()),
        }
    }))
}

fn parameter(value: &Parameter) -> ParameterValue {
    match value {
        Parameter::Integer(number) => ParameterValue::Integer(*number),
        Parameter::Float(number) => ParameterValue::Double(*number),
        Parameter::Text(text) => ParameterValue::String(text.clone()),
    }
}

fn qos_profile(qos: Qos, depth: usize) -> QosProfile {
    let profile = QosProfile::publisher_default()
        .durability(Durability::Volatile)
        .history(History::KeepLast { depth });
    match qos {
        // Where a reader does not acknowledge, new messages are dropped and not
        // waited for.
        Qos::Reliable => profile.reliability_reliable(WhenFull::Fail),
        Qos::Sensor => profile.reliability_best_effort(),
    }
}

/// A message that is encoded already. Bytes have no alignment and a tuple no
/// length, so serialising a tuple of them writes them as they are.
struct Encoded(Vec<u8>);

impl Serialize for Encoded {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let body = self.0.get(CDR_HEADER..).unwrap_or_default();
        let mut tuple = serializer.serialize_tuple(body.len())?;
        body.iter().try_for_each(|byte| tuple.serialize_element(byte))?;
        tuple.end()
    }
}

struct DdsPublisher {
    publisher: Publisher<Encoded>,
    counts: Arc<ScanCounts>,
}

impl Publish for DdsPublisher {
    fn publish(&self, message: Vec<u8>) {
        match self.publisher.publish(Encoded(message)) {
            Ok(()) => self.counts.add_published(),
            Err(_) => self.counts.add_dropped(),
        }
    }
}
