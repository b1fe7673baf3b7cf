//! Translates `--ros-args`, as of `ros2 run` and launch files, into options that clap checks.

use std::collections::BTreeSet;
use std::ffi::OsString;

use saphyr_parser::{Event, Parser, ScalarStyle};

use super::names::NodeNames;
use super::urg_node::{Effect, UrgNodeParameters};
use crate::failure::Failure;
use crate::output::notice::notice;

const BEGIN: &str = "--ros-args";
const END: &str = "--";

/// Key in a file that separates the names of nodes from their parameters.
const PARAMETERS: &str = "ros__parameters";

/// Maximum depth of YAML, which is walked by recursion.
const MAX_DEPTH: usize = 50;

/// Replaces all arguments between `--ros-args` and `--` with options of `urg publish` that come
/// last, because the last one applies. `nodes` parses a command line for the names of its nodes;
/// it returns none if the command line is invalid.
///
/// Unsupported flags, invalid values and unreadable files are usage errors, unknown names notices.
pub(crate) fn as_options(
    arguments: Vec<OsString>,
    nodes: impl Fn(&[OsString]) -> Vec<NodeNames>,
) -> Result<Vec<OsString>, Failure> {
    let (plain, ros) = RosArgs::split(&arguments)?;
    let with = |options: &[String]| {
        let end = plain.iter().position(|argument| argument == END).unwrap_or(plain.len());
        let (before, after) = plain.split_at(end);
        let options = options.iter().map(OsString::from);
        before.iter().cloned().chain(options).chain(after.iter().cloned()).collect::<Vec<_>>()
    };
    let mut options = ros.names();
    let nodes = nodes(&with(&options));
    if !nodes.is_empty() {
        options.extend(ros.topic(&nodes));
        options.extend(ros.parameters(&nodes)?);
    }
    Ok(with(&options))
}

#[derive(Default)]
struct RosArgs {
    /// Pairs of `-r FROM:=TO`.
    remappings: Vec<(String, String)>,
    /// Origin of parameters, for messages, and what it sets.
    sources: Vec<(String, Vec<Parameter>)>,
}

struct Parameter {
    /// Full name of the node. `*` stands for a part, and `**` for any number of parts.
    node: String,
    name: String,
    /// `None` unless it is one value.
    value: Option<String>,
}

impl RosArgs {
    /// Separates the arguments of ROS from all others.
    fn split(arguments: &[OsString]) -> Result<(Vec<OsString>, Self), Failure> {
        let (mut ros, mut plain, mut is_ros) = (Self::default(), Vec::new(), false);
        let mut arguments = arguments.iter().cloned();
        while let Some(argument) = arguments.next() {
            match is_ros {
                _ if argument == BEGIN => is_ros = true,
                true if argument == END => is_ros = false,
                true => ros.add(&argument.to_string_lossy(), &mut arguments)?,
                false => plain.push(argument),
            }
        }
        Ok((plain, ros))
    }

    /// Adds the meaning of `flag`, which takes its value from the arguments after it.
    fn add(
        &mut self,
        flag: &str,
        after: &mut impl Iterator<Item = OsString>,
    ) -> Result<(), Failure> {
        let mut value = |expected| {
            let value = after.next().and_then(|value| value.into_string().ok());
            value.ok_or_else(|| usage(format!("expected {expected} after {flag}")))
        };
        // Launch files pass flags for the log to all nodes.
        let unused = |text: &str| {
            notice(format_args!("`{text}` changes nothing: set RUST_LOG for a log"));
        };
        match flag {
            "-r" | "--remap" => {
                let text = value("FROM:=TO")?;
                let (_, from, to) = assignment(&text, "FROM:=TO")?;
                self.remappings.push((from.to_owned(), to.to_owned()));
            }
            "-p" | "--param" => {
                let text = value("NAME:=VALUE")?;
                let (node, name, yaml) = assignment(&text, "NAME:=VALUE")?;
                self.read(text.trim(), yaml, &[node.unwrap_or("/**"), PARAMETERS, name])?;
            }
            "--params-file" => {
                let path = value("a file")?;
                let yaml = std::fs::read_to_string(&path)
                    .map_err(|error| usage(format!("cannot use --params-file {path}: {error}")))?;
                self.read(&path, &yaml, &[])?;
            }
            _ if flag.starts_with("--log-") => unused(&format!("{flag} {}", value("a value")?)),
            _ if flag.starts_with("--enable-") || flag.starts_with("--disable-") => unused(flag),
            _ => {
                return Err(usage(format!(
                    "`{flag}` is not supported: expected -r FROM:=TO, -p NAME:=VALUE or \
                     --params-file FILE"
                )));
            }
        }
        Ok(())
    }

