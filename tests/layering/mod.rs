//! Checks that the modules of `src` depend on each other in one direction only, so that a
//! file can be read without those above it, and that `protocol` uses no async runtime,
//! clock or log.

mod circles;
mod source;

use std::collections::BTreeMap;
use std::path::Path;

use source::{code, read, words};

/// The modules from the top down: each may use those behind it in this list.
const ORDER: [&str; 14] = [
    "sensor", "stream", "driver", "ring", "state", "observer", "port", "codec", "ros", "event",
    "scan", "rate", "error", "protocol",
];

/// Modules that may use the whole crate; only the program and tests use them.
const ASIDE: [&str; 2] = ["emulator", "recording"];

/// Words that `protocol` must not contain: I/O, clocks and logs.
const NOT_IN_PROTOCOL: [&str; 10] =
    ["Instant", "SystemTime", "io", "net", "fs", "thread", "log", "println", "eprintln", "dbg"];
/// Beginnings of the names of crates that `protocol` must not use.
const NO_CRATE_IN_PROTOCOL: [&str; 3] = ["tokio", "tracing", "futures"];

#[test]
fn dependencies_point_down_only() {
    let violations = violations(&sources());
    assert!(violations.is_empty(), "\n{}\n", violations.join("\n"));
}

/// Reads all of `src`, with paths relative to it.
fn sources() -> Vec<(String, String)> {
    let mut sources = Vec::new();
    read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), "", &mut sources);
    assert!(sources.iter().any(|(path, _)| path == "protocol/window.rs"), "src was not read");
    sources
}

/// Returns the violations, a line each.
fn violations(sources: &[(String, String)]) -> Vec<String> {
    let lib = sources.iter().find(|(path, _)| path == "lib.rs").map_or("", |(_, text)| text);
    let exports = exports(&code(lib));
    let mut found = Vec::new();
    for (path, text) in sources {
        let modules = modules(path);
        let Some(module) = modules.first() else { continue };
        if matches!(module.as_str(), "bin" | "guide" | "lib") || modules.last().unwrap() == "tests"
        {
            continue;
        }
        let code = code(text);
        let aside = ASIDE.contains(&module.as_str());
        let Some(place) = place(module).or(aside.then_some(0)) else {
            found.push(format!("{path}: the module {module} has no place in the order"));
            continue;
        };
        for name in names_of_the_crate(&code, modules.len()) {
            let target = exports.get(&name).unwrap_or(&name);
            if target == module || aside {
                continue;
            }
            match self::place(target) {
                Some(below) if below > place => {}
                Some(_) => found.push(format!("{path}: {module} uses {target} ({name}) above it")),
                None => found.push(format!("{path}: {module} must not use crate::{name}")),
            }
        }
        if module == "protocol" {
            for word in words(&code) {
                if NOT_IN_PROTOCOL.contains(&word)
                    || NO_CRATE_IN_PROTOCOL.iter().any(|name| word.starts_with(name))
                {
                    found.push(format!("{path}: protocol names {word}"));
                }
            }
        }
    }
    found
}

fn place(module: &str) -> Option<usize> {
    ORDER.iter().position(|name| *name == module)
}

/// Returns the modules that a file is in: `driver/session.rs` is `driver::session`.
fn modules(path: &str) -> Vec<String> {
    let path = path.strip_suffix(".rs").unwrap_or(path);
    path.strip_suffix("/mod").unwrap_or(path).split('/').map(str::to_owned).collect()
}

/// Returns the module that each name exported by `lib.rs` comes from.
fn exports(lib: &str) -> BTreeMap<String, String> {
    let mut exports = BTreeMap::new();
    for statement in lib.split(';').filter_map(|part| part.split_once("use ")) {
        let mut words = words(statement.1).filter(|word| !matches!(*word, "crate" | "self"));
        if let Some(module) = words.next() {
            exports.extend(words.map(|name| (name.to_owned(), module.to_owned())));
        }
    }
    exports
}

/// Returns the names that code in a module `depth` deep takes from the crate's root: those
/// behind `crate::`, or behind as many `super::` as lead there.
fn names_of_the_crate(code: &str, depth: usize) -> Vec<String> {
    let code: String = code.chars().filter(|c| !c.is_whitespace()).collect();
    let to_root = "super::".repeat(depth);
    let mut names = Vec::new();
    for root in ["crate::", &to_root] {
        for (at, _) in code.match_indices(root) {
            let rest = &code[at + root.len()..];
            if let Some(group) = rest.strip_prefix('{') {
                names.extend(group_members(group).into_iter().map(first_name));
            } else if !rest.starts_with("super::") {
                names.push(first_name(rest));
            }
        }
    }
    names
}

