//! Encoder of `rmw_dds_common/msg/ParticipantEntitiesInfo`, which maps writers to ROS nodes.
//! DDS itself has no nodes.

use super::rtps::Prefix;
use crate::publish::engine::NodeSpec;

/// Name of the topic. Unlike other ROS topics, it has no prefix in DDS.
pub(super) const TOPIC: &str = "ros_discovery_info";

/// Name of the type in DDS.
pub(super) const DDS_NAME: &str = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";

/// Entity id of every participant.
const PARTICIPANT: [u8; 4] = [0, 0, 1, 0xC1];

/// Entity kind of a user-defined writer without keys.
const WRITER: u8 = 0x03;

/// Encodes the nodes of a participant.
///
/// Assumes that the participant created its writers in this order: `writers_each` writers for
/// each node, the writer of this message, and with `has_transforms` one more for the first
/// node.
pub(super) fn encode(
    participant: Prefix,
    nodes: &[NodeSpec],
    writers_each: usize,
    has_transforms: bool,
) -> Vec<u8> {
    let transforms = u32::try_from(nodes.len() * writers_each + 2).ok().filter(|_| has_transforms);
    let mut transforms = transforms.into_iter().collect::<Vec<_>>();
    // Cyclone numbers entities from 1.
    let mut numbers = 1_u32..;
    // Little-endian CDR.
    let mut message = CdrMessage(vec![0, 1, 0, 0]);
    message.gid(participant, PARTICIPANT);
    message.length(nodes.len());
    for node in nodes {
        message.string(&node.namespace);
        message.string(&node.name);
        // No readers.
        message.length(0);
        let own: Vec<_> = numbers.by_ref().take(writers_each).chain(transforms.drain(..)).collect();
        message.length(own.len());
        for number in own {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_is_encoded_with_the_identities_of_its_writers() {
        let node = |namespace: &str| NodeSpec {
            namespace: namespace.to_owned(),
            name: "urg".to_owned(),
            scan_topic: "/scan".to_owned(),
        };
        let message = encode([7; 12], &[node("/"), node("/b")], 2, false);
        let gid = |entity: [u8; 4]| [&[7; 12][..], &entity].concat();
        let expected = [
            &[0, 1, 0, 0][..],
            &gid([0, 0, 1, 0xC1]),
            &[2, 0, 0, 0],
            &[2, 0, 0, 0, b'/', 0, 0, 0],
            &[4, 0, 0, 0, b'u', b'r', b'g', 0],
            &[0, 0, 0, 0],
            &[2, 0, 0, 0],
            &gid([0, 0, 1, 3]),
            &gid([0, 0, 2, 3]),
            &[3, 0, 0, 0, b'/', b'b', 0, 0],
            &[4, 0, 0, 0, b'u', b'r', b'g', 0],
            &[0, 0, 0, 0],
            &[2, 0, 0, 0],
            &gid([0, 0, 3, 3]),
            &gid([0, 0, 4, 3]),
        ];
        assert_eq!(message, expected.concat());
    }

    #[test]
    fn the_first_node_has_the_writer_of_the_transforms() {
        let node = NodeSpec {
            namespace: "/".to_owned(),
            name: "urg".to_owned(),
            scan_topic: "/scan".to_owned(),
        };
        let message = encode([7; 12], &[node.clone(), node], 2, true);
        // Participant, node 1 with writers 1, 2 and 6, node 2 with writers 3 and 4.
        let entities: Vec<u8> = message
            .windows(12)
            .zip(message.iter().skip(14))
            .filter(|(gid, _)| *gid == [7; 12])
            .map(|(_, number)| *number)
            .collect();
        assert_eq!(entities, [1, 1, 2, 6, 3, 4]);
    }

    #[test]
    fn an_ended_participant_has_no_nodes() {
        assert_eq!(encode([7; 12], &[], 2, true)[20..], [0, 0, 0, 0]);
    }
}