    /// Reads the parameters below `keys` in the first document of `yaml`, named `text` in messages.
    fn read(&mut self, text: &str, yaml: &str, keys: &[&str]) -> Result<(), Failure> {
        let mut events = Parser::new_from_str(yaml);
        let mut next = || match events.next_event().ok_or("it is empty")? {
            Ok((event, _)) => Ok(event),
            Err(error) => Err(format!("invalid YAML: {error}")),
        };
        let mut parameters = Vec::new();
        // After the starts of the stream and of the document.
        (next().and_then(|_| next()).and_then(|_| collect(&mut next, keys, &mut parameters)))
            .map_err(|why| usage(format!("`{text}`: {why}")))?;
        self.sources.push((text.to_owned(), parameters));
        Ok(())
    }

    /// Options for the names of the node. As in ROS, the first remapping of a name applies.
    fn names(&self) -> Vec<String> {
        let names = [("node", &["__node", "__name"][..]), ("namespace", &["__ns"][..])];
        let option = |(option, from): (&str, &[&str])| {
            let found = self.remappings.iter().find(|(name, _)| from.contains(&name.as_str()));
            found.map(|(_, to)| format!("--{option}={to}"))
        };
        names.into_iter().filter_map(option).collect()
    }

    /// Option for the topic, if it is remapped.
    fn topic(&self, nodes: &[NodeNames]) -> Option<String> {
        let mut topic = None;
        for (from, to) in &self.remappings {
            let is_topic =
                |node: &NodeNames| node.expanded(from).is_ok_and(|name| name == node.topic);
            if nodes.iter().any(is_topic) {
                topic.get_or_insert_with(|| format!("--topic={to}"));
            } else if !from.starts_with("__") {
                // ROS ignores remappings of unknown names: a launch file may apply them to all nodes.
                notice(format_args!("`{from}:={to}` changes nothing: only `scan` can be remapped"));
            }
        }
        topic
    }

    /// Options for the parameters of `nodes`, in their order: the last one applies.
    fn parameters(&self, nodes: &[NodeNames]) -> Result<Vec<String>, Failure> {
        let (mut options, mut urg_node) = (Vec::new(), UrgNodeParameters::default());
        let nodes: Vec<_> = nodes.iter().map(NodeNames::full_name).collect();
        for (text, parameters) in &self.sources {
            let is_ours = |it: &&Parameter| nodes.iter().any(|node| matches(&it.node, node));
            let mut ours = parameters.iter().filter(is_ours).peekable();
            if ours.peek().is_none() {
                notice(format_args!("`{text}` has no parameter for {}", nodes.join(" or ")));
            }
            for Parameter { name, value, .. } in ours {
                match &**name {
                    "frame" | "frame_id" | "laser_frame_id" | "qos" | "depth" | "time_offset"
                    | "domain" | "interface" | "rate" | "window" | "from" | "to" | "cluster"
                    | "tf" | "engine" | "router" | "mode" | "listen" | "topic" | "baud"
                    | "protocol" | "timeout" => {
                        let why = || usage(format!("`{text}`: expected one value for {name}"));
                        let value = value.as_ref().ok_or_else(why)?;
                        let name = name.trim_start_matches("laser_").replace('_', "-");
                        options.push(format!("--{name}={value}"));
                    }
                    "use_sim_time" => {
                        let value = value.as_deref().map(str::to_ascii_lowercase);
                        let Some("false" | "no" | "off" | "n") = value.as_deref() else {
                            let why = "a sensor measures in the system's time";
                            return Err(usage(format!("use_sim_time is not supported: {why}")));
                        };
                    }
                    _ => {
                        let effect = urg_node.take(name, value.as_deref());
                        let why = match effect.map_err(|why| usage(format!("`{text}`: {why}")))? {
                            Effect::Taken => continue,
                            Effect::Nothing(why) => why,
                            Effect::Unknown => "urg publish has none of this name",
                        };
                        notice(format_args!(
                            "the parameter {name} of `{text}` changes nothing: {why}"
                        ));
                    }
                }
            }
        }
        if urg_node.are_used() {
            notice(
                "there is no life cycle: it publishes at once, and a launch file that waits for \
                 a transition waits forever",
            );
        }
        options.extend(urg_node.options().map_err(usage)?);
        Ok(options)
    }
}

