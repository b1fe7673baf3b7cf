//! Translates `--ros-args`, as passed by `ros2 run` and launch files, into ordinary options, so
//! that clap checks both.

use std::ffi::OsString;

use crate::failure::Failure;
use crate::output::notice::notice;

const BEGIN: &str = "--ros-args";
const END: &str = "--";

/// Replaces each argument between `--ros-args` and `--` with an option of `urg publish`. An
/// unsupported flag is a usage error; an unknown name only prints a notice.
pub(crate) fn as_options(arguments: Vec<OsString>) -> Result<Vec<OsString>, Failure> {
    let mut options = Vec::new();
    let mut arguments = arguments.into_iter();
    let mut is_inside = false;
    while let Some(argument) = arguments.next() {
        if argument == BEGIN {
            is_inside = true;
        } else if !is_inside {
            options.push(argument);
        } else if argument == END {
            is_inside = false;
        } else {
            let name = argument.to_string_lossy().into_owned();
            let option = match &*name {
                "-r" | "--remap" => remapped(&value(&name, arguments.next())?)?,
                "-p" | "--param" => parameter(&value(&name, arguments.next())?)?,
                "--log-level" | "--log-config-file" | "--log-file-name" => {
                    let value = arguments.next().ok_or_else(|| {
                        Failure::Usage(format!("{BEGIN}: expected a value after {name}"))
                    })?;
                    unused_log_flag(&format!("{name} {}", value.to_string_lossy()))
                }
                _ if is_log_switch(&name) => unused_log_flag(&name),
                _ => {
                    return Err(Failure::Usage(format!(
                        "{BEGIN}: `{name}` is not supported: expected -r FROM:=TO or -p NAME:=VALUE"
                    )));
                }
            };
            options.extend(option.map(OsString::from));
        }
    }
    Ok(options)
}

fn value(name: &str, argument: Option<OsString>) -> Result<String, Failure> {
    let text = argument.and_then(|argument| argument.into_string().ok());
    text.ok_or_else(|| Failure::Usage(format!("{BEGIN}: expected NAME:=VALUE after {name}")))
}

/// Checks for flags such as `--disable-stdout-logs`.
fn is_log_switch(name: &str) -> bool {
    let log = name.strip_prefix("--enable-").or_else(|| name.strip_prefix("--disable-"));
    matches!(log, Some("rosout-logs" | "stdout-logs" | "external-lib-logs"))
}

/// Launch files pass flags for the log to all nodes.
fn unused_log_flag(text: &str) -> Option<String> {
    notice(format_args!("`{text}` changes nothing: set RUST_LOG for a log"));
    None
}

/// Splits `NODE:NAME:=VALUE`. Ignores the optional `NODE:`, because all nodes are of one kind.
fn split(text: &str) -> Result<(&str, &str), Failure> {
    let (name, value) = text.split_once(":=").unwrap_or((text, ""));
    let name = name.rsplit_once(':').map_or(name, |(_, name)| name);
    if name.is_empty() || value.is_empty() {
        return Err(Failure::Usage(format!("{BEGIN}: expected NAME:=VALUE, found `{text}`")));
    }
    Ok((name, value))
}

fn remapped(text: &str) -> Result<Option<String>, Failure> {
    let (from, to) = split(text)?;
    let option = match from {
        "__node" | "__name" => "node",
        "__ns" => "namespace",
        "scan" | "/scan" => "topic",
        // ROS ignores remappings of unknown names: a launch file may apply them to all nodes.
        _ => {
            notice(format_args!("`{text}` changes nothing: only `scan` can be remapped"));
            return Ok(None);
        }
    };
    Ok(Some(format!("--{option}={to}")))
}

fn parameter(text: &str) -> Result<Option<String>, Failure> {
    let (name, value) = split(text)?;
    let option = match name {
        // Usual name in other drivers.
        "frame_id" => "frame".to_owned(),
        "use_sim_time" if value.eq_ignore_ascii_case("false") => return Ok(None),
        "use_sim_time" => {
            return Err(Failure::Usage(format!(
                "{BEGIN}: use_sim_time is not supported: a sensor measures in the system's time"
            )));
        }
        "frame" | "qos" | "depth" | "time_offset" | "domain" | "interface" | "rate" | "start"
        | "end" | "from" | "to" | "cluster" | "tf" | "engine" | "router" | "mode" | "topic" => {
            name.replace('_', "-")
        }
        _ => {
            notice(format_args!("`{text}` changes nothing: urg publish has no such parameter"));
            return Ok(None);
        }
    };
    Ok(Some(format!("--{option}={value}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(text: &str) -> Result<String, Failure> {
        let options = as_options(text.split(' ').map(OsString::from).collect())?;
        Ok(options.join(" ".as_ref()).into_string().unwrap())
    }

    #[test]
    fn ros_arguments_become_the_options_that_mean_the_same() {
        for (text, expected) in [
            (
                "publish emulated --ros-args -r __node:=front -r __ns:=/robot -r scan:=laser/scan",
                "publish emulated --node=front --namespace=/robot --topic=laser/scan",
            ),
            (
                "publish --ros-args -p frame_id:=f -p time_offset:=-0.05 -- emulated",
                "publish --frame=f --time-offset=-0.05 emulated",
            ),
            ("publish --ros-args --ros-args -p urg_node:depth:=3", "publish --depth=3"),
            ("publish a --ros-args -p use_sim_time:=False -r /tf:=tf -p other:=1", "publish a"),
            ("publish a -- b", "publish a -- b"),
            ("publish a --ros-args --log-level urg:=debug --disable-stdout-logs", "publish a"),
            ("publish --ros-args --enable-rosout-logs --log-file-name x -- a", "publish a"),
        ] {
            assert_eq!(options(text).unwrap(), expected);
        }
    }
}
