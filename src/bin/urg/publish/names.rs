//! The names of nodes, topics and frames: from the command line, checked against
//! ROS's rules, one set for each sensor.

use std::collections::BTreeSet;

use crate::failure::Failure;
use crate::port::named::{NamedPort, token};

/// The names of one sensor's node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct NodeNames {
    /// Absolute, `/` for none.
    pub(crate) namespace: String,
    pub(crate) node: String,
    /// Absolute.
    pub(crate) topic: String,
    pub(crate) frame: String,
}

impl NodeNames {
    /// Returns the names for each of `sensors`. The name of a sensor is a namespace
    /// of its own, for its node and its topic, and the beginning of its frame's.
    ///
    /// Fails if a name breaks ROS's rules, and if two sensors would share a topic.
    pub(crate) fn resolve(
        sensors: &[NamedPort],
        namespace: &str,
        node: &str,
        topic: &str,
        frame: &str,
    ) -> Result<Vec<Self>, Failure> {
        let usage = |option: &'static str| {
            move |reason: String| Failure::Usage(format!("{option}: {reason}"))
        };
        let namespace = path(namespace).map_err(usage("--namespace"))?;
        let node = token(node).map_err(usage("--node"))?;
        let topic_path = path(topic).map_err(usage("--topic"))?;
        let [topic_namespace @ .., base] = topic_path.as_slice() else {
            return Err(usage("--topic")("expected a name such as /scan".to_owned()));
        };
        if frame.is_empty() {
            return Err(usage("--frame")("expected a name such as laser".to_owned()));
        }
        let mut topics = BTreeSet::new();
        sensors
            .iter()
            .map(|sensor| {
                let name = sensor.name.as_deref();
                // A name that begins with `/` does not depend on the namespace.
                let own: &[&str] = if topic.starts_with('/') { &[] } else { &namespace };
                let parts = own.iter().chain(topic_namespace).copied().chain(name);
                let names = Self {
                    namespace: absolute(namespace.iter().copied().chain(name)),
                    node: node.to_owned(),
                    topic: absolute(parts.chain([*base])),
                    frame: name.map_or_else(|| frame.to_owned(), |name| format!("{name}_{frame}")),
                };
                if topics.insert(names.topic.clone()) {
                    Ok(names)
                } else {
                    Err(Failure::Usage(format!(
                        "two sensors would publish on {}: name each of them, such as \
                         `front=/dev/ttyACM0 rear=/dev/ttyACM1`",
                        names.topic
                    )))
                }
            })
            .collect()
    }
}

fn absolute<'a>(parts: impl Iterator<Item = &'a str>) -> String {
    format!("/{}", parts.collect::<Vec<_>>().join("/"))
}

/// Returns the parts of a name such as `/robot/scan`.
fn path(text: &str) -> Result<Vec<&str>, String> {
    let inner = text.strip_prefix('/').unwrap_or(text);
    if inner.is_empty() {
        return Ok(Vec::new());
    }
    inner.split('/').map(token).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensors(texts: &[&str]) -> Vec<NamedPort> {
        texts.iter().map(|text| text.parse().unwrap()).collect()
    }

    fn topics(texts: &[&str], namespace: &str, topic: &str) -> Vec<String> {
        let names = NodeNames::resolve(&sensors(texts), namespace, "urg_node", topic, "laser");
        names.unwrap().into_iter().map(|names| names.topic).collect()
    }

    #[test]
    fn the_name_of_a_sensor_is_a_namespace_of_its_own() {
        assert_eq!(topics(&["emulated"], "/", "/scan"), ["/scan"]);
        assert_eq!(topics(&["emulated"], "robot", "scan"), ["/robot/scan"]);
        assert_eq!(topics(&["emulated"], "/robot", "/scan"), ["/scan"]);
        let both = ["front=emulated", "rear=tcp://host:1?baud=19200"];
        assert_eq!(topics(&both, "/", "/scan"), ["/front/scan", "/rear/scan"]);
        assert_eq!(topics(&both, "/a/b", "c/scan"), ["/a/b/c/front/scan", "/a/b/c/rear/scan"]);
        let names =
            NodeNames::resolve(&sensors(&["front=emulated"]), "/a", "urg_node", "/scan", "laser");
        let names = names.unwrap().remove(0);
        assert_eq!((&*names.namespace, &*names.frame), ("/a/front", "front_laser"));
    }

    #[test]
    fn a_name_against_the_rules_of_ros_is_refused() {
        let one = sensors(&["emulated"]);
        for (namespace, node, topic, frame, option) in [
            ("/a//b", "n", "/scan", "f", "--namespace"),
            ("/a/", "n", "/scan", "f", "--namespace"),
            ("/", "", "/scan", "f", "--node"),
            ("/", "n", "/", "f", "--topic"),
            ("/", "n", "sc an", "f", "--topic"),
            ("/", "n", "/scan", "", "--frame"),
        ] {
            match NodeNames::resolve(&one, namespace, node, topic, frame) {
                Err(Failure::Usage(line)) => assert!(line.starts_with(option), "{line}"),
                other => panic!("{other:?}"),
            }
        }
    }

    #[test]
    fn two_sensors_on_one_topic_are_refused() {
        for texts in [["emulated", "emulated"], ["a=emulated", "a=emulated"]] {
            let names = NodeNames::resolve(&sensors(&texts), "/", "urg_node", "/scan", "laser");
            assert!(matches!(names, Err(Failure::Usage(_))), "{texts:?}");
        }
    }
}
