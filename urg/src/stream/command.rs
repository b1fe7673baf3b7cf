//! `urg stream`: scans on standard output.

use std::io::{self, IsTerminal};

use clap::ValueEnum;

use super::feed::{Feed, Update, check_window};
use super::follow::follow;
use super::jitter::RecentTimes;
use super::rate_watch::schedule;
use super::reporter::Reporter;
use crate::args::{LinkArgs, PaceArgs, WindowArgs};
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::format::csv::{self, Columns};
use crate::format::summary;
use crate::interrupt::Interrupt;
use crate::output::stdout::print;
use crate::port::name::PortArg;
use crate::port::open::open;
use crate::recording::span::{RangeArgs, TopicArgs};

/// Write scans to standard output as they come
///
/// Runs until Ctrl-C, --count, --duration, or the end of a recording. Unplug the sensor and plug it
/// back in: scanning resumes. Ending without a single scan is an error, unless you press Ctrl-C
/// before one can arrive.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "`--help` explains the formats",
    after_long_help = format!("{EXAMPLES}\n\n{NDJSON}\n\n{}", csv::COLUMNS)
)]
pub(crate) struct Stream {
    #[command(flatten)]
    port: PortArg,
    /// Output format [default: summary on a terminal, else ndjson]
    #[arg(long, value_enum)]
    format: Option<StreamFormat>,
    #[command(flatten)]
    pace: PaceArgs,
    #[command(flatten)]
    range: RangeArgs,
    #[command(flatten)]
    topic: TopicArgs,
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
NDJSON has one object a line. An object with the field \"event\" is an event
(disconnected, reconnected, error or missed); every other object is a scan:
  sequence         number of the scan; a gap means that scans were missed
  stamp            seconds since 1970, when the reply began to arrive
  first_ray        seconds since 1970, when the first point was measured
  stamp_quality    what first_ray rests on: the \"motor\", the \"sensor_clock\" of
                   SCIP 2, or the \"arrival\" alone
  lateness         seconds from the end of the revolution to stamp; null if
                   stamp_quality is \"arrival\"
  start,end        the first and the last step
  cluster          number of steps of a point
  angle_min        radians of the first point, counter-clockwise from the front
  angle_increment  from one point to the next
  scan_time        seconds of a revolution of the motor, measured if known
  range_min,range_max  metres, just outside of all distances
  repeat           true if all values equal those of the scan before
  reconnects       number of reconnects before this scan
  beyond           values that are +Inf in ROS: perhaps beyond the range
  values           as the sensor sent them: mm, or an error code of the model
  ranges           metres; null where there is no distance
  intensities      with --intensity, if the sensor has them: strengths of the
                   reflections, in the sensor's own unit";

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum StreamFormat {
    /// One short line per scan, for people
    Summary,
    /// One JSON object per line, for programs
    Ndjson,
    /// One row per point, for spreadsheets and data frames
    Csv,
    /// Same as csv, plus x and y
    CsvXy,
}

impl StreamFormat {
    fn columns(self, intensity: bool) -> Option<Columns> {
        match self {
            Self::Csv | Self::CsvXy => Some(Columns { intensity, cartesian: self == Self::CsvXy }),
            Self::Summary | Self::Ndjson => None,
        }
    }
}

impl Stream {
    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        let (mut port, rate) = interrupt.unless(self.port.polled_at(self.pace.rate)).await?;
        port.choose(self.range, &self.topic)?;
        let window = self.window.window(port.default_window())?;
        let opening = async {
            let sensor = open(&port, &self.link, Delivery::All).await?;
            check_window(&port, &sensor, window).await?;
            let feed = Feed::open(&port, &sensor, window, rate).await?;
            Ok((sensor, feed))
        };
        let (sensor, mut feed) = interrupt.unless(opening).await?;
        let mut reporter = Reporter::new(port, sensor).with_rate(window, rate);
        let is_seen = io::stdout().is_terminal();
        let usual = if is_seen { StreamFormat::Summary } else { StreamFormat::Ndjson };
        let format = self.format.unwrap_or(usual);
        let columns = format.columns(self.link.intensity);
        if let Some(columns) = columns {
            print(columns.header()).await?;
        }
        let mut times = RecentTimes::default();
        let write = async |update: Update| {
            reporter.report(&update);
            match (columns, &update) {
                (None, _) if format == StreamFormat::Ndjson => print(update.line(None)?).await,
                (Some(columns), Update::Scan(scan)) => print(csv::rows(scan, columns)).await,
                (None, Update::Scan(scan)) => {
                    let stats = reporter.sensor.stats();
                    times.push(scan.received_at());
                    let rate = schedule(&stats, window).and_then(|schedule| schedule.reached);
                    print(summary::line(scan, rate.or_else(|| times.rate()))).await
                }
                // Events are on standard error too.
                _ => Ok(()),
            }
        };
        let ended = follow(&mut feed, &self.pace, interrupt, write).await?;
        reporter.finish(ended)
    }
}
