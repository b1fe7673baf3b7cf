//! Keys of messages, and the liveliness tokens that add nodes and publishers to the ROS graph,
//! in the format of `rmw_zenoh`.

use tokio_scip::ros::MessageType;
use twox_hash::XxHash3_128;

use crate::publish::engine::{NodeSpec, Qos};

/// Node in the ROS graph.
pub(super) struct GraphNode<'a> {
    pub(super) domain: u16,
    pub(super) session_id: String,
    pub(super) number: usize,
    pub(super) spec: &'a NodeSpec,
}

impl GraphNode<'_> {
    /// Entity ids are unique in the session: four per node.
    fn entity(&self, entity: usize) -> usize {
        self.number * 4 + entity
    }

    fn token(&self, entity: usize, kind: &str) -> String {
        let Self { domain, session_id, spec, .. } = self;
        let (node, entity) = (self.entity(0), self.entity(entity));
        let (namespace, name) = (mangled(&spec.namespace), &spec.name);
        format!("@ros2_lv/{domain}/{session_id}/{node}/{entity}/{kind}/%/{namespace}/{name}")
    }

    pub(super) fn node_token(&self) -> String {
        self.token(0, "NN")
    }

    pub(super) fn publisher_token(&self, topic: &Topic<'_>) -> String {
        let token = self.token(topic.entity, "MP");
        let name = mangled(topic.name);
        let (message, hash) = (topic.message.dds_name(), topic.message.hash());
        // The key contains only differences from the ROS default, which is reliable.
        let reliability = match topic.qos {
            Qos::Reliable => "",
            Qos::Sensor => "2",
        };
        let durability = if topic.is_kept { "1" } else { "" };
        format!(
            "{token}/{name}/{message}/{hash}/{reliability}:{durability}:,{}:,:,:,,",
            topic.depth
        )
    }
}

/// Topic of a node.
pub(super) struct Topic<'a> {
    /// Absolute.
    pub(super) name: &'a str,
    pub(super) message: &'a MessageType,
    pub(super) qos: Qos,
    pub(super) depth: usize,
    /// Whether late readers get the last message (transient local).
    pub(super) is_kept: bool,
    /// Entity number within the node.
    pub(super) entity: usize,
}

impl Topic<'_> {
    pub(super) fn key(&self, domain: u16) -> String {
        let name = self.name.trim_start_matches('/');
        format!("{domain}/{name}/{}/{}", self.message.dds_name(), self.message.hash())
    }
}

/// Replaces slashes, which separate the parts of a key.
fn mangled(name: &str) -> String {
    name.replace('/', "%")
}

/// Computes the GID of the publisher with this token.
pub(super) fn gid(token: &str) -> [u8; 16] {
    XxHash3_128::oneshot(token.as_bytes()).to_le_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_publisher_has_the_identity_that_others_compute_from_its_token() {
        let token = "@ros2_lv/7/1b42ce9e071392be9bd8b5c60d108967/0/1/MP/%/%/urg_node/%scan/\
                     sensor_msgs::msg::dds_::LaserScan_/RIHS01_64c191398013af96509d518dac71d5164f\
                     9382553fce5c1f8cca5be7924bd828/::,20:,:,:,,";
        let hex: String = gid(token).iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(hex, "7fdd3c7864607827008077793c63c525");
    }
}
