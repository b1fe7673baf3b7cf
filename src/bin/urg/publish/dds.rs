//! DDS by `ros2-client`: one participant, and a node of its own for each sensor.

use ros2_client::dds::rustdds::DomainParticipantBuilder;
use ros2_client::dds::{Context, Node, Publisher};
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{MessageTypeName, Name, NodeName, NodeOptions, ParameterValue, QosProfile};
use serde::ser::{Serialize, SerializeTuple, Serializer};
use tokio::runtime::Handle;
use tokio::task::JoinHandle;

use super::engine::{
    DIAGNOSTICS_TOPIC, Engine, EngineSettings, NodePublishers, NodeSpec,
    ParameterValue as Parameter, Publish, Qos,
};

/// Bytes of CDR's header, which the engine writes itself.
const CDR_HEADER: usize = 4;

/// Diagnostics that are kept for a reader that missed them.
const DIAGNOSTICS_DEPTH: usize = 10;

/// A participant with its nodes.
pub(super) struct Dds {
    nodes: Vec<Node>,
    /// Each answers for one node's parameters, until the node is dropped.
    spinners: Vec<JoinHandle<()>>,
    runtime: Handle,
    /// Dropped last: it says goodbye to the other participants.
    _context: Context,
}

impl Engine for Dds {
    fn open(
        settings: &EngineSettings,
        specs: &[NodeSpec],
        runtime: &Handle,
    ) -> Result<(Self, Vec<NodePublishers>), String> {
        let mut builder = DomainParticipantBuilder::new(settings.domain);
        if let Some(interface) = settings.interface {
            builder =
                builder.with_only_networks([interface]).same_host_loopback(interface.is_loopback());
        }
        let participant = builder.build().map_err(|error| failed("open DDS", &error))?;
        let context = Context::from_domain_participant(participant)
            .map_err(|error| failed("open DDS", &error))?;
        let mut dds = Self {
            nodes: Vec::new(),
            spinners: Vec::new(),
            runtime: runtime.clone(),
            _context: context.clone(),
        };
        let publishers = specs
            .iter()
            .map(|spec| dds.add_node(&context, spec, settings))
            .collect::<Result<_, _>>();
        Ok((dds, publishers?))
    }

    /// There is always somebody who could come: DDS has no centre to lose.
    fn unreachable(&self) -> Option<String> {
        None
    }

    fn close(self) {
        let Self { nodes, spinners, runtime, _context } = self;
        drop(nodes);
        for spinner in spinners {
            // It holds the participant open.
            let _ = runtime.block_on(spinner);
        }
    }
}

impl Dds {
    fn add_node(
        &mut self,
        context: &Context,
        spec: &NodeSpec,
        settings: &EngineSettings,
    ) -> Result<NodePublishers, String> {
        let cannot = |what: &str, error: &dyn std::fmt::Display| {
            format!("cannot {what} of the node `{}`: {error}", spec.name)
        };
        let name = NodeName::new(&spec.namespace, &spec.name)
            .map_err(|error| cannot("take the name", &error))?;
        let mut node = context
            .new_node(name, options(spec))
            .map_err(|error| cannot("create the node", &error))?;
        let spinner = node.spinner().map_err(|error| cannot("create the services", &error))?;
        self.spinners.push(self.runtime.spawn(async move {
            // It fails if the participant does, and then publishing does, too.
            let _ = spinner.spin().await;
        }));
        let mut publisher = |topic: &str, package, message, qos: QosProfile| {
            let name = Name::parse(topic).map_err(|error| cannot("take the topic", &error))?;
            let topic = node
                .create_topic(&name, MessageTypeName::new(package, message), &qos)
                .map_err(|error| cannot("create a topic", &error))?;
            let publisher = node
                .create_publisher::<Encoded>(&topic, Some(qos))
                .map_err(|error| cannot("create a publisher", &error))?;
            Ok::<Box<dyn Publish>, String>(Box::new(publisher))
        };
        let scans = publisher(
            &spec.scan_topic,
            "sensor_msgs",
            "LaserScan",
            qos_profile(settings.qos, settings.depth),
        )?;
        let diagnostics = publisher(
            DIAGNOSTICS_TOPIC,
            "diagnostic_msgs",
            "DiagnosticArray",
            qos_profile(Qos::Reliable, DIAGNOSTICS_DEPTH),
        )?;
        self.nodes.push(node);
        Ok(NodePublishers { scans, diagnostics })
    }
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

impl Publish for Publisher<Encoded> {
    fn publish(&self, message: Vec<u8>) -> bool {
        Publisher::publish(self, Encoded(message)).is_ok()
    }
}
