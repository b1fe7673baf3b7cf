//! Wrapper of the Cyclone DDS binding: a participant with one writer per topic. No other file
//! uses the binding.
//!
//! Writers borrow topics, and topics borrow the participant, so one function owns them all, on
//! one thread.

use std::marker::PhantomData;

use cyclonedds::qos::policy::{Durability, History, Reliability, UserData};
use cyclonedds::{Domain, Duration, Participant, QoS, Topic, Topicable, Writer};
use serde::de::{Deserialize, Deserializer, Error};
use serde::ser::{Serialize, SerializeTuple, Serializer};
use tokio_scip::ros::MessageType;

use super::discovery_info;
use crate::publish::engine::Qos;

// The binding prepends a header with this machine's byte order to our little-endian messages.
const _: () = assert!(cfg!(target_endian = "little"), "DDS needs a little-endian machine");

/// Length of the CDR header, which the binding writes itself.
const CDR_HEADER: usize = 4;

/// Maximum time that a write may block. `KeepLast` history always has room for the next
/// message.
const WRITE_TIMEOUT: Duration = Duration::from_millis(100);

/// Message type of a topic.
pub(super) trait Kind: Clone + std::fmt::Debug + 'static {
    /// Name of the type in DDS.
    fn dds_name() -> String;
}

#[derive(Debug, Clone)]
pub(super) struct LaserScan;

impl Kind for LaserScan {
    fn dds_name() -> String {
        MessageType::LASER_SCAN.dds_name()
    }
}

#[derive(Debug, Clone)]
pub(super) struct DiagnosticArray;

impl Kind for DiagnosticArray {
    fn dds_name() -> String {
        MessageType::DIAGNOSTIC_ARRAY.dds_name()
    }
}

#[derive(Debug, Clone)]
pub(super) struct StaticTransforms;

impl Kind for StaticTransforms {
    fn dds_name() -> String {
        MessageType::TF_MESSAGE.dds_name()
    }
}

#[derive(Debug, Clone)]
pub(super) struct DiscoveryInfo;

impl Kind for DiscoveryInfo {
    fn dds_name() -> String {
        discovery_info::DDS_NAME.to_owned()
    }
}

/// Encoded message. Serializes as a tuple of bytes, without a length and without alignment, so
/// that the binding writes the bytes unchanged.
#[derive(Debug, Clone)]
pub(super) struct Encoded<K> {
    bytes: Vec<u8>,
    kind: PhantomData<K>,
}

impl<K> Serialize for Encoded<K> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let body = self.bytes.get(CDR_HEADER..).unwrap_or_default();
        let mut tuple = serializer.serialize_tuple(body.len())?;
        body.iter().try_for_each(|byte| tuple.serialize_element(byte))?;
        tuple.end()
    }
}

/// Required by the binding, never used: this program has no DDS readers.
impl<'de, K> Deserialize<'de> for Encoded<K> {
    fn deserialize<D: Deserializer<'de>>(_: D) -> Result<Self, D::Error> {
        Err(D::Error::custom("messages are only written"))
    }
}

impl<K: Kind> Topicable for Encoded<K> {
    type Key = ();

    fn from_key((): &()) -> Self {
        Self { bytes: Vec::new(), kind: PhantomData }
    }

    fn as_key(&self) {}

    fn dds_type_name() -> impl AsRef<str> {
        K::dds_name()
    }
}

/// Writer of encoded messages on one topic.
pub(super) trait Write {
    fn write(&self, message: Vec<u8>) -> Result<(), String>;

    /// Number of matched readers.
    fn readers(&self) -> usize;
}

impl<K: Kind> Write for Writer<'_, '_, '_, Encoded<K>> {
    fn write(&self, message: Vec<u8>) -> Result<(), String> {
        let sample = Encoded { bytes: message, kind: PhantomData };
        Writer::write(self, &sample).map_err(|error| error.to_string())
    }

    fn readers(&self) -> usize {
        self.matched_subscriptions().map_or(0, |readers| readers.len())
    }
}

