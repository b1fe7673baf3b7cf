//! Names of nodes, topics and frames of each sensor: from the command line, by the rules of ROS.

use std::collections::BTreeSet;

use crate::args::frame_id;
use crate::failure::Failure;
use crate::port::named::{NamedPort, token};

/// Maximum length of the name of a topic or node, including its namespace. DDS allows 255
/// bytes, some of them for the prefix that ROS adds.
const MAX_NAME: usize = 240;

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "ROS")]
pub(crate) struct NameArgs {
    /// Topic of the scans: `scan` is in the namespace, `/scan` in none, `~/scan` in the node
    #[arg(long, value_name = "NAME", default_value = "scan")]
    topic: String,
    /// Name of the node
    #[arg(long, value_name = "NAME", default_value = "urg_node")]
    node: String,
    /// Namespace of the node
    #[arg(long, value_name = "NAME", default_value = "/")]
    namespace: String,
    /// Coordinate frame of the scans
    #[arg(long, visible_alias = "frame-id", value_name = "NAME", default_value = "laser",
        value_parser = frame_id)]
    frame: String,
}

#[derive(Debug, Clone, Default)]
pub(crate) struct NodeNames {
    /// Absolute; `/` if there is no namespace.
    pub(crate) namespace: String,
    pub(crate) node: String,
    /// Absolute.
    pub(crate) topic: String,
    pub(crate) frame: String,
}

impl NodeNames {
    pub(crate) fn full_name(&self) -> String {
        format!("{}/{}", self.namespace.trim_end_matches('/'), self.node)
    }

    /// Expands the name of a topic as ROS does: `/scan` is absolute, `~/scan` is in the node, and
    /// `scan` is in the node's namespace.
    pub(super) fn expanded(&self, name: &str) -> Result<String, String> {
        let (base, inner) = match (name.strip_prefix('/'), name.strip_prefix("~/")) {
            (Some(inner), _) => (String::new(), inner),
            (None, Some(inner)) => (self.full_name(), inner),
            (None, None) => (self.namespace.trim_end_matches('/').to_owned(), name),
        };
        if inner.is_empty() {
            return Err("expected a name such as scan".to_owned());
        }
        Ok(base + &absolute(parts(inner, name)?.into_iter()))
    }
}

impl NameArgs {
    /// Computes the names for each of `sensors`. The name of a sensor becomes a namespace for
    /// its node, and a prefix of its frame.
    ///
    /// Usage errors: a name that breaks the rules of ROS, and two sensors on one topic.
    pub(crate) fn resolve(&self, sensors: &[NamedPort]) -> Result<Vec<NodeNames>, Failure> {
        let Self { topic, node, namespace, frame } = self;
        let usage = |option: &'static str| {
            move |reason: String| Failure::Usage(format!("{option}: {reason}"))
        };
        let inner = namespace.strip_prefix('/').unwrap_or(namespace);
        let namespace = match inner {
            "" => Vec::new(),
            _ => parts(inner, namespace).map_err(usage("--namespace"))?,
        };
        let node = token(node).map_err(usage("--node"))?;
        let mut topics = BTreeSet::new();
        let named = sensors.iter().map(|sensor| {
            let name = sensor.name.as_deref();
            let mut names = NodeNames {
                namespace: absolute(namespace.iter().copied().chain(name)),
                node: node.to_owned(),
                topic: String::new(),
                frame: name.map_or_else(|| frame.to_owned(), |name| format!("{name}_{frame}")),
            };
            names.topic = names.expanded(topic).map_err(usage("--topic"))?;
            if names.topic.len() > MAX_NAME || names.full_name().len() > MAX_NAME {
                return Err(Failure::Usage(format!(
                    "the name of a node or topic is too long: expected at most {MAX_NAME} \
                     characters with its namespace"
                )));
            }
            if topics.insert(names.topic.clone()) {
                return Ok(names);
            }
            Err(Failure::Usage(format!(
                "two sensors would publish on {}: name each of them, such as \
                 `front=/dev/ttyACM0 rear=/dev/ttyACM1`, and give --topic no leading `/`",
                names.topic
            )))
        });
        named.collect()
    }
}

fn absolute<'a>(parts: impl Iterator<Item = &'a str>) -> String {
    format!("/{}", parts.collect::<Vec<_>>().join("/"))
}

/// Splits `inner`, which is `name` without its prefix, into its parts.
fn parts<'a>(inner: &'a str, name: &str) -> Result<Vec<&'a str>, String> {
    if inner.split('/').any(str::is_empty) {
        return Err(format!(
            "invalid name `{name}`: expected no empty part, as between two `/` or after the last"
        ));
    }
    inner.split('/').map(token).collect()
}
