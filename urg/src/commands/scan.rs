//! `urg scan`: takes one scan.

use clap::ValueEnum;
use tokio_scip::Scan;

use crate::args::{LinkArgs, WindowArgs};
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::format::csv::{self, Columns};
use crate::format::{json_line, svg, table};
use crate::output::stdout::print;
use crate::port::name::PortArg;
use crate::port::open::open;
use crate::recording::span::{RangeArgs, TopicArgs};

/// Take one scan
///
/// Switches the laser on if it is off.
#[derive(Debug, clap::Args)]
#[command(after_help = "`--help` explains the formats", after_long_help = format!("{EXAMPLES}\n\n{}", csv::COLUMNS))]
pub(crate) struct ScanOnce {
    #[command(flatten)]
    port: PortArg,
    /// Output format
    #[arg(long, value_enum, default_value_t = ScanFormat::Table)]
    format: ScanFormat,
    #[command(flatten)]
    window: WindowArgs,
    #[command(flatten)]
    topic: TopicArgs,
    #[command(flatten)]
    link: LinkArgs,
}

const EXAMPLES: &str = "\
Examples:
  urg scan /dev/ttyACM0
  urg scan /dev/ttyACM0 --from -45deg --to 45deg
  urg scan serial:H0713090 --format csv > scan.csv
  urg scan /dev/ttyACM0 --format svg > scan.svg";

#[derive(Debug, Clone, Copy, ValueEnum)]
enum ScanFormat {
    /// One line per point with direction and distance, and a summary, for people
    Table,
    /// One JSON object, as in `urg stream`
    Json,
    /// One row per point
    Csv,
    /// Same as csv, plus x and y
    CsvXy,
    /// Polar plot, for example for a report
    Svg,
}

impl ScanOnce {
    pub(crate) async fn run(self) -> Result<(), Failure> {
        let mut port = self.port.required().await?;
        port.choose(RangeArgs::default(), &self.topic)?;
        let window = self.window.window(port.default_window())?;
        let sensor = open(&port, &self.link, Delivery::Newest).await?;
        let at_port = |error| Failure::at(&port, &error);
        let scan = sensor.scan(window).await.map_err(at_port)?;
        let intensity = self.link.intensity;
        let text = match self.format {
            ScanFormat::Table => table::table(&scan, &sensor.version().await.map_err(at_port)?),
            ScanFormat::Json => json_line(&scan)?,
            ScanFormat::Csv => csv(&scan, Columns { intensity, cartesian: false }),
            ScanFormat::CsvXy => csv(&scan, Columns { intensity, cartesian: true }),
            ScanFormat::Svg => svg::svg(&scan, &sensor.version().await.map_err(at_port)?),
        };
        print(text).await
    }
}

fn csv(scan: &Scan, columns: Columns) -> String {
    format!("{}{}", columns.header(), csv::rows(scan, columns))
}
