//! Checks that each row of `list.txt` has a test named after it, and that each test
//! named after a row has that row.

use std::collections::BTreeSet;
use std::path::Path;

const LIST: &str = include_str!("list.txt");

/// A row of the list.
struct CoverageRow<'a> {
    id: &'a str,
    /// Reason why there is no test, where there cannot be one.
    absent: Option<&'a str>,
}

/// Parses the rows: `w06  a data byte is dropped`, or, for a row without a test,
/// `o23  the disk is full -- absent: there is no recorder`.
fn rows(list: &str) -> Vec<CoverageRow<'_>> {
    let lines = list.lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
    lines
        .map(|line| {
            let (id, text) = line.split_once("  ").expect(line);
            let absent = text.split_once(" -- absent: ").map(|(_, reason)| reason.trim());
            CoverageRow { id, absent }
        })
        .collect()
}

fn is_id(word: &str) -> bool {
    let [letter, digits @ ..] = word.as_bytes() else { return false };
    b"wtdoa".contains(letter) && digits.len() == 2 && digits.iter().all(u8::is_ascii_digit)
}

/// Returns the ids at the beginning of the names of the test functions in `source`.
fn tested(source: &str) -> BTreeSet<String> {
    let mut ids = BTreeSet::new();
    let mut under_attribute = false;
    for line in source.lines().map(str::trim) {
        if line.starts_with("#[test]") || line.starts_with("#[tokio::test") {
            under_attribute = true;
        } else if let Some(name) = line.strip_prefix("async fn ").or(line.strip_prefix("fn ")) {
            if std::mem::take(&mut under_attribute) {
                let words = name.split(['_', '(']).take_while(|word| is_id(word));
                ids.extend(words.map(str::to_owned));
            }
        } else if !line.starts_with("#[") && !line.is_empty() {
            under_attribute = false;
        }
    }
    ids
}

/// Returns the rows and tests that do not match, a line each.
fn complaints(list: &str, tested: &BTreeSet<String>) -> Vec<String> {
    let rows = rows(list);
    let mut found = Vec::new();
    for (n, row) in rows.iter().enumerate() {
        let has_test = tested.contains(row.id);
        match row.absent {
            _ if !is_id(row.id) => found.push(format!("{} is not an id", row.id)),
            _ if rows[..n].iter().any(|other| other.id == row.id) => {
                found.push(format!("{} appears twice", row.id));
            }
            None if !has_test => found.push(format!("{} has no test", row.id)),
            Some(_) if has_test => {
                found.push(format!("{} is marked absent but has a test", row.id))
            }
            Some("") => found.push(format!("{} is absent without a reason", row.id)),
            _ => {}
        }
    }
    let unknown = tested.iter().filter(|id| rows.iter().all(|row| row.id != **id));
    found.extend(unknown.map(|id| format!("{id} is not in the list")));
    found
}

fn read(folder: &Path, ids: &mut BTreeSet<String>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            read(&path, ids);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            ids.extend(tested(&std::fs::read_to_string(path).unwrap()));
        }
    }
}

#[test]
fn every_row_has_a_test_or_a_reason() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut ids = BTreeSet::new();
    for folder in ["tests", "src", "recording/tests"] {
        read(&root.join(folder), &mut ids);
    }
    let complaints = complaints(LIST, &ids);
    assert!(complaints.is_empty(), "\n{}\n", complaints.join("\n"));
    // W wire, T timing, D device, O operating system, A tasks.
    assert_eq!(rows(LIST).len(), 27 + 16 + 16 + 27 + 17);
}

#[test]
fn each_row_has_a_test() {
    let tested = |names: &[&str]| {
        let source: String = names.iter().map(|n| format!("#[test]\nfn {n}() {{\n}}\n")).collect();
        tested(&source)
    };
    let list = "# a comment\n\nw01  one\nw02  two\nt01  three -- absent: no clock\n";
    assert_eq!(complaints(list, &tested(&["w01_w02_both"])), [""; 0]);
    assert_eq!(complaints(list, &tested(&["w01_one"])), ["w02 has no test"]);
    assert_eq!(complaints(list, &tested(&["w01_one", "about_w02"])), ["w02 has no test"]);
    assert_eq!(
        complaints(list, &tested(&["w01_w02_t01_x"])),
        ["t01 is marked absent but has a test"]
    );
    assert_eq!(complaints(list, &tested(&["w01_w02_w03_x"])), ["w03 is not in the list"]);
    assert_eq!(complaints("w01  one\nw01  two", &tested(&["w01_x"])), ["w01 appears twice"]);
    assert_eq!(complaints("w01  x -- absent: ", &tested(&[])), ["w01 is absent without a reason"]);
    assert_eq!(complaints("x01  x", &tested(&[])), ["x01 is not an id"]);
    // Neither a helper nor a comment counts as a test.
    let source =
        "fn w01_helper() {\n}\n// #[test] fn w02_old()\n#[test]\n#[cfg(unix)]\nfn w03_x() {";
    assert_eq!(self::tested(source).into_iter().collect::<Vec<_>>(), ["w03"]);
}
