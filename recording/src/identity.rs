//! Identity of the recorded sensor, where the recording does not have its reply to `V`: from the
//! metadata, as far as they have it.

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

/// Reply to `V`, without its terminator. A line whose value is unknown has none.
pub(super) fn version_frame(metadata: &BTreeMap<String, String>) -> Vec<u8> {
    // A line feed would end the line.
    let value = |key: &str| metadata.get(key).and_then(|value| value.lines().next());
    let mut frame = b"V\n0".to_vec();
    for (name, key) in LINES {
        frame.extend_from_slice(format!("\n{name}:{}", value(key).unwrap_or_default()).as_bytes());
    }
    if let Some(status) = value("status") {
        frame.extend_from_slice(format!("\nSTAT:{status}").as_bytes());
    }
    frame
}

/// Parses a reply to `V`, unless it is malformed or refused.
pub(super) fn parse_version(frame: &[u8]) -> Option<Version> {
    let reply = Reply::parse(&Command::Version, frame).ok()?;
    reply.status().is_ok().then(|| Version::from_reply(&reply))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metadata_become_a_version_and_what_is_unknown_is_empty() {
        let pairs = [("serial_number", "H1\nSERI:H2"), ("status", "good"), ("rate", "10")];
        let metadata = pairs.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
        let version = parse_version(&version_frame(&metadata)).unwrap();
        assert_eq!(version.serial_number.to_string(), "H1");
        assert_eq!(version.status.map(|status| status.to_string()), Some("good".to_owned()));
        assert_eq!((version.vendor, version.firmware), Default::default());
        let nothing = parse_version(&version_frame(&BTreeMap::new())).unwrap();
        assert_eq!(nothing, Version::default());
    }
}
