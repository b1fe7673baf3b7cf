//! `urg scan`: one scan.

use clap::ValueEnum;

use crate::args::{LinkArgs, WindowArgs};
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::format::{csv, json, svg, table};
use crate::output::stdout::print;
use crate::port::name::PortArg;
use crate::port::open::open;

/// Take one scan
///
/// A laser that is off is switched on.
#[derive(Debug, clap::Args)]
#[command(after_help = "`--help` explains the formats", after_long_help = format!("{EXAMPLES}\n\n{}", csv::COLUMNS))]
pub(crate) struct ScanOnce {
    #[command(flatten)]
    port: PortArg,
    /// How to write it: for eyes, or for programs
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
    #[command(flatten)]
    window: WindowArgs,
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
enum Format {
    /// A line a point with direction and distance, and a summary
    Table,
    /// One object, as `urg stream` writes it
    Json,
    /// A row a point
    Csv,
    /// A picture for a report: a polar plot
    Svg,
}

impl ScanOnce {
    pub(crate) async fn run(self) -> Result<(), Failure> {
        let port = self.port.required().await?;
        let window = self.window.window(port.default_window())?;
        let sensor = open(&port, &self.link, Delivery::Newest).await?;
        let at_port = |error| Failure::at(&port.to_string(), &error);
        let scan = sensor.scan(window).await.map_err(at_port)?;
        let text = match self.format {
            Format::Table => table::table(&scan, &sensor.version().await.map_err(at_port)?),
            Format::Json => json::line(&scan)?,
            Format::Csv => format!("{}{}", csv::HEADER, csv::rows(&scan)),
            Format::Svg => svg::svg(&scan, &sensor.version().await.map_err(at_port)?),
        };
        print(&text).await
    }
}
