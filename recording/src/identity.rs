//! Identity of a recorded sensor: what its reply to `V` or `VV` says, or, where the recording has none,
//! the metadata.

use std::collections::BTreeMap;

use tokio_scip::Version;
use tokio_scip::protocol::{Command, Reply};

/// Lines that every sensor sends, each with its key in the metadata.
const LINES: [(&str, &str); 5] = [
    ("VEND", "vendor"),
    ("PROD", "product"),
    ("FIRM", "firmware"),
    ("PROT", "protocol"),
    ("SERI", "serial_number"),
];

/// Lines of a reply to `V`. A line whose value is unknown has none.
pub(super) fn version_lines(metadata: &BTreeMap<String, String>) -> Vec<Vec<u8>> {
    // A line feed would end the line.
    let value = |key: &str| metadata.get(key).and_then(|value| value.lines().next());
    let line = |(name, key)| format!("{name}:{}", value(key).unwrap_or_default());
    let lines = LINES.map(line).into_iter();
    let status = value("status").map(|status| format!("STAT:{status}"));
    lines.chain(status).map(String::into_bytes).collect()
}

/// Parses lines of a reply to `V` or `VV`.
pub(super) fn parse_version(lines: &[Vec<u8>]) -> Option<Version> {
    let frame = [b"V\n0\n".to_vec(), lines.join(&b'\n')].concat();
    Reply::parse(&Command::Version, &frame).ok().map(|reply| Version::from_reply(&reply))
}
