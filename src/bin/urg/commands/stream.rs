//! `urg stream`: scans on standard output.

use clap::ValueEnum;

use crate::args::{LinkArgs, PaceArgs, WindowArgs};
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::format::csv;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::output::stdout::Output;
use crate::port::name::PortArg;
use crate::port::open::open;
use crate::stream::feed::{Feed, Update};
use crate::stream::follow::{Ended, follow};
use crate::stream::rate_watch::RateWatch;
use crate::stream::reporter::Reporter;

/// Write scans to standard output as they come
///
/// Goes on until Ctrl-C, --count or --duration, also when the sensor is
/// unplugged and comes back; a recording goes on to its end.
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
  scan_time        seconds of a revolution of the motor
  repeat           true if all values are those of the scan before
  reconnects       how often the sensor had been found again; a number that
                   differs from the one before marks the first scan after it
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
        let (port, rate) = self.port.polled_at(self.pace.rate).await?;
        let window = self.window.window(port.default_window())?;
        let opening = async {
            let sensor = open(&port, &self.link, Delivery::All).await?;
            let scans = sensor.scans(window, rate).await;
            let scans = scans.map_err(|error| Failure::at(&port.to_string(), &error))?;
            Ok((sensor, scans))
        };
        let (sensor, scans) = tokio::select! {
            opened = opening => opened?,
            _ = interrupt.requested() => return Ok(()),
        };
        let mut feed = Feed::new(&port, scans);
        let mut run = Run {
            watch: RateWatch::new(&port, window, rate),
            reporter: Reporter::new(port, sensor),
            format: self.format,
            output: Output::new(),
        };
        if self.format == Format::Csv {
            run.output.write(csv::HEADER).await?;
        }
        let write = async |update: Update| run.write(&update).await;
        match follow(&mut feed, &self.pace, interrupt, write).await? {
            Ended::AsAsked => Ok(()),
            Ended::ByItself => run.reporter.end(),
        }
    }
}

/// A stream on its way to standard output.
struct Run {
    reporter: Reporter,
    format: Format,
    output: Output,
    watch: RateWatch,
}

impl Run {
    async fn write(&mut self, update: &Update) -> Result<(), Failure> {
        self.reporter.report(update);
        match (self.format, update) {
            (Format::Ndjson, update) => self.output.write(&update.line()?).await?,
            (Format::Csv, Update::Scan(scan)) => self.output.write(&csv::rows(scan)).await?,
            // A table has no place for anything else.
            (Format::Csv, _) => {}
        }
        match update {
            Update::Scan(_) => {
                if let Some(text) = self.watch.look(&self.reporter.sensor) {
                    notice(text);
                }
            }
            Update::Reconnected => self.watch.interrupted(),
            Update::Error(_) | Update::Missed(_) => {}
        }
        Ok(())
    }
}
