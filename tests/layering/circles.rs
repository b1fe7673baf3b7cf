//! Checks that no sibling modules depend on each other in a circle: of two files in a
//! folder, or two folders, one can be read without the other.
//!
//! A dependency is a path in code that leads to an item of the other module, through any
//! re-exports. A folder depends on everything that a file in it depends on. A module may
//! use its children and they may use it; but an item that a child takes from a sibling
//! through their parent's `use` is a dependency on that sibling. Unit tests do not count.

use std::collections::{BTreeMap, BTreeSet};

use super::source::code;

/// The names of the modules on the path from a crate's root.
type Module = Vec<String>;

/// The imports and other paths of a file, split at `::`.
#[derive(Default)]
struct Paths {
    /// The path that each imported name stands for.
    imports: Vec<(String, Vec<String>)>,
    /// All paths that are used, including those of private imports.
    used: Vec<Vec<String>>,
}

/// The modules of one crate.
struct Tree {
    modules: BTreeMap<Module, Paths>,
}

/// Returns every circle in the sources, each as the path around it.
fn circles(sources: &[(String, String)]) -> Vec<String> {
    const PROGRAM: &str = "bin/urg/";
    let (program, library): (Vec<_>, Vec<_>) =
        sources.iter().partition(|(path, _)| path.starts_with(PROGRAM));
    let mut found = Vec::new();
    for (sources, folder) in [(library, ""), (program, PROGRAM)] {
        let tree = Tree::new(&sources, folder);
        for (parent, siblings) in tree.dependencies() {
            let place = format!("{folder}{}", parent.join("/"));
            found.extend(ways_around(&siblings).map(|way| format!("{place}: {way}")));
        }
    }
    found
}

impl Tree {
    fn new(sources: &[&(String, String)], folder: &str) -> Self {
        let mut modules = BTreeMap::<Module, Paths>::new();
        for (path, text) in sources {
            let path = path.strip_prefix(folder).unwrap_or(path);
            let path = path.strip_suffix(".rs").unwrap_or(path);
            let path = match path {
                "lib" | "main" => "",
                path => path.strip_suffix("/mod").unwrap_or(path),
            };
            let module: Module =
                path.split('/').filter(|name| !name.is_empty()).map(str::to_owned).collect();
            if module.last().is_none_or(|name| name != "tests") {
                for length in 0..module.len() {
                    modules.entry(module[..length].to_vec()).or_default();
                }
                modules.insert(module, Paths::read(&code(text)));
            }
        }
        Self { modules }
    }

    /// Returns for each module which of its children depend on which.
    fn dependencies(&self) -> BTreeMap<Module, BTreeMap<&str, BTreeSet<&str>>> {
        let mut all: BTreeMap<_, BTreeMap<_, BTreeSet<_>>> = BTreeMap::new();
        for (from, paths) in &self.modules {
            for to in paths.used.iter().filter_map(|path| self.target(from, path, 0)) {
                let common = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
                let Some(from_child) = from.get(common) else { continue };
                let Some((to, _)) = self.modules.get_key_value(&to) else { continue };
                let Some(to_child) = to.get(common) else { continue };
                let siblings = all.entry(from[..common].to_vec()).or_default();
                siblings.entry(from_child.as_str()).or_default().insert(to_child.as_str());
            }
        }
        all
    }

    /// Returns the module that has the item of a path in `from`; `None` in other crates.
    fn target(&self, from: &Module, path: &[String], depth: usize) -> Option<Module> {
        let mut module = from.clone();
        let mut rest = path;
        match path.first()?.as_str() {
            "crate" => module.clear(),
            "self" => {}
            "super" => {
                module.pop()?;
            }
            name if self.child(from, name).is_some() => rest = path.get(..)?,
            _ => return None,
        }
        if matches!(path[0].as_str(), "crate" | "self" | "super") {
            rest = &path[1..];
        }
        while let Some((name, after)) = rest.split_first() {
            if name == "super" {
                module.pop()?;
            } else if let Some(child) = self.child(&module, name) {
                module = child;
            } else {
                let imports = &self.modules.get(&module)?.imports;
                let import = imports.iter().find(|(alias, _)| alias == name);
                // A name may be imported from a module that imports it, too.
                let Some((_, import)) = import.filter(|_| depth < 8) else { break };
                let whole: Vec<_> = import.iter().chain(after).cloned().collect();
                return self.target(&module, &whole, depth + 1).or(Some(module));
            }
            rest = after;
        }
        Some(module)
    }

