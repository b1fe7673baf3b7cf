//! Merges the scans of a stream and the events between them into one sequence.

use std::collections::VecDeque;

use serde::Serialize;
use tokio_scip::{Error, ErrorKind, Rate, Scan, ScanStream, Sensor, Window};
use urg_recording::{Event, Events};

use crate::failure::Failure;
use crate::format::json_line;
use crate::port::name::PortName;

/// Scan, or event between two scans.
#[derive(Debug, Clone)]
pub(crate) enum Update {
    Scan(Scan),
    /// Failed poll or lost link.
    Error(Error),
    /// Event that precedes the next scan.
    Event(Event),
}

/// Line of NDJSON, with the sensor's name if it has one.
#[derive(Debug, Serialize)]
pub(crate) struct NamedLine<'a, T> {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) sensor: Option<&'a str>,
    /// Seconds since the recording's first scan, during playback.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) position: Option<f64>,
    #[serde(flatten)]
    pub(crate) data: T,
}

impl Update {
    pub(crate) fn line(&self, sensor: Option<&str>) -> Result<String, Failure> {
        let position = None;
        match self {
            Self::Scan(data) => json_line(&NamedLine { sensor, position, data }),
            Self::Error(error) => {
                json_line(&NamedLine { sensor, position, data: Event::from(error) })
            }
            Self::Event(data) => json_line(&NamedLine { sensor, position, data }),
        }
    }
}

/// Fails if the sensor does not measure the window. The stream would wait for another one that does.
pub(crate) async fn check_window(
    port: &PortName,
    sensor: &Sensor,
    window: Window,
) -> Result<(), Failure> {
    let geometry = sensor.geometry().await.map_err(|error| Failure::at(port, &error))?;
    window.resolve(&geometry).map(drop).map_err(|error| Failure::at(port, &error))
}

/// Stream of updates. A clone continues at the same scan without additional polls.
#[derive(Debug, Clone)]
pub(crate) struct Feed {
    scans: ScanStream,
    port: PortName,
    events: Events,
    /// Events and the scan after them, not yet delivered.
    next: VecDeque<Update>,
}

impl Feed {
    /// Starts to poll `window` at `rate`.
    pub(crate) async fn open(
        port: &PortName,
        sensor: &Sensor,
        window: Window,
        rate: Rate,
    ) -> Result<Self, Failure> {
        let scans = sensor.scans(window, rate).await.map_err(|error| Failure::at(port, &error))?;
        Ok(Self { scans, port: port.clone(), events: Events::new(), next: VecDeque::new() })
    }

    pub(crate) fn scans(&self) -> &ScanStream {
        &self.scans
    }

    /// Newest scan, delivered or not.
    pub(crate) fn latest(&self) -> Option<Scan> {
        self.scans.latest()
    }

    /// Makes this the next update again.
    pub(crate) fn put_back(&mut self, update: Update) {
        self.next.push_front(update);
    }

    /// Waits for the next update, until the stream ends. Cancel-safe.
    pub(crate) async fn next(&mut self) -> Option<Update> {
        while self.next.is_empty() {
            let item = self.scans.next().await?;
            let events = self.events.from_item(&item);
            match item {
                Ok(scan) => {
                    if let Some(recorded) = self.port.recorded() {
                        recorded.count_consumed();
                    }
                    self.next.extend(events.map(Update::Event));
                    self.next.push_back(Update::Scan(scan));
                }
                // The replay leaves polls unanswered that come long before a scan.
                Err(error)
                    if matches!(error.kind(), ErrorKind::Timeout { .. })
                        && self.port.recorded().is_some() => {}
                Err(error) => self.next.push_back(Update::Error(error)),
            }
        }
        self.next.pop_front()
    }
}