fn first_name(path: &str) -> String {
    if path.starts_with('*') { "*".to_owned() } else { words(path).next().unwrap_or("").to_owned() }
}

/// Splits a group of imports, without its opening brace, into its members.
fn group_members(group: &str) -> Vec<&str> {
    let (mut members, mut depth, mut start) = (Vec::new(), 0, 0);
    for (at, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth > 0 => depth -= 1,
            ',' | '}' if depth == 0 => {
                members.push(&group[start..at]);
                start = at + 1;
                if c == '}' {
                    break;
                }
            }
            _ => {}
        }
    }
    members.retain(|member| !member.is_empty());
    members
}

const LIB: &str = "mod sensor; pub mod protocol;
    pub use sensor::{Builder, Sensor};
    #[cfg(feature = \"emulator\")] pub use crate::emulator::Emulator;
    pub use protocol::Window;";

fn violations_of(path: &str, text: &str) -> Vec<String> {
    let sources = [("lib.rs", LIB), (path, text)];
    violations(&sources.map(|(path, text)| (path.to_owned(), text.to_owned())))
}

#[test]
fn an_import_upward_is_found_however_it_is_written() {
    for (path, text) in [
        ("scan.rs", "use crate::driver::Session;"),
        ("scan.rs", "use crate::{protocol::Window, driver::{self, Session}};"),
        ("scan.rs", "use crate::{\n    error::Error,\n    sensor,\n};"),
        ("scan.rs", "fn f() { crate :: driver::session::run() }"),
        ("scan.rs", "use super::driver;"),
        ("scan.rs", "use crate::*;"),
        ("scan.rs", "const QUOTE: char = '\"'; use crate::driver; const END: char = '\"';"),
        ("scan.rs", "#[cfg(test)] mod tests { fn f() {} } use crate::driver;"),
        ("scan.rs", "#[cfg(test)]\nmod tests;\nuse crate::driver;"),
        ("state.rs", "use crate::ring::Ring;"),
        ("port/serial.rs", "use crate::Sensor;"),
        ("port/serial.rs", "use super::super::{stream::ScanStream};"),
        ("port/mod.rs", "use crate::unheard_of;"),
        ("driver/mod.rs", "use crate::Emulator;"),
        ("driver/session.rs", "use crate::recording::Recorder;"),
        ("protocol/window.rs", "use crate::error::Error;"),
        ("protocol/window.rs", "use std::time::{Duration, Instant};"),
        ("protocol/mod.rs", "fn now() -> std::time::SystemTime { loop {} }"),
        ("protocol/mod.rs", "use tokio_util::bytes;"),
        ("protocol/mod.rs", "fn f() { tracing::warn!(\"hm\") }"),
        ("helpers.rs", ""),
    ] {
        assert_eq!(violations_of(path, text).len(), 1, "{path}: {text}");
    }
}

#[test]
fn downward_dependencies_and_text_are_accepted() {
    for (path, text) in [
        ("sensor.rs", "use crate::{driver::Request, stream::ScanStream, Window, Builder};"),
        ("driver/session.rs", "use super::schedule; use super::super::codec::ScipCodec;"),
        ("ring.rs", "use crate::state::Stats; pub(crate) fn f<'a>(_: &'a str) {}"),
        ("port/mod.rs", "/// [`Sensor`](crate::Sensor)\nuse crate::{Window, error::Error};"),
        ("scan.rs", "/* crate::driver */ const A: &str = \"crate::driver\";"),
        (
            "scan.rs",
            "const A: &str = r#\"\"crate::driver\"#; const B: &str = \"\\\"crate::driver\";",
        ),
        ("scan.rs", "#[cfg(test)]\nmod tests {\n use crate::emulator::Emulator; fn f() {}\n}"),
        ("driver/tests.rs", "use crate::emulator::Emulator;"),
        ("emulator/device.rs", "use crate::{sensor::Sensor, protocol::Command};"),
        ("bin/urg/main.rs", "use tokio_scip::emulator::Emulator; use crate::output;"),
        ("protocol/baud.rs", "use std::time::Duration; // not tokio's\nuse super::Window;"),
    ] {
        assert_eq!(violations_of(path, text), [""; 0], "{path}: {text}");
    }
}
