//! The only wrapper of the Cyclone DDS binding: a participant with one writer per topic.
//!
//! Writers borrow topics, and topics the participant, so one function owns them all, on one thread.

use std::cell::RefCell;

use cyclonedds::qos::policy::{Durability, History, Reliability, UserData};
use cyclonedds::{Domain, Duration, Participant, QoS, Topic, Topicable, Writer};
use serde::Deserialize;
use serde::ser::{Serialize, SerializeTuple, Serializer};

use super::discovery_info::{self, DiscoveryInfo};
use super::pulse::Prefix;
use crate::publish::engine::{EngineSettings, Unavailable};
use crate::publish::send_queue::SendQueue;
use crate::publish::topic::{Qos, Topic as RosTopic};

// The binding prepends a header with this machine's byte order to our little-endian messages.
const _: () = assert!(cfg!(target_endian = "little"), "DDS needs a little-endian machine");

/// Length of the CDR header, which the binding writes itself.
const CDR_HEADER: usize = 4;

/// Maximum time that a write may block. `KeepLast` history always has room for the next message.
const WRITE_TIMEOUT: Duration = Duration::from_millis(100);

thread_local! {
    /// DDS name of the message type of the topic to create. The binding asks the Rust type for
    /// it, and here all messages have the same.
    static TYPE_NAME: RefCell<String> = const { RefCell::new(String::new()) };
}

/// Encoded message. Serializes as a tuple of bytes, without a length and without alignment, so
/// that the binding writes the bytes unchanged. Never read: this program has no DDS readers.
#[derive(Debug, Clone, Deserialize)]
struct Encoded(Vec<u8>);

impl Serialize for Encoded {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let body = self.0.get(CDR_HEADER..).unwrap_or_default();
        let mut tuple = serializer.serialize_tuple(body.len())?;
        body.iter().try_for_each(|byte| tuple.serialize_element(byte))?;
        tuple.end()
    }
}

impl Topicable for Encoded {
    type Key = ();

    fn from_key((): &()) -> Self {
        Self(Vec::new())
    }

    fn as_key(&self) {}

    fn dds_type_name() -> impl AsRef<str> {
        TYPE_NAME.with_borrow(String::clone)
    }
}

/// Opens a participant with a writer for each topic, and then one for discovery information.
/// Calls `opened`, which returns the participant's identity. Then writes the messages of `queue`
/// until it is closed and empty, and closes the participant.
///
/// `config` is Cyclone's configuration, as XML. Only the network can be a reason to retry.
pub(super) fn run(
    settings: &EngineSettings,
    config: &str,
    queue: &SendQueue,
    opened: impl FnOnce() -> Result<Prefix, String>,
) -> Result<(), Unavailable> {
    let failed = |error| format!("cannot open DDS: {error}");
    let never = |error| Unavailable::Permanently(format!("cannot create a DDS topic: {error}"));
    let topics = &queue.topics;
    let domain = Domain::new_with_xml_config(settings.domain.into(), config).map_err(failed)?;
    // Same as ROS 2's own participants.
    let participant = Participant::builder(&domain)
        .with_qos(&user_data(QoS::new(), "enclave=/;"))
        .build()
        .map_err(failed)?;
    let topic = |topic: &RosTopic| {
        TYPE_NAME.set(topic.message.dds_name());
        // ROS topics have a prefix in DDS.
        Topic::<Encoded>::new(&participant, &format!("rt{}", topic.name))
    };
    let dds_topics = topics.iter().map(topic).collect::<Result<Vec<_>, _>>();
    let dds_topics = dds_topics.map_err(never)?;
    let info_topic =
        Topic::<DiscoveryInfo>::new(&participant, discovery_info::TOPIC).map_err(never)?;
    let writer = |(topic, ros): (_, &RosTopic)| {
        let qos = qos(ros.qos, ros.depth, ros.kept.is_some());
        let qos = user_data(qos, &format!("typehash={};", ros.message.hash()));
        Writer::builder(topic).with_qos(&qos).build()
    };
    let writers = dds_topics.iter().zip(&**topics).map(writer).collect::<Result<Vec<_>, _>>();
    let writers = writers.map_err(never)?;
    let info_writer = Writer::builder(&info_topic)
        .with_qos(&qos(Qos::Reliable, 1, true))
        .build()
        .map_err(never)?;
    let prefix = opened()?;
    let announce = |nodes| {
        // An error means that Cyclone has no room: readers see topics without nodes.
        let _ = info_writer.write(&DiscoveryInfo::new(prefix, nodes, topics));
    };
    announce(&settings.nodes);
    while let Some(message) = queue.pop() {
        let Some(writer) = writers.get(message.topic) else { continue };
        match writer.write(&Encoded(message.payload)) {
            Ok(()) => message.counts.lock().add_published(),
            Err(_) => message.counts.lock().dropped += 1,
        }
        let readers = writer.matched_subscriptions().map_or(0, |readers| readers.len());
        message.counts.lock().readers = Some(readers);
    }
    // Removes the nodes immediately; otherwise they stay until the lease expires.
    announce(&[]);
    Ok(())
}

fn user_data(qos: QoS, text: &str) -> QoS {
    qos.with_user_data(UserData { value: text.as_bytes().to_vec() })
}

fn qos(qos: Qos, depth: usize, is_kept: bool) -> QoS {
    let depth = i32::try_from(depth).unwrap_or(i32::MAX);
    QoS::new()
        .with_durability(if is_kept { Durability::TransientLocal } else { Durability::Volatile })
        .with_history(History::KeepLast { depth })
        .with_reliability(match qos {
            Qos::Reliable => Reliability::Reliable { max_blocking_time: WRITE_TIMEOUT },
            Qos::Sensor => Reliability::BestEffort,
        })
}
