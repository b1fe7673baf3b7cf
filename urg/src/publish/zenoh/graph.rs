//! Keys and metadata of messages, and the liveliness tokens that add nodes and publishers to the
//! ROS graph, in the format of `rmw_zenoh`.

use std::time::SystemTime;

use twox_hash::XxHash3_128;

use crate::publish::names::NodeNames;
use crate::publish::topic::{Qos, Topic};

pub(super) struct GraphNode<'a> {
    pub(super) domain: u16,
    pub(super) session_id: &'a str,
    pub(super) number: usize,
    pub(super) names: &'a NodeNames,
}

impl GraphNode<'_> {
    /// Formats the token of the node itself (0, `NN`) or of one of its publishers (`MP`). Entity
    /// ids are unique in the session: four per node.
    pub(super) fn token(&self, entity: usize, kind: &str) -> String {
        let Self { domain, session_id, number, names } = self;
        let (node, entity) = (number * 4, number * 4 + entity);
        let (namespace, name) = (mangled(&names.namespace), &names.node);
        format!("@ros2_lv/{domain}/{session_id}/{node}/{entity}/{kind}/%/{namespace}/{name}")
    }

    /// `entity` is the number of the topic on this node, from 1.
    pub(super) fn publisher_token(&self, topic: &Topic, entity: usize) -> String {
        let token = self.token(entity, "MP");
        let name = mangled(&topic.name);
        let (message, hash) = (topic.message.dds_name(), topic.message.hash());
        // The key contains only differences from the ROS default, which is reliable.
        let reliability = if topic.qos == Qos::Reliable { "" } else { "2" };
        let durability = if topic.kept.is_some() { "1" } else { "" };
        let depth = topic.depth;
        format!("{token}/{name}/{message}/{hash}/{reliability}:{durability}:,{depth}:,:,:,,")
    }

    pub(super) fn key(&self, topic: &Topic) -> String {
        let name = topic.name.trim_start_matches('/');
        format!("{}/{name}/{}/{}", self.domain, topic.message.dds_name(), topic.message.hash())
    }
}

/// Replaces slashes, which separate the parts of a key.
fn mangled(name: &str) -> String {
    name.replace('/', "%")
}

pub(super) type Gid = [u8; 16];

pub(super) fn gid(token: &str) -> Gid {
    XxHash3_128::oneshot(token.as_bytes()).to_le_bytes()
}

/// Encodes the metadata of a message: sequence number, time, GID of the publisher.
pub(super) fn attachment(sequence: i64, time: SystemTime, gid: Gid) -> Vec<u8> {
    let since_1970 = time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let nanos = i64::try_from(since_1970.as_nanos()).unwrap_or(i64::MAX);
    let gid_length = [16];
    [&sequence.to_le_bytes()[..], &nanos.to_le_bytes(), &gid_length, &gid].concat()
}