/// Settings of a participant.
pub(super) struct Setup {
    pub(super) domain: u16,
    /// Cyclone's configuration, as XML.
    pub(super) config: String,
    /// Absolute names of the scan topics, one per node.
    pub(super) scan_topics: Vec<String>,
    pub(super) diagnostics_topic: &'static str,
    /// Only if there are static transforms.
    pub(super) transforms_topic: Option<&'static str>,
    pub(super) qos: Qos,
    pub(super) depth: usize,
    pub(super) diagnostics_depth: usize,
}

/// Opens a participant, calls `work` with its writers, and closes the participant.
///
/// Order of the writers: scans and diagnostics for each node in turn, then discovery
/// information, then static transforms.
pub(super) fn with_writers(
    setup: &Setup,
    work: impl FnOnce(&[Box<dyn Write + '_>]),
) -> Result<(), String> {
    let failed = |what: &'static str| move |error| format!("cannot {what}: {error}");
    let domain = Domain::new_with_xml_config(setup.domain.into(), &setup.config)
        .map_err(failed("open DDS"))?;
    // Same as ROS 2's own participants. Without it, ROS 2 Kilted shows endpoints without names.
    let enclave = QoS::new().with_user_data(UserData { value: b"enclave=/;".to_vec() });
    let participant = Participant::builder(&domain)
        .with_qos(&enclave)
        .build()
        .map_err(failed("create a DDS participant"))?;
    let topic = failed("create a DDS topic");
    let scans = setup
        .scan_topics
        .iter()
        .map(|name| Topic::<Encoded<LaserScan>>::new(&participant, &dds_topic(name)).map_err(topic))
        .collect::<Result<Vec<_>, _>>()?;
    let diagnostics =
        Topic::<Encoded<DiagnosticArray>>::new(&participant, &dds_topic(setup.diagnostics_topic))
            .map_err(topic)?;
    let info =
        Topic::<Encoded<DiscoveryInfo>>::new(&participant, discovery_info::TOPIC).map_err(topic)?;

    let transforms = setup
        .transforms_topic
        .map(|name| Topic::<Encoded<StaticTransforms>>::new(&participant, &dds_topic(name)))
        .transpose()
        .map_err(topic)?;

    let scan_qos = qos(setup.qos, setup.depth, Some(&MessageType::LASER_SCAN));
    let diagnostics_qos =
        qos(Qos::Reliable, setup.diagnostics_depth, Some(&MessageType::DIAGNOSTIC_ARRAY));
    let info_qos = qos(Qos::Reliable, 1, None).with_durability(Durability::TransientLocal);
    let mut writers: Vec<Box<dyn Write + '_>> = Vec::new();
    for scans in &scans {
        writers.push(writer(scans, &scan_qos)?);
        writers.push(writer(&diagnostics, &diagnostics_qos)?);
    }
    writers.push(writer(&info, &info_qos)?);
    if let Some(transforms) = &transforms {
        let qos = qos(Qos::Reliable, 1, Some(&MessageType::TF_MESSAGE));
        writers.push(writer(transforms, &qos.with_durability(Durability::TransientLocal))?);
    }
    work(&writers);
    Ok(())
}

fn writer<'a, K: Kind>(
    topic: &'a Topic<'a, 'a, Encoded<K>>,
    qos: &QoS,
) -> Result<Box<dyn Write + 'a>, String> {
    let writer = Writer::builder(topic).with_qos(qos).build();
    Ok(Box::new(writer.map_err(|error| format!("cannot create a DDS writer: {error}"))?))
}

/// Converts the name of a ROS topic to its name in DDS.
fn dds_topic(name: &str) -> String {
    format!("rt{name}")
}

fn qos(qos: Qos, depth: usize, message: Option<&MessageType>) -> QoS {
    let depth = i32::try_from(depth).unwrap_or(i32::MAX);
    let built = QoS::new()
        .with_durability(Durability::Volatile)
        .with_history(History::KeepLast { depth })
        .with_reliability(match qos {
            Qos::Reliable => Reliability::Reliable { max_blocking_time: WRITE_TIMEOUT },
            Qos::Sensor => Reliability::BestEffort,
        });
    match message {
        Some(message) => {
            let hash = format!("typehash={};", message.hash());
            built.with_user_data(UserData { value: hash.into_bytes() })
        }
        None => built,
    }
}
