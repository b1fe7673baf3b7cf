//! `urg stream`: scans on standard output.

use std::time::Instant;

use clap::ValueEnum;
use tokio_scip::{Error, Scan, ScanStream, Sensor, State};

use crate::args::{LinkArgs, PaceArgs, WindowArgs};
use crate::failure::{Failure, chain};
use crate::format::json::Event;
use crate::format::{csv, json};
use crate::interrupt::Interrupt;
use crate::notice::notice;
use crate::output::Output;
use crate::pace::PaceWatch;
use crate::port::{PortArg, PortName, open};

/// How many scans wait for a reader that is slow: nearly two minutes.
const DEPTH: usize = 1024;

/// Write scans to standard output as they come
///
/// Goes on until Ctrl-C, --count or --duration, also when the sensor is
/// unplugged and comes back.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "`--help` explains the formats",
    after_long_help = format!("{EXAMPLES}\n\n{NDJSON}\n\n{}", csv::COLUMNS)
)]
pub(crate) struct Stream {
    #[command(flatten)]
    port: PortArg,
    /// How to write them
    #[arg(long, value_enum, default_value_t = Format::Ndjson)]
    format: Format,
    #[command(flatten)]
    pace: PaceArgs,
    #[command(flatten)]
    window: WindowArgs,
    #[command(flatten)]
    link: LinkArgs,
}

const EXAMPLES: &str = "\
Examples:
  urg stream /dev/ttyACM0 | jq -c '[.stamp, .ranges[341]]'
  urg stream /dev/ttyUSB0 --baud 115200 --cluster 4 --duration 10s > scans.ndjson
  urg stream emulated --count 20 --format csv";

const NDJSON: &str = "\
NDJSON has one object a line. One with \"event\" tells of something else than a
scan: disconnected, reconnected, error, missed. All others are scans:
  sequence         number of the scan; a gap means that scans were missed
  stamp            seconds since 1970, when the reply began to arrive
  start,end        the first and the last step
  cluster          how many steps make a point
  angle_min        direction of the first point in radians, counter-clockwise
                   from the front
  angle_increment  from one point to the next
  values           as the sensor sent them: below 20 an error code, else mm
  ranges           metres; null where there is no distance";

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// One object a line, for programs
    Ndjson,
    /// A row a point, for spreadsheets and data frames
    Csv,
}

impl Stream {
    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        tokio::select! {
            outcome = self.stream(interrupt) => outcome,
            // Not for ever, where nobody reads.
            () = interrupt.overdue() => Ok(()),
        }
    }

    async fn stream(self, interrupt: &Interrupt) -> Result<(), Failure> {
        let window = self.window.window()?;
        let port = self.port.required().await?;
        let opening = async {
            let sensor = open(&port, &self.link, DEPTH).await?;
            let scans = sensor.scans(window, self.pace.rate).await;
            let scans = scans.map_err(|error| Failure::at(&port.to_string(), &error))?;
            Ok((sensor, scans))
        };
        let (sensor, scans) = tokio::select! {
            opened = opening => opened?,
            _ = interrupt.requested() => return Ok(()),
        };
        let mut run = Run {
            watch: PaceWatch::new(&port, window, self.pace.rate),
            port,
            sensor,
            scans,
            format: self.format,
            output: Output::new(),
            missed: 0,
            disconnected: false,
            failed: false,
        };
        let end = async {
            match self.pace.duration {
                Some(duration) => {
                    let end = Instant::now() + duration;
                    tokio::select! {
                        () = tokio::time::sleep_until(end.into()) => end,
                        since = interrupt.requested() => since,
                    }
                }
                None => interrupt.requested().await,
            }
        };
        run.until(end, self.pace.count.unwrap_or(u64::MAX)).await
    }
}

/// A stream on its way to standard output.
struct Run {
    port: PortName,
    sensor: Sensor,
    scans: ScanStream,
    format: Format,
    output: Output,
    watch: PaceWatch,
    missed: u64,
    disconnected: bool,
    /// Whether the user was told that a scan can fail.
    failed: bool,
}

impl Run {
    /// Writes `count` scans, or those that have come before `end` resolves to a
    /// time.
    async fn until(
        &mut self,
        end: impl Future<Output = Instant>,
        count: u64,
    ) -> Result<(), Failure> {
        if self.format == Format::Csv {
            self.output.write(csv::HEADER).await?;
        }
        tokio::pin!(end);
        let (mut ended, mut written) = (None, 0);
        while written < count {
            // A slow reader may be behind: what came in time is written.
            let item = tokio::select! {
                biased;
                since = &mut end, if ended.is_none() => {
                    ended = Some(since);
                    continue;
                }
                item = self.scans.next() => item,
                () = std::future::ready(()), if ended.is_some() => return Ok(()),
            };
            match item {
                Some(Ok(scan)) if ended.is_some_and(|end| scan.received_at() > end) => {
                    return Ok(());
                }
                Some(Ok(scan)) => {
                    self.scan(&scan).await?;
                    written += 1;
                }
                Some(Err(error)) => self.trouble(&error).await?,
                None => return self.cause(),
            }
        }
        Ok(())
    }

    async fn scan(&mut self, scan: &Scan) -> Result<(), Failure> {
        if std::mem::take(&mut self.disconnected) {
            notice(format_args!("{}: the sensor is back", self.port));
            self.event(&Event::Reconnected).await?;
        }
        let missed = self.scans.missed();
        let scans = missed - std::mem::replace(&mut self.missed, missed);
        if scans > 0 {
            notice(format_args!("{scans} scans missed: whoever reads them is too slow"));
            self.event(&Event::Missed { scans }).await?;
        }
        let text = match self.format {
            Format::Ndjson => json::scan(scan)?,
            Format::Csv => csv::rows(scan),
        };
        self.output.write(&text).await?;
        self.watch.look(&self.sensor);
        Ok(())
    }

    /// Tells of an error; if it ends the driver the caller's next item does.
    async fn trouble(&mut self, error: &Error) -> Result<(), Failure> {
        let text = chain(error);
        if matches!(&*self.sensor.state().borrow(), State::Closed { .. }) {
            // The last thing that is said, in a moment.
        } else if is_of_one_scan(error) {
            // A bad line would flood the terminal.
            if !std::mem::replace(&mut self.failed, true) {
                notice(format_args!("{}: {text} (told once; it goes on)", self.port));
            }
        } else {
            notice(format_args!("{}: {text}", self.port));
        }
        let lost = matches!(error, Error::Disconnected { .. });
        self.disconnected |= lost;
        let error = text;
        self.event(&if lost { Event::Disconnected { error } } else { Event::Error { error } }).await
    }

    async fn event(&mut self, event: &Event) -> Result<(), Failure> {
        match self.format {
            Format::Ndjson => self.output.write(&json::event(event)?).await,
            // A table has no place for it.
            Format::Csv => Ok(()),
        }
    }

    /// Why there are no more scans.
    fn cause(&self) -> Result<(), Failure> {
        let error = match &*self.sensor.state().borrow() {
            State::Closed { error: Some(error) } => error.clone(),
            _ => Error::Closed,
        };
        Err(Failure::at(&self.port.to_string(), &error))
    }
}

/// Whether the next poll may well bring a scan.
fn is_of_one_scan(error: &Error) -> bool {
    matches!(error, Error::Timeout { .. } | Error::Malformed { .. } | Error::Refused { .. })
}
