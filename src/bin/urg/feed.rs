//! What a stream of scans has to tell, one thing after the other: scans, and
//! what happened between them; and what of it the user is told.

use tokio_scip::{Error, Scan, ScanStream, Sensor, State};

use crate::failure::{Failure, chain};
use crate::format::json::{self, Event};
use crate::notice::notice;
use crate::port::PortName;

/// A scan, or something that happened between two of them.
#[derive(Debug)]
pub(crate) enum Entry {
    Scan(Scan),
    /// No scan this time, or the link is lost.
    Error(Error),
    /// The sensor is back: a scan comes next.
    Reconnected,
    /// So many scans came and were not asked for in time.
    Missed(u64),
}

impl Entry {
    /// As a line of NDJSON.
    pub(crate) fn line(&self) -> Result<String, Failure> {
        match self {
            Self::Scan(scan) => json::scan(scan),
            Self::Error(error) => {
                let lost = matches!(error, Error::Disconnected { .. });
                let error = chain(error);
                let event =
                    if lost { Event::Disconnected { error } } else { Event::Error { error } };
                json::event(&event)
            }
            Self::Reconnected => json::event(&Event::Reconnected),
            Self::Missed(scans) => json::event(&Event::Missed { scans: *scans }),
        }
    }
}

/// A stream of scans with what happens between them. A clone goes on from the
/// same place, and costs the sensor nothing.
#[derive(Debug, Clone)]
pub(crate) struct Feed {
    scans: ScanStream,
    port: PortName,
    /// What comes after the entries that tell of the time before it.
    held: Option<Scan>,
    missed: u64,
    disconnected: bool,
}

impl Feed {
    pub(crate) fn new(port: &PortName, scans: ScanStream) -> Self {
        Self { missed: scans.missed(), scans, port: port.clone(), held: None, disconnected: false }
    }

    /// What comes next; `None` after the end. Cancel-safe.
    pub(crate) async fn next(&mut self) -> Option<Entry> {
        if self.held.is_none() {
            match self.scans.next().await? {
                Ok(scan) => {
                    if let Some(recorded) = self.port.recorded() {
                        recorded.took();
                    }
                    self.held = Some(scan);
                }
                // That is how a replay ends: nothing was lost.
                Err(Error::Disconnected { .. }) if self.port.recorded().is_some() => return None,
                Err(error) => {
                    self.disconnected |= matches!(error, Error::Disconnected { .. });
                    return Some(Entry::Error(error));
                }
            }
        }
        if std::mem::take(&mut self.disconnected) {
            return Some(Entry::Reconnected);
        }
        let missed = self.scans.missed();
        match missed - std::mem::replace(&mut self.missed, missed) {
            0 => self.held.take().map(Entry::Scan),
            scans => Some(Entry::Missed(scans)),
        }
    }
}

/// Tells the user what happens between scans.
#[derive(Debug)]
pub(crate) struct Reporter {
    pub(crate) port: PortName,
    pub(crate) sensor: Sensor,
    /// Polls that brought no scan over a link that was there, as the stream told
    /// them: of those that fail while its reader is behind, the latest.
    pub(crate) failed: u64,
}

impl Reporter {
    pub(crate) fn new(port: PortName, sensor: Sensor) -> Self {
        Self { port, sensor, failed: 0 }
    }

    /// Tells what there is to tell of `entry`.
    pub(crate) fn tell(&mut self, entry: &Entry) {
        let of_one_scan = matches!(entry, Entry::Error(error) if is_of_one_scan(error));
        self.failed += u64::from(of_one_scan);
        match entry {
            Entry::Scan(_) => {}
            Entry::Reconnected => notice(format_args!("{}: the sensor is back", self.port)),
            Entry::Missed(scans) => {
                notice(format_args!("{scans} scans missed: whoever reads them is too slow"));
            }
            // The last thing that is said, in a moment: the cause of the end.
            Entry::Error(_) if matches!(&*self.sensor.state().borrow(), State::Closed { .. }) => {}
            Entry::Error(error) if of_one_scan => {
                // A bad line would flood the terminal.
                if self.failed == 1 {
                    let text = chain(error);
                    notice(format_args!("{}: {text} (told once; it goes on)", self.port));
                }
            }
            Entry::Error(error) => notice(format_args!("{}: {}", self.port, chain(error))),
        }
    }

    /// What to make of it that there are no more scans.
    pub(crate) fn end(&self) -> Result<(), Failure> {
        end(&self.port, &self.sensor)
    }
}

/// What to make of it that a driver has ended: it is told, if it is fine.
pub(crate) fn end(port: &PortName, sensor: &Sensor) -> Result<(), Failure> {
    let error = match &*sensor.state().borrow() {
        State::Closed { error: Some(error) } => error.clone(),
        _ => Error::Closed,
    };
    match port.recorded() {
        Some(recorded) => recorded.end(&error),
        None => Err(Failure::at(&port.to_string(), &error)),
    }
}

/// Whether the next poll may well bring a scan.
fn is_of_one_scan(error: &Error) -> bool {
    matches!(error, Error::Timeout { .. } | Error::Malformed { .. } | Error::Refused { .. })
}