    fn child(&self, module: &Module, name: &str) -> Option<Module> {
        let child: Module = module.iter().cloned().chain([name.to_owned()]).collect();
        self.modules.contains_key(&child).then_some(child)
    }
}

impl Paths {
    fn read(code: &str) -> Self {
        let tokens = tokens(code);
        let mut paths = Self::default();
        let mut at = 0;
        while at < tokens.len() {
            let end = at + tokens[at..].iter().position(|t| *t == ";").unwrap_or(tokens.len() - at);
            if tokens[at] == "use" {
                // `pub use`, `pub(crate) use`: other modules find the name here.
                let is_public = at > 0 && matches!(tokens[at - 1], "pub" | ")");
                paths.tree(&tokens[at + 1..end], &[], is_public);
                at = end;
            } else if is_name(tokens[at]) {
                let mut path = vec![tokens[at].to_owned()];
                while tokens.get(at + 1) == Some(&"::")
                    && tokens.get(at + 2).is_some_and(|t| is_name(t))
                {
                    path.push(tokens[at + 2].to_owned());
                    at += 2;
                }
                // `mod name;` is not a use.
                if path.len() > 1 {
                    paths.used.push(path);
                }
                at += 1;
            } else {
                at += 1;
            }
        }
        paths
    }

    /// Parses `a::b`, `a as b` or `a::{b, c::d}` behind `prefix`.
    fn tree(&mut self, tokens: &[&str], prefix: &[&str], is_public: bool) {
        let mut path = prefix.to_vec();
        let mut at = 0;
        while let Some(token) = tokens.get(at) {
            match *token {
                "{" => {
                    let (mut depth, mut start) = (0, at + 1);
                    for (place, token) in tokens.iter().enumerate().skip(at) {
                        match *token {
                            "{" => depth += 1,
                            "}" => depth -= 1,
                            _ => {}
                        }
                        if depth == 0 || depth == 1 && *token == "," {
                            self.tree(&tokens[start..place], &path, is_public);
                            start = place + 1;
                        }
                        if depth == 0 {
                            return;
                        }
                    }
                    return;
                }
                "as" => break,
                "::" => {}
                // `a::{self}` is `a`.
                "self" if !path.is_empty() => {}
                name => path.push(name),
            }
            at += 1;
        }
        let path: Vec<_> = path.into_iter().map(str::to_owned).collect();
        let Some(last) = path.last() else { return };
        let alias = if tokens.get(at) == Some(&"as") { tokens.get(at + 1) } else { None };
        let alias = alias.map_or(last.as_str(), |alias| alias).to_owned();
        if !is_public {
            self.used.push(path.clone());
        }
        self.imports.push((alias, path));
    }
}

fn is_name(token: &str) -> bool {
    token.starts_with(|c: char| c.is_alphabetic() || c == '_')
}

/// Splits code into names, `::`, and single characters.
fn tokens(code: &str) -> Vec<&str> {
    let mut tokens = Vec::new();
    let mut rest = code.trim_start();
    while let Some(c) = rest.chars().next() {
        let is_part = |c: char| c.is_alphanumeric() || c == '_';
        let length = if is_part(c) {
            rest.find(|c| !is_part(c)).unwrap_or(rest.len())
        } else if rest.starts_with("::") {
            2
        } else {
            c.len_utf8()
        };
        tokens.push(&rest[..length]);
        rest = rest[length..].trim_start();
    }
    tokens
}

/// Returns a path from each name back to itself, each circle once.
fn ways_around(graph: &BTreeMap<&str, BTreeSet<&str>>) -> impl Iterator<Item = String> {
    let mut known = BTreeSet::new();
    let ways = graph.keys().filter_map(move |&start| {
        // Breadth first, so that each path is the shortest.
        let mut ways = vec![vec![start]];
        let mut seen = BTreeSet::new();
        while !ways.is_empty() {
            let mut longer = Vec::new();
            for way in ways {
                for &next in graph.get(way.last()?).into_iter().flatten() {
                    if next == start {
                        let names: BTreeSet<_> = way.iter().copied().collect();
                        return known
                            .insert(names)
                            .then(|| [&way[..], &[start]].concat().join(" → "));
                    }
                    if seen.insert(next) {
                        longer.push([&way[..], &[next]].concat());
                    }
                }
            }
            ways = longer;
        }
        None
    });
    ways.collect::<Vec<_>>().into_iter()
}

