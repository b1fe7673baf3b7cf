//! JSON: a scan or an event, one line each.

use serde::Serialize;
use tokio_scip::Scan;

use crate::failure::Failure;

/// A scan as one line.
pub(crate) fn scan(scan: &Scan) -> Result<String, Failure> {
    line(scan)
}

/// Something other than a scan, as one line.
pub(crate) fn event(event: &Event) -> Result<String, Failure> {
    line(event)
}

/// What happened between two scans.
#[derive(Debug, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub(crate) enum Event {
    /// The link is lost; the driver tries to get it back.
    Disconnected { error: String },
    /// The sensor is back: the next line is a scan.
    Reconnected,
    /// No scan this time, and why.
    Error { error: String },
    /// Scans that came and were not written because the reader was too slow.
    Missed { scans: u64 },
}

/// Anything that is data, as one line.
pub(crate) fn line(data: &impl Serialize) -> Result<String, Failure> {
    let mut line =
        serde_json::to_string(data).map_err(|error| Failure::of("cannot write JSON", &error))?;
    line.push('\n');
    Ok(line)
}
