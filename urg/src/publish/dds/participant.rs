//! Wrapper of the Cyclone DDS binding: a participant with one writer per topic. No other file
//! uses the binding.
//!
//! Writers borrow topics, and topics borrow the participant, so one function owns them all, on
//! one thread.

use std::cell::RefCell;

use cyclonedds::qos::policy::{Durability, History, Reliability, UserData};
use cyclonedds::{Domain, Duration, Participant, QoS, Topic, Topicable, Writer};
use serde::de::{Deserialize, Deserializer, Error};
use serde::ser::{Serialize, SerializeTuple, Serializer};

use super::discovery_info;
use crate::publish::engine::{self, Qos, Unavailable};
use crate::publish::send_queue::SendQueue;

// The binding prepends a header with this machine's byte order to our little-endian messages.
const _: () = assert!(cfg!(target_endian = "little"), "DDS needs a little-endian machine");

/// Length of the CDR header, which the binding writes itself.
const CDR_HEADER: usize = 4;

/// Maximum time that a write may block. `KeepLast` history always has room for the next
/// message.
const WRITE_TIMEOUT: Duration = Duration::from_millis(100);

thread_local! {
    /// DDS name of the message type of the topic to create. The binding asks the Rust type for
    /// it, and here all messages have the same.
    static TYPE_NAME: RefCell<String> = const { RefCell::new(String::new()) };
}

/// Encoded message. Serializes as a tuple of bytes, without a length and without alignment, so
/// that the binding writes the bytes unchanged.
#[derive(Debug, Clone)]
struct Encoded(Vec<u8>);

impl Serialize for Encoded {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let body = self.0.get(CDR_HEADER..).unwrap_or_default();
        let mut tuple = serializer.serialize_tuple(body.len())?;
        body.iter().try_for_each(|byte| tuple.serialize_element(byte))?;
        tuple.end()
    }
}

/// Required by the binding, never used: this program has no DDS readers.
impl<'de> Deserialize<'de> for Encoded {
    fn deserialize<D: Deserializer<'de>>(_: D) -> Result<Self, D::Error> {
        Err(D::Error::custom("messages are only written"))
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

/// Opens a participant with a writer for each of `topics`, and then one for discovery
/// information. Calls `opened`, writes the messages of `queue` until it is closed and empty, and
/// closes the participant.
///
/// `config` is Cyclone's configuration, as XML. Only the network can be a reason to retry.
pub(super) fn run(
    domain: u16,
    config: &str,
    topics: &[engine::Topic],
    queue: &SendQueue,
    opened: impl FnOnce(),
) -> Result<(), Unavailable> {
    let failed = |what: &'static str| move |error| format!("cannot {what}: {error}");
    let never = |what| move |error| Unavailable::Permanently(failed(what)(error));
    let domain = Domain::new_with_xml_config(domain.into(), config).map_err(failed("open DDS"))?;
    // Same as ROS 2's own participants. Without it, ROS 2 Kilted shows endpoints without names.
    let enclave = QoS::new().with_user_data(UserData { value: b"enclave=/;".to_vec() });
    let participant = Participant::builder(&domain)
        .with_qos(&enclave)
        .build()
        .map_err(failed("create a DDS participant"))?;
    let topic = |name: &str, type_name: String| {
        TYPE_NAME.set(type_name);
        Topic::<Encoded>::new(&participant, name).map_err(never("create a DDS topic"))
    };
    // ROS topics have a prefix in DDS.
    let ros_topics =
        topics.iter().map(|ros| topic(&format!("rt{}", ros.name), ros.message.dds_name()));
    let info = topic(discovery_info::TOPIC, discovery_info::DDS_NAME.to_owned());
    let dds_topics = ros_topics.chain([info]).collect::<Result<Vec<_>, _>>()?;
    let ros_qos = topics.iter().map(|ros| {
        let hash = format!("typehash={};", ros.message.hash());
        qos(ros.qos, ros.depth, ros.is_kept).with_user_data(UserData { value: hash.into_bytes() })
    });
    let writers = dds_topics
        .iter()
        .zip(ros_qos.chain([qos(Qos::Reliable, 1, true)]))
        .map(|(topic, qos)| Writer::builder(topic).with_qos(&qos).build())
        .collect::<Result<Vec<_>, _>>()
        .map_err(never("create a DDS writer"))?;
    opened();
    while let Some(message) = queue.pop() {
        let Some(writer) = writers.get(message.topic) else { continue };
        match writer.write(&Encoded(message.payload)) {
            Ok(()) => message.counts.lock().add_published(),
            Err(_) => message.counts.lock().dropped += 1,
        }
        let readers = writer.matched_subscriptions().map_or(0, |readers| readers.len());
        message.counts.lock().readers = Some(readers);
    }
    Ok(())
}

fn qos(qos: Qos, depth: usize, is_kept: bool) -> QoS {
    let depth = i32::try_from(depth).unwrap_or(i32::MAX);
    QoS::new()
        .with_durability(match is_kept {
            true => Durability::TransientLocal,
            false => Durability::Volatile,
        })
        .with_history(History::KeepLast { depth })
        .with_reliability(match qos {
            Qos::Reliable => Reliability::Reliable { max_blocking_time: WRITE_TIMEOUT },
            Qos::Sensor => Reliability::BestEffort,
        })
}
