//! A stream of scans as one sequence of updates: the scans, and the events
//! between them.

use std::collections::VecDeque;

use serde::Serialize;
use tokio_scip::{Error, Event, Events, Scan, ScanStream};

use crate::failure::Failure;
use crate::format::json;
use crate::port::name::PortName;

/// A scan, or an event between two scans.
#[derive(Debug, Clone)]
pub(crate) enum Update {
    Scan(Scan),
    /// A poll without a scan, or the loss of the link.
    Error(Error),
    /// An event before the scan that comes next.
    Event(Event),
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

impl Update {
    /// Returns a line of NDJSON. It names the sensor if that has a name.
    pub(crate) fn line(&self, sensor: Option<&str>) -> Result<String, Failure> {
        match self {
            Self::Scan(scan) => json::line(&NamedLine { sensor, position: None, data: scan }),
            Self::Error(error) => event_line(sensor, &Event::from(error)),
            Self::Event(event) => event_line(sensor, event),
        }
    }
}

/// Returns the JSON object of `event` as a line, with the name of its sensor as first member.
fn event_line(sensor: Option<&str>, event: &Event) -> Result<String, Failure> {
    let event = event.to_string();
    let Some((sensor, members)) = sensor.zip(event.strip_prefix('{')) else {
        return Ok(event + "\n");
    };
    let sensor = json::text(&sensor)?;
    Ok(format!("{{\"sensor\":{sensor},{members}\n"))
}

/// A stream of updates. A clone continues from the same place, and costs the
/// sensor nothing.
#[derive(Debug, Clone)]
pub(crate) struct Feed {
    scans: ScanStream,
    port: PortName,
    events: Events,
    /// A scan that was read, and the events before it.
    next: VecDeque<Update>,
}

impl Feed {
    pub(crate) fn new(port: &PortName, scans: ScanStream) -> Self {
        Self { scans, port: port.clone(), events: Events::new(), next: VecDeque::new() }
    }

    /// Returns the next update; `None` after the end. Cancel-safe.
    pub(crate) async fn next(&mut self) -> Option<Update> {
        if self.next.is_empty() {
            let item = self.scans.next().await?;
            let events = self.events.of(&item);
            match item {
                Ok(scan) => {
                    if let Some(recorded) = self.port.recorded() {
                        recorded.record_taken();
                    }
                    self.next.extend(events.map(Update::Event));
                    self.next.push_back(Update::Scan(scan));
                }
                Err(error) => self.next.push_back(Update::Error(error)),
            }
        }
        self.next.pop_front()
    }
}
