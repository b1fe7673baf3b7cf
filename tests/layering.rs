//! Checks the modules of every package: those side by side depend on each other in one direction,
//! so that you can read a file without the files above it. The library's also keep to the order
//! of design.md's list, and `protocol` uses no runtime, clock or log.
//!
//! Reads imports and paths, not Rust: comments and `mod tests` do not count.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Modules from the top down: each may use the later ones in this list.
const ORDER: [&str; 12] = [
    "sensor", "stream", "driver", "state", "ring", "stats", "port", "codec", "scan", "rate",
    "error", "protocol",
];
const NOT_IN_PROTOCOL: [&str; 10] =
    ["Instant", "SystemTime", "tokio", "tracing", "futures", "io", "net", "fs", "thread", "log"];

/// Sources by their path, relative to `src`.
type Sources = BTreeMap<String, String>;

fn read(folder: &Path, prefix: &str, sources: &mut Sources) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = format!("{prefix}{}", path.file_name().unwrap().to_str().unwrap());
        if path.is_dir() {
            read(&path, &format!("{name}/"), sources);
        } else if name.ends_with(".rs") && !name.ends_with("tests.rs") && !name.contains("tests/") {
            let text = std::fs::read_to_string(&path).unwrap();
            let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
            let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
            sources.insert(name, lines.collect::<Vec<_>>().join("\n"));
        }
    }
}

fn words(code: &str) -> impl Iterator<Item = &str> {
    code.split(|c: char| !c.is_alphanumeric() && c != '_').filter(|word| !word.is_empty())
}

/// Returns the first names after each `prefix`: of `prefix::{a::b, c}` these are a and c.
fn names_behind<'a>(code: &'a str, prefix: &str) -> Vec<&'a str> {
    let mut names = Vec::new();
    for (at, _) in code.match_indices(prefix) {
        let rest = &code[at + prefix.len()..];
        let Some(group) = rest.strip_prefix('{') else {
            names.extend(words(rest).next());
            continue;
        };
        let mut depth = 1;
        for part in group.split_inclusive(['{', ',', '}']) {
            if depth == 1 {
                names.extend(words(part).next());
            }
            depth += i32::from(part.ends_with('{')) - i32::from(part.ends_with('}'));
            if depth == 0 {
                break;
            }
        }
    }
    names
}

/// Returns which of its siblings each module in `folder` ("" is the crate) uses, also
/// through what their parent re-exports.
fn uses(sources: &Sources, folder: &str) -> BTreeMap<String, BTreeSet<String>> {
    let inside = sources.iter().filter_map(|(path, code)| Some((path.strip_prefix(folder)?, code)));
    let mut modules: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    let mut parent = "";
    let mut names = Vec::new();
    for (path, code) in inside {
        if matches!(path, "lib.rs" | "main.rs" | "mod.rs") {
            parent = code;
            continue;
        }
        let steps: Vec<&str> = path.trim_end_matches(".rs").split('/').collect();
        let module = steps[0].to_owned();
        let depth = steps.iter().filter(|step| **step != "mod").count();
        let from_root = format!("crate::{}", folder.replace('/', "::"));
        let from_here = "super::".repeat(depth);
        for prefix in [from_root, from_here] {
            names
                .extend(names_behind(code, &prefix).into_iter().map(|name| (module.clone(), name)));
        }
        modules.entry(module).or_default();
    }
    let mut exports = BTreeMap::new();
    for (module, name) in parent.split("use ").skip(1).flat_map(|import| {
        let import = import.split(';').next().unwrap_or_default();
        let mut path = words(import).skip_while(|word| matches!(*word, "crate" | "self"));
        path.next().into_iter().flat_map(move |module| {
            words(import).map(move |name| (module.to_owned(), name)).collect::<Vec<_>>()
        })
    }) {
        exports.entry(name).or_insert(module);
    }
    for (module, name) in names {
        let target = exports.get(name).map_or(name, String::as_str).to_owned();
        if target != module && modules.contains_key(&target) {
            modules.entry(module).or_default().insert(target);
        }
    }
    modules
}

/// Removes modules that use none of those left, until none is left or all that are left
/// stand on or above a circle.
fn circle(mut modules: BTreeMap<String, BTreeSet<String>>) -> Vec<String> {
    while let Some(free) = modules.iter().find(|(_, uses)| uses.is_empty()).map(|(n, _)| n.clone())
    {
        modules.remove(&free);
        modules.values_mut().for_each(|uses| uses.retain(|name| *name != free));
    }
    modules.into_keys().collect()
}

/// Reads the sources of a package. `folder` is relative to the workspace: `.` is the library.
fn sources(folder: &str) -> Sources {
    let mut sources = Sources::new();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    read(&root.join(folder).join("src"), "", &mut sources);
    sources
}

/// Lists the folders of the workspace's packages.
fn packages() -> Vec<&'static str> {
    let (_, members) = include_str!("../Cargo.toml").split_once("members = [").unwrap();
    let (members, _) = members.split_once(']').unwrap();
    std::iter::once(".").chain(members.split('"').skip(1).step_by(2)).collect()
}

#[test]
fn dependencies_point_down_only() {
    let mut crates = uses(&sources("."), "");
    crates.remove("guide");
    for (module, used) in crates {
        let place = |name: &str| ORDER.iter().position(|module| *module == name);
        let here = place(&module).unwrap_or_else(|| panic!("{module} has no place in the order"));
        for target in used {
            assert!(place(&target).is_some_and(|below| below > here), "{module} uses {target}");
        }
    }
}

#[test]
fn modules_side_by_side_have_no_circles() {
    for package in packages() {
        let sources = sources(package);
        let folders = sources.keys().filter_map(|path| Some(&path[..=path.rfind('/')?]));
        let folders: BTreeSet<&str> = folders.chain([""]).collect();
        assert!(folders.len() > 1, "{package}: {sources:?}");
        for folder in folders {
            assert_eq!(circle(uses(&sources, folder)), [""; 0], "in {package}/src/{folder}");
        }
    }
}

#[test]
fn protocol_names_no_runtime_clock_or_log() {
    for (path, code) in sources(".").iter().filter(|(path, _)| path.starts_with("protocol/")) {
        for word in words(code) {
            assert!(!NOT_IN_PROTOCOL.contains(&word), "{path} names {word}");
        }
    }
}

#[test]
fn a_dependency_is_found_however_it_is_written() {
    for (root, a, b) in [
        ("", "use crate::p::b::B;", "use super::a::A;"),
        ("", "fn f() { super::b::g() }", "use super::{c::D, a};"),
        ("pub use a::A; pub(crate) use self::b::{B, C};", "use super::{C, E};", "use super::A;"),
    ] {
        let files = [("p/mod.rs", root), ("p/a.rs", a), ("p/b/mod.rs", b), ("p/c.rs", "")];
        let sources = files.map(|(path, code)| (path.to_owned(), code.to_owned())).into();
        assert_eq!(circle(uses(&sources, "p/")), ["a", "b"], "{root} {a} {b}");
    }
}
