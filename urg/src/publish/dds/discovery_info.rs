//! Encoder of `rmw_dds_common/msg/ParticipantEntitiesInfo`, which maps writers to ROS nodes.
//! DDS itself has no nodes.

use super::pulse::Prefix;
use crate::publish::engine::Topic;
use crate::publish::names::NodeNames;

/// Name of the topic. Unlike other ROS topics, it has no prefix in DDS.
pub(super) const TOPIC: &str = "ros_discovery_info";

/// Name of the type in DDS.
pub(super) const DDS_NAME: &str = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";

/// Entity id of every participant.
const PARTICIPANT: [u8; 4] = [0, 0, 1, 0xC1];

/// Entity kind of a user-defined writer without keys.
const WRITER: u8 = 0x03;

/// Encodes the nodes of a participant, which created a writer for each of `topics`, in this
/// order.
pub(super) fn encode(participant: Prefix, nodes: &[NodeNames], topics: &[Topic]) -> Vec<u8> {
    // Little-endian CDR.
    let mut message = CdrMessage(vec![0, 1, 0, 0]);
    message.gid(participant, PARTICIPANT);
    message.length(nodes.len());
    for (node, names) in nodes.iter().enumerate() {
        message.string(&names.namespace);
        message.string(&names.node);
        // No readers.
        message.length(0);
        // Cyclone numbers entities from 1.
        let own = topics.iter().zip(1_u32..).filter(|(topic, _)| topic.node == node);
        message.length(own.clone().count());
        for (_, number) in own {
            let [_, high, middle, low] = number.to_be_bytes();
            message.gid(participant, [high, middle, low, WRITER]);
        }
    }
    message.0
}

struct CdrMessage(Vec<u8>);

impl CdrMessage {
    fn length(&mut self, length: usize) {
        // CDR aligns from the end of its header, but four header bytes make no difference.
        self.0.resize(self.0.len().next_multiple_of(4), 0);
        let length = u32::try_from(length).unwrap_or(u32::MAX);
        self.0.extend_from_slice(&length.to_le_bytes());
    }

    fn string(&mut self, text: &str) {
        self.length(text.len() + 1);
        self.0.extend_from_slice(text.as_bytes());
        self.0.push(0);
    }

    fn gid(&mut self, prefix: Prefix, entity: [u8; 4]) {
        self.0.extend_from_slice(&prefix);
        self.0.extend_from_slice(&entity);
    }
}