#[test]
fn no_modules_side_by_side_depend_on_each_other_in_a_circle() {
    let circles = circles(&super::sources());
    assert!(circles.is_empty(), "\n{}\n", circles.join("\n"));
}

fn circles_of(sources: &[(&str, &str)]) -> Vec<String> {
    let sources: Vec<_> =
        sources.iter().map(|(path, text)| ((*path).to_owned(), (*text).to_owned())).collect();
    circles(&sources)
}

#[test]
fn a_circle_is_found_however_its_paths_are_written() {
    for (sources, expected) in [
        (&[("p/a.rs", "use super::b::B;"), ("p/b.rs", "use crate::p::a::A;")][..], "p: a → b → a"),
        (&[("p/a.rs", "fn f() { super::b::g() }"), ("p/b.rs", "use super::a;")], "p: a → b → a"),
        // Through an import of their parent, also under another name.
        (
            &[
                ("p/mod.rs", "mod a; mod b; pub use a::A; use b::{self, B as C};"),
                ("p/a.rs", "use super::C;"),
                ("p/b.rs", "use super::{A};"),
            ],
            "p: a → b → a",
        ),
        (
            &[
                ("lib.rs", "pub use p::A;"),
                ("p/mod.rs", "pub(crate) use self::a::A;"),
                ("p/a.rs", "use super::b::{c::{D}, E};"),
                ("p/b.rs", "use std::fmt; use crate::A;"),
            ],
            "p: a → b → a",
        ),
        (
            &[
                ("p/a.rs", "use super::b;"),
                ("p/b.rs", "use super::c;"),
                ("p/c.rs", "use super::{a::{self}};"),
            ],
            "p: a → b → c → a",
        ),
        // Between two folders, though no two of their files form a circle.
        (
            &[
                ("p/mod.rs", ""),
                ("q/mod.rs", ""),
                ("p/a.rs", "use crate::q::c;"),
                ("p/b.rs", ""),
                ("q/c.rs", ""),
                ("q/d.rs", "use crate::p::b;"),
            ],
            ": p → q → p",
        ),
        // In the program, where `crate` is another crate.
        (
            &[
                ("bin/urg/main.rs", "mod args; mod commands;"),
                ("bin/urg/args.rs", "use crate::commands::scan::Scan;"),
                ("bin/urg/commands/mod.rs", "mod scan;"),
                ("bin/urg/commands/scan.rs", "use crate::args::Link;"),
            ],
            "bin/urg/: args → commands → args",
        ),
    ] {
        assert_eq!(circles_of(sources), [expected], "{sources:?}");
    }
}

#[test]
fn dependencies_without_a_circle_are_accepted() {
    for sources in [
        // A parent and its children.
        &[
            ("p/mod.rs", "mod a; pub use a::A; struct P; fn f() { a::g() }"),
            ("p/a.rs", "use super::P;"),
        ][..],
        // One direction only, and names of another crate.
        &[("p/a.rs", "use super::b::B; use std::a;"), ("p/b.rs", "use a::A; use tokio::p::a;")],
        // A re-export of a parent belongs to its child.
        &[
            ("p/mod.rs", "pub use a::A; pub use b::B;"),
            ("p/a.rs", "use super::B;"),
            ("p/b.rs", "use super::Other;"),
        ],
        // Comments, string literals and unit tests.
        &[
            ("p/a.rs", "use super::b;"),
            ("p/b.rs", "//! [`super::a`]\nconst A: &str = \"super::a\"; /* super::a::f() */"),
            ("p/c.rs", "use super::d;"),
            ("p/d.rs", "#[cfg(test)]\nmod tests { use super::super::c; }"),
            ("p/e.rs", "use super::f;"),
            ("p/f/mod.rs", "#[cfg(test)]\nmod tests;"),
            ("p/f/tests.rs", "use crate::p::e;"),
        ],
    ] {
        assert_eq!(circles_of(sources), [""; 0], "{sources:?}");
    }
}
