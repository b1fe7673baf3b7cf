//! Reports the events of a stream to the user, on standard error, and maps the
//! stream's end to the program's.

use std::time::Instant;

use tokio_scip::{Error, Event, Sensor, State};

use super::feed::Update;
use super::follow::Ended;
use super::link;
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
    scans: u64,
    last_error: Option<String>,
    began: Instant,
}

impl Reporter {
    pub(crate) fn new(port: PortName, sensor: Sensor) -> Self {
        Self { port, sensor, failed: 0, scans: 0, last_error: None, began: Instant::now() }
    }

    /// Reports `update`, unless it is a scan.
    pub(crate) fn report(&mut self, update: &Update) {
        match update {
            Update::Scan(_) => self.scans += 1,
            Update::Event(Event::Reconnected) => {
                notice(format_args!("{}: the sensor is back", self.port));
            }
            Update::Event(Event::Missed { scans }) => {
                notice(format_args!("{scans} scans missed: the reader of the output is too slow"));
            }
            Update::Event(_) => {}
            Update::Error(error) => self.error(error),
        }
    }

    fn error(&mut self, error: &Error) {
        let text = chain(error);
        if matches!(&*self.sensor.state().borrow(), State::Closed { .. }) {
            // The cause of the end, which is reported last.
        } else if is_of_one_scan(error) {
            self.failed += 1;
            // A bad cable would flood the terminal.
            if self.failed == 1 {
                notice(format_args!("{}: {text} (reported once; polls go on)", self.port));
            }
        } else {
            notice(format_args!("{}: {text}", self.port));
        }
        self.last_error = Some(text);
    }

    /// Maps the end of the stream to that of the program. A stream that was to
    /// bring scans and brought none is a failure.
    pub(crate) fn finish(&self, ended: Ended) -> Result<(), Failure> {
        match ended {
            Ended::Interrupted => return Ok(()),
            Ended::Complete => {}
            Ended::ByItself => end(&self.port, &self.sensor)?,
        }
        if self.scans > 0 {
            return Ok(());
        }
        let why = link::trouble(&self.sensor.state().borrow())
            .filter(|_| ended == Ended::Complete)
            .or_else(|| self.last_error.clone())
            .unwrap_or_else(|| "no poll was answered yet".to_owned());
        let seconds = self.began.elapsed().as_secs_f64();
        Err(Failure::Failed(format!("{}: no scan in {seconds:.1} s: {why}", self.port)))
    }
}

/// Maps the end of a driver to that of the program. The end of a recording is a
/// success, and reported.
pub(crate) fn end(port: &PortName, sensor: &Sensor) -> Result<(), Failure> {
    match &*sensor.state().borrow() {
        State::Closed { error: Some(error) } => Err(Failure::at(&port.to_string(), error)),
        // Nothing else ends without an error while a handle is left.
        _ => {
            notice(format_args!("{port}: the recording has ended"));
            Ok(())
        }
    }
}

/// Returns whether the next poll may well bring a scan.
fn is_of_one_scan(error: &Error) -> bool {
    matches!(error, Error::Timeout { .. } | Error::Malformed { .. } | Error::Refused { .. })
}