fn usage(line: String) -> Failure {
    Failure::Usage(format!("{BEGIN}: {line}"))
}

/// Splits `NODE:NAME:=VALUE`; `NODE:` is optional.
fn assignment<'a>(
    text: &'a str,
    expected: &str,
) -> Result<(Option<&'a str>, &'a str, &'a str), Failure> {
    let (name, value) = text.split_once(":=").unwrap_or((text, ""));
    let (node, name) = name.split_once(':').map_or((None, name), |(node, name)| (Some(node), name));
    if name.is_empty() || value.trim().is_empty() {
        return Err(usage(format!("expected {expected}, found `{text}`")));
    }
    Ok((node, name, value))
}

/// Collects the parameters in the next value, which is below `keys`: names of nodes, which may be
/// nested, then [`PARAMETERS`], then the name of the parameter.
fn collect<'a>(
    next: &mut dyn FnMut() -> Result<Event<'a>, String>,
    keys: &[&str],
    parameters: &mut Vec<Parameter>,
) -> Result<(), String> {
    let expected = || "expected `NODE: {ros__parameters: {NAME: VALUE}}`".to_owned();
    let value = match next()? {
        Event::MappingStart(..) if keys.len() == MAX_DEPTH => {
            return Err(format!("invalid YAML: expected at most {MAX_DEPTH} levels"));
        }
        Event::MappingStart(..) => loop {
            match next()? {
                Event::MappingEnd => return Ok(()),
                Event::Scalar(key, ..) => collect(next, &[keys, &[&key]].concat(), parameters)?,
                _ => return Err(expected()),
            }
        },
        Event::SequenceStart(..) => {
            let mut depth = 1;
            while depth > 0 {
                depth += match next()? {
                    Event::SequenceStart(..) | Event::MappingStart(..) => 1,
                    Event::SequenceEnd | Event::MappingEnd => -1,
                    _ => 0,
                };
            }
            None
        }
        Event::Scalar(text, style, ..) => {
            let is_null = style == ScalarStyle::Plain && ["", "~", "null"].contains(&&*text);
            (!is_null).then(|| text.into_owned())
        }
        _ => None,
    };
    let mut parts = keys.splitn(2, |key| *key == PARAMETERS);
    let (nodes, names) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
    if names.is_empty() {
        return Err(expected());
    }
    let node = nodes.iter().map(|name| format!("/{}", name.trim_matches('/'))).collect();
    parameters.push(Parameter { node, name: names.join("."), value });
    Ok(())
}

/// Checks whether `pattern` stands for `node`.
fn matches(pattern: &str, node: &str) -> bool {
    let parts: Vec<_> = node.trim_start_matches('/').split('/').collect();
    // Numbers of parts that the pattern so far can stand for.
    let mut reached = BTreeSet::from([0]);
    for part in pattern.trim_start_matches('/').split('/') {
        let is_next = |at: &&usize| parts.get(**at).is_some_and(|name| ["*", name].contains(&part));
        reached = match (part, reached.first()) {
            ("**", Some(first)) => (*first..=parts.len()).collect(),
            _ => reached.iter().filter(is_next).map(|at| at + 1).collect(),
        };
    }
    reached.contains(&parts.len())
}
