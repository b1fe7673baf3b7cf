//! Prints a stream's events to standard error, and maps the end of the stream to the program's outcome.

use std::time::{Duration, Instant};

use tokio_scip::{Error, ErrorKind, Rate, Sensor, State, Window};
use urg_recording::Event;

use super::feed::Update;
use super::follow::StreamEnd;
use super::health::trouble;
use super::rate_watch::RateWatch;
use crate::failure::{Failure, chain};
use crate::output::notice::notice;
use crate::port::name::PortName;
use crate::recording::recorded::Recorded;

/// Time that a sensor may take until its first scan.
const FIRST_SCAN: Duration = Duration::from_secs(1);

/// Printer of one stream's events.
#[derive(Debug)]
pub(crate) struct Reporter {
    pub(crate) port: PortName,
    pub(crate) sensor: Sensor,
    /// Polls without a scan over a working link. A lower bound: while its reader is behind,
    /// the stream keeps only the latest.
    pub(crate) failed: u64,
    /// Scans that were overwritten before they were read.
    pub(crate) missed: u64,
    watch: Option<RateWatch>,
    scans: u64,
    last_error: Option<String>,
    began: Instant,
}

impl Reporter {
    pub(crate) fn new(port: PortName, sensor: Sensor) -> Self {
        let (failed, missed, scans, began) = (0, 0, 0, Instant::now());
        Self { port, sensor, failed, missed, watch: None, scans, last_error: None, began }
    }

    /// Also reports why the stream of `window` is slower than `rate`.
    pub(crate) fn with_rate(self, window: Window, rate: Rate) -> Self {
        let watch = Some(RateWatch::new(&self.port, window, rate));
        Self { watch, ..self }
    }

    pub(crate) fn report(&mut self, update: &Update) {
        match update {
            Update::Scan(_) => {
                self.scans += 1;
                let watch = self.watch.as_mut();
                if let Some(text) = watch.and_then(|watch| watch.scanned(&self.sensor)) {
                    notice(format_args!("{}: {text}", self.port));
                }
            }
            Update::Event(Event::Reconnected) => {
                notice(format_args!("{}: the sensor is back", self.port));
            }
            Update::Event(Event::Missed { scans }) => {
                self.missed += scans;
                let noun = if *scans == 1 { "scan" } else { "scans" };
                notice(format_args!(
                    "{scans} {noun} missed: this host or the reader of the output is too slow"
                ));
            }
            Update::Event(_) => {}
            Update::Error(error) => self.error(error),
        }
    }

    fn error(&mut self, error: &Error) {
        let failure = Failure::at(&self.port, error);
        let text = failure.line();
        if matches!(self.sensor.watch_state().get(), State::Closed { .. }) {
            // `finish` prints it.
        } else if is_of_one_scan(error) {
            self.failed += 1;
            // Only once: a bad cable would flood the terminal.
            if self.failed == 1 {
                notice(format_args!("{text} (reported once; polling continues)"));
            }
        } else {
            notice(text);
        }
        self.last_error = Some(chain(error));
    }

    /// Maps the end of the stream to the outcome of the program. Not a single scan is an
    /// error, whatever ended the stream, unless the user ended it before one could arrive.
    pub(crate) fn finish(&self, ended: StreamEnd) -> Result<(), Failure> {
        if let Some(text) = self.port.recorded().and_then(Recorded::left_out) {
            notice(text);
        }
        if ended == StreamEnd::ByItself {
            end(&self.port, &self.sensor)?;
        }
        if self.scans > 0 {
            return Ok(());
        }
        let why = trouble(&self.sensor.watch_state().get())
            .filter(|_| ended != StreamEnd::ByItself)
            .or_else(|| self.last_error.clone());
        if ended == StreamEnd::Interrupted && why.is_none() && self.began.elapsed() < FIRST_SCAN {
            return Ok(());
        }
        let why = why.unwrap_or_else(|| "no poll was answered yet".to_owned());
        let seconds = self.began.elapsed().as_secs_f64();
        Err(Failure::on(&self.port, format!("no scan in {seconds:.1} s: {why}")))
    }
}

/// Maps the end of the driver to the outcome of the program. The end of a recording is
/// announced, and is a success.
pub(crate) fn end(port: &PortName, sensor: &Sensor) -> Result<(), Failure> {
    match sensor.watch_state().get() {
        State::Closed { error: Some(error) } => Err(Failure::at(port, &error)),
        // While a handle exists, only a recording ends without an error.
        _ => {
            notice(format_args!("{port}: the recording has ended"));
            Ok(())
        }
    }
}

/// Checks whether the error concerns one poll only: the next one may succeed.
fn is_of_one_scan(error: &Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::Timeout { .. } | ErrorKind::Malformed { .. } | ErrorKind::Refused { .. }
    )
}
