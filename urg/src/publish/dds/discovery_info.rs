//! Message `rmw_dds_common/msg/ParticipantEntitiesInfo`: maps writers to ROS nodes.

use cyclonedds::Topicable;
use serde::{Deserialize, Serialize};

use super::pulse::Prefix;
use crate::publish::names::NodeNames;
use crate::publish::topic::Topic;

/// Name of the topic. Unlike other ROS topics, it has no prefix in DDS.
pub(super) const TOPIC: &str = "ros_discovery_info";

/// Entity id of every participant.
const PARTICIPANT: [u8; 4] = [0, 0, 1, 0xC1];

/// Entity kind of a user-defined writer without keys.
const WRITER: u8 = 0x03;

#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Gid(Prefix, [u8; 4]);

#[derive(Debug, Clone, Default, Topicable, Serialize, Deserialize)]
#[dds(type_name = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_")]
pub(super) struct DiscoveryInfo {
    participant: Gid,
    /// Namespace, name, readers and writers of each node.
    nodes: Vec<(String, String, Vec<Gid>, Vec<Gid>)>,
}

impl DiscoveryInfo {
    /// Describes the nodes of a participant, which created a writer for each of `topics`, in order.
    pub(super) fn new(prefix: Prefix, nodes: &[NodeNames], topics: &[Topic]) -> Self {
        let node = |(number, names): (usize, &NodeNames)| {
            // Cyclone numbers entities from 1.
            let own = topics.iter().zip(1_u32..).filter(|(topic, _)| topic.node == number);
            let writer = |(_, number): (&Topic, u32)| {
                let [_, high, middle, low] = number.to_be_bytes();
                Gid(prefix, [high, middle, low, WRITER])
            };
            (names.namespace.clone(), names.node.clone(), Vec::new(), own.map(writer).collect())
        };
        let nodes = nodes.iter().enumerate().map(node).collect();
        Self { participant: Gid(prefix, PARTICIPANT), nodes }
    }
}
