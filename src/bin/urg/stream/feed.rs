//! A stream of scans as one sequence of updates: the scans, and the events
//! between them. Reconnects and missed scans are derived here and nowhere else.

use serde::Serialize;
use tokio_scip::{Error, Scan, ScanStream};

use crate::failure::{Failure, chain};
use crate::format::json;
use crate::port::name::PortName;

/// A scan, or an event between two scans.
#[derive(Debug)]
pub(crate) enum Update {
    Scan(Scan),
    /// A poll without a scan, or the loss of the link.
    Error(Error),
    /// The sensor is back: a scan comes next.
    Reconnected,
    /// The number of scans that were overwritten before they were read.
    Missed(u64),
}

/// A line of NDJSON, with the name of its sensor if there is one.
#[derive(Debug, Serialize)]
pub(crate) struct NamedLine<'a, T> {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) sensor: Option<&'a str>,
    /// Seconds since the first scan of a recording that is played.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) position: Option<f64>,
    #[serde(flatten)]
    pub(crate) data: T,
}

/// The form of an event in NDJSON.
#[derive(Debug, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
enum EventLine {
    Disconnected { error: String },
    Reconnected,
    Error { error: String },
    Missed { scans: u64 },
}

impl Update {
    /// Returns a line of NDJSON. It names the sensor if that has a name.
    pub(crate) fn line(&self, sensor: Option<&str>) -> Result<String, Failure> {
        let event = match self {
            Self::Scan(scan) => {
                return json::line(&NamedLine { sensor, position: None, data: scan });
            }
            Self::Error(error @ Error::Disconnected { .. }) => {
                EventLine::Disconnected { error: chain(error) }
            }
            Self::Error(error) => EventLine::Error { error: chain(error) },
            Self::Reconnected => EventLine::Reconnected,
            Self::Missed(scans) => EventLine::Missed { scans: *scans },
        };
        json::line(&NamedLine { sensor, position: None, data: event })
    }
}

/// A stream of updates. A clone continues from the same place, and costs the
/// sensor nothing.
#[derive(Debug, Clone)]
pub(crate) struct Feed {
    scans: ScanStream,
    port: PortName,
    /// A scan that is held back until the events before it are delivered.
    held: Option<Scan>,
    missed: u64,
    disconnected: bool,
}

impl Feed {
    pub(crate) fn new(port: &PortName, scans: ScanStream) -> Self {
        Self { missed: scans.missed(), scans, port: port.clone(), held: None, disconnected: false }
    }

    /// Returns the next update; `None` after the end. Cancel-safe.
    pub(crate) async fn next(&mut self) -> Option<Update> {
        if self.held.is_none() {
            match self.scans.next().await? {
                Ok(scan) => {
                    if let Some(recorded) = self.port.recorded() {
                        recorded.record_taken();
                    }
                    self.held = Some(scan);
                }
                Err(error) => {
                    self.disconnected |= matches!(error, Error::Disconnected { .. });
                    return Some(Update::Error(error));
                }
            }
        }
        if std::mem::take(&mut self.disconnected) {
            return Some(Update::Reconnected);
        }
        let missed = self.scans.missed();
        match missed - std::mem::replace(&mut self.missed, missed) {
            0 => self.held.take().map(Update::Scan),
            scans => Some(Update::Missed(scans)),
        }
    }
}
