//! Identity of a recorded sensor: its latest replies to `V`, `VV` and `PP`, or, where the recording does
//! not have them, what the metadata have.

use std::collections::BTreeMap;

use super::mcap::MessageHeader;
use super::reply::ReplyKind;
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

/// Latest successful replies that identify the sensor, with the numbers of the files that they are from.
#[derive(Debug, Default)]
pub(super) struct Identity(BTreeMap<ReplyKind, (usize, MessageHeader, Vec<u8>)>);

impl Identity {
    pub(super) fn insert(
        &mut self,
        kind: ReplyKind,
        file: usize,
        header: MessageHeader,
        data: &[u8],
    ) {
        self.0.insert(kind, (file, header, data.to_vec()));
    }

    pub(super) fn forget_parameters(&mut self) {
        self.0.remove(&ReplyKind::Parameters);
    }

    /// Returns true for a reply that another file has already: each file of a split recording begins
    /// with it.
    pub(super) fn is_repeated(
        &self,
        kind: ReplyKind,
        file: usize,
        header: MessageHeader,
        data: &[u8],
    ) -> bool {
        self.0.get(&kind).is_some_and(|(known_file, known, bytes)| {
            *known_file != file && known.publish_time == header.publish_time && bytes == data
        })
    }

    /// Replies of other kinds than this one.
    pub(super) fn others(
        &self,
        kind: Option<ReplyKind>,
    ) -> impl Iterator<Item = (MessageHeader, &[u8])> {
        let others = self.0.iter().filter(move |(other, _)| Some(**other) != kind);
        others.map(|(_, (_, header, data))| (*header, &data[..]))
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metadata_become_a_version_and_what_is_unknown_is_empty() {
        let pairs = [("serial_number", "H1\nSERI:H2"), ("status", "good"), ("rate", "10")];
        let metadata = pairs.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
        let version = parse_version(&version_lines(&metadata)).unwrap();
        assert_eq!(version.serial_number.to_string(), "H1");
        assert_eq!(version.status.map(|status| status.to_string()), Some("good".to_owned()));
        assert_eq!((version.vendor, version.firmware), Default::default());
        let nothing = parse_version(&version_lines(&BTreeMap::new())).unwrap();
        assert_eq!(nothing, Version::default());
    }
}
