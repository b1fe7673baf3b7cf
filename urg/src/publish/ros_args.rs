//! Translates `--ros-args`, as passed by `ros2 run` and launch files, into ordinary options, so
//! that clap checks both.

use std::collections::BTreeSet;
use std::ffi::OsString;

use saphyr::{ScalarStyle, YamlLoader, YamlOwned};
use saphyr_parser::{Event, Parser, SpannedEventReceiver};

use super::names::NodeNames;
use crate::failure::Failure;
use crate::output::notice::notice;

const BEGIN: &str = "--ros-args";
const END: &str = "--";

/// Maximum depth of YAML, which is walked by recursion.
const MAX_DEPTH: u32 = 50;

/// Replaces all arguments between `--ros-args` and `--` with options of `urg publish` that come
/// last, because the last one applies. `nodes` parses a command line for the names of its nodes;
/// it returns none if the command line is invalid.
///
/// An unsupported flag, an invalid value, and a file that cannot be read are usage errors. An
/// unknown name only prints a notice.
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
    sources: Vec<Source>,
}

/// Origin of parameters, for messages, and what it sets.
struct Source {
    text: String,
    parameters: Vec<Parameter>,
}

struct Parameter {
    /// Full name of the node. `*` stands for a part, and `**` for any number of parts.
    node: String,
    name: String,
    value: YamlOwned,
}

impl RosArgs {
    /// Separates the arguments of ROS from all others.
    fn split(arguments: &[OsString]) -> Result<(Vec<OsString>, Self), Failure> {
        let mut ros = Self::default();
        let mut parts = arguments.split(|argument| argument == BEGIN);
        let mut plain = parts.next().unwrap_or_default().to_vec();
        for part in parts {
            let end = part.iter().position(|argument| argument == END).unwrap_or(part.len());
            let (inside, after) = part.split_at(end);
            plain.extend(after.iter().skip(1).cloned());
            let mut inside = inside.iter().cloned();
            while let Some(flag) = inside.next() {
                ros.add(&flag.to_string_lossy(), &mut inside)?;
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
                let value = load(yaml).map_err(|why| usage(format!("`{text}`: {why}")))?;
                let (node, name) = (node.unwrap_or("/**").to_owned(), name.to_owned());
                let parameters = vec![Parameter { node, name, value }];
                self.sources.push(Source { text: text.trim().to_owned(), parameters });
            }
            "--params-file" => {
                let (text, mut parameters) = (value("a file")?, Vec::new());
                std::fs::read_to_string(&text)
                    .map_err(|error| error.to_string())
                    .and_then(|yaml| collect("", &load(&yaml)?, &mut parameters))
                    .map_err(|why| usage(format!("cannot use --params-file {text}: {why}")))?;
                self.sources.push(Source { text, parameters });
            }
            _ if flag.starts_with("--log-") => {
                unused(&format!("{flag} {}", value("a value")?));
            }
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
                // ROS ignores remappings of unknown names: a launch file may apply them to all
                // nodes.
                notice(format_args!("`{from}:={to}` changes nothing: only `scan` can be remapped"));
            }
        }
        topic
    }

    /// Options for the parameters of `nodes`, in their order: the last one applies.
    fn parameters(&self, nodes: &[NodeNames]) -> Result<Vec<String>, Failure> {
        let mut options = Vec::new();
        for Source { text, parameters } in &self.sources {
            let nodes: Vec<_> = nodes.iter().map(NodeNames::full_name).collect();
            let is_ours = |it: &&Parameter| nodes.iter().any(|node| matches(&it.node, node));
            let ours: Vec<_> = parameters.iter().filter(is_ours).collect();
            if ours.is_empty() {
                notice(format_args!("`{text}` has no parameter for {}", nodes.join(" or ")));
            }
            for parameter in ours {
                options.extend(parameter.option(text)?);
            }
        }
        Ok(options)
    }
}

impl Parameter {
    fn option(&self, text: &str) -> Result<Option<String>, Failure> {
        let name = &*self.name;
        let option = match name {
            // Usual name in other drivers.
            "frame_id" => "frame".to_owned(),
            "use_sim_time" => String::new(),
            "frame" | "qos" | "depth" | "time_offset" | "domain" | "interface" | "rate"
            | "start" | "end" | "from" | "to" | "cluster" | "tf" | "engine" | "router" | "mode"
            | "listen" | "topic" => name.replace('_', "-"),
            _ => {
                notice(format_args!(
                    "the parameter {name} of `{text}` changes nothing: urg publish has none of \
                     this name"
                ));
                return Ok(None);
            }
        };
        let value = match &self.value {
            YamlOwned::Representation(value, style, _)
                if *style != ScalarStyle::Plain || !["", "~", "null"].contains(&&**value) =>
            {
                value
            }
            _ => return Err(usage(format!("`{text}`: expected one value for {name}"))),
        };
        if option.is_empty() {
            return match &*value.to_ascii_lowercase() {
                "false" | "no" | "off" | "n" => Ok(None),
                _ => Err(usage(
                    "use_sim_time is not supported: a sensor measures in the system's time"
                        .to_owned(),
                )),
            };
        }
        Ok(Some(format!("--{option}={value}")))
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

/// Loads the first document, with each scalar as it was written.
fn load(text: &str) -> Result<YamlOwned, String> {
    let invalid = |error| format!("invalid YAML: {error}");
    let mut loader = YamlLoader::<YamlOwned>::default();
    loader.early_parse(false);
    let mut depth = 0;
    for event in Parser::new_from_str(text) {
        let (event, span) = event.map_err(|error| invalid(error.to_string()))?;
        match event {
            Event::MappingStart(..) | Event::SequenceStart(..) => depth += 1,
            Event::MappingEnd | Event::SequenceEnd => depth -= 1,
            _ => {}
        }
        if depth > MAX_DEPTH {
            return Err(invalid(format!("expected at most {MAX_DEPTH} levels")));
        }
        loader.on_event(event, span);
    }
    if let Some(error) = loader.error() {
        return Err(invalid(error.to_string()));
    }
    loader.into_documents().into_iter().next().ok_or_else(|| "it is empty".to_owned())
}

/// Collects the parameters in a file: names of nodes, which may be nested, and in each
/// `ros__parameters`.
fn collect(node: &str, yaml: &YamlOwned, parameters: &mut Vec<Parameter>) -> Result<(), String> {
    let expected = || "expected `NODE: {ros__parameters: {NAME: VALUE}}`".to_owned();
    for (key, value) in yaml.as_mapping().ok_or_else(expected)? {
        let YamlOwned::Representation(key, ..) = key else { return Err(expected()) };
        if key != "ros__parameters" {
            collect(&format!("{node}/{}", key.trim_matches('/')), value, parameters)?;
            continue;
        }
        for (name, value) in value.as_mapping().ok_or_else(expected)? {
            let YamlOwned::Representation(name, ..) = name else { return Err(expected()) };
            let (node, name) = (node.to_owned(), name.clone());
            parameters.push(Parameter { node, name, value: value.clone() });
        }
    }
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
