//! Reports the events of a stream to the user, on standard error, and maps the
//! stream's end to the program's.

use tokio_scip::{Error, Sensor, State};

use super::feed::Update;
use crate::failure::{Failure, chain};
use crate::output::notice::notice;
use crate::port::name::PortName;

/// Reports what happens between scans.
#[derive(Debug)]
pub(crate) struct Reporter {
    pub(crate) port: PortName,
    pub(crate) sensor: Sensor,
    /// The number of polls without a scan over a working link, as far as the
    /// stream reported them: while its reader is behind it keeps the latest only.
    pub(crate) failed: u64,
}

impl Reporter {
    pub(crate) fn new(port: PortName, sensor: Sensor) -> Self {
        Self { port, sensor, failed: 0 }
    }

    /// Reports `update`, unless it is a scan.
    pub(crate) fn report(&mut self, update: &Update) {
        let of_one_scan = matches!(update, Update::Error(error) if is_of_one_scan(error));
        self.failed += u64::from(of_one_scan);
        match update {
            Update::Scan(_) => {}
            Update::Reconnected => notice(format_args!("{}: the sensor is back", self.port)),
            Update::Missed(scans) => {
                notice(format_args!("{scans} scans missed: the reader of the output is too slow"));
            }
            // The cause of the end, which is reported last.
            Update::Error(_) if matches!(&*self.sensor.state().borrow(), State::Closed { .. }) => {}
            Update::Error(error) if of_one_scan => {
                // A bad cable would flood the terminal.
                if self.failed == 1 {
                    let text = chain(error);
                    notice(format_args!("{}: {text} (reported once; polls go on)", self.port));
                }
            }
            Update::Error(error) => notice(format_args!("{}: {}", self.port, chain(error))),
        }
    }

    /// Maps the end of the stream to that of the program.
    pub(crate) fn end(&self) -> Result<(), Failure> {
        end(&self.port, &self.sensor)
    }
}

/// Maps the end of a driver to that of the program. The end of a replay is a
/// success, and reported.
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

/// Returns whether the next poll may well bring a scan.
fn is_of_one_scan(error: &Error) -> bool {
    matches!(error, Error::Timeout { .. } | Error::Malformed { .. } | Error::Refused { .. })
}
