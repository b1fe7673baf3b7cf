//! `urg info`: the identity of a sensor, and its settings.

use std::fmt::Write;

use clap::ValueEnum;
use serde_json::{Value, json};
use tokio_scip::{BaudRate, Sensor, Version, Window};

use crate::args::LinkArgs;
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::format::json;
use crate::output::stdout::print;
use crate::port::name::{PortArg, PortName};
use crate::port::open::open_with;
use crate::stream::wire_speed::{self, FastestReply};

/// Show the identity of a sensor, and its settings
///
/// Finds the sensor at any baud rate. SCIP 1.1 has no way to ask whether the
/// laser is on. For a recording it also shows the number of scans, and the gaps.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  urg info /dev/ttyACM0\n  urg info serial:H0713090 --format json"
)]
pub(crate) struct Info {
    #[command(flatten)]
    port: PortArg,
    /// Form of the output
    #[arg(long, value_enum, default_value_t = InfoFormat::Text)]
    format: InfoFormat,
    #[command(flatten)]
    link: LinkArgs,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum InfoFormat {
    Text,
    Json,
}

impl Info {
    pub(crate) async fn run(self) -> Result<(), Failure> {
        let port = self.port.required().await?;
        let fastest = FastestReply::default();
        let builder = Sensor::builder().on_reply(fastest.observer());
        let sensor = open_with(&port, &self.link, Delivery::Newest, builder).await?;
        let version =
            sensor.version().await.map_err(|error| Failure::at(&port.to_string(), &error))?;
        let baud_rate = sensor.state().borrow().baud_rate();
        // A sensor that was moved had another baud rate before.
        let is_ignored = self.link.baud.is_none() && baud_rate.is_some_and(|r| fastest.outruns(r));
        let contents = match port.recorded() {
            Some(recorded) => recorded.contents().await?,
            None => Vec::new(),
        };
        match self.format {
            InfoFormat::Text => {
                let mut text = text(&port, &version, &baud_rate_text(baud_rate, is_ignored));
                for (name, _, value) in contents {
                    row(&mut text, name, &value);
                }
                print(&text).await
            }
            InfoFormat::Json => {
                let port = port.to_string();
                let mut info = json!({
                    "port": port,
                    "baud_rate": baud_rate,
                    "baud_rate_is_ignored": is_ignored,
                    "version": version,
                });
                if let Value::Object(info) = &mut info {
                    info.extend(
                        contents.into_iter().map(|(name, data, _)| (name.to_owned(), data)),
                    );
                }
                print(&json::line(&info)?).await
            }
        }
    }
}

fn text(port: &PortName, version: &Version, baud_rate: &str) -> String {
    let mut text = String::new();
    let mut row = |name, value: String| row(&mut text, name, &value);
    row("port", port.to_string());
    row("baud rate", baud_rate.to_owned());
    row("product", version.product.to_string());
    row("vendor", version.vendor.to_string());
    row("serial number", version.serial_number.to_string());
    row("firmware", version.firmware.to_string());
    row("protocol", version.protocol.to_string());
    if let Some(status) = &version.status {
        row("status", status.to_string());
    }
    for line in &version.other {
        row("other", line.to_string());
    }
    if let Some(specification) = &version.specification {
        if let Some(range) = &specification.range {
            row("measures", format!("{} to {} mm", range.start(), range.end()));
        }
        if let Some(steps) = &specification.steps {
            row("window", window(*steps.start(), *steps.end()));
        }
        if let Some(rpm) = specification.motor_speed {
            row(
                "motor",
                format!("{rpm} rpm: {} revolutions, and so scans, a second", f64::from(rpm) / 60.0),
            );
        }
    }
    text
}

fn row(text: &mut String, name: &str, value: &str) {
    // Writing to a string does not fail.
    let _ = writeln!(text, "{name:<14} {value}");
}

/// Returns the steps that the sensor measures, with their directions.
fn window(start: u16, end: u16) -> String {
    match Window::new(start..=end) {
        Ok(window) => format!(
            "steps {start} to {end}, {:.2}° to {:.2}°",
            window.start().degrees(),
            window.end().degrees()
        ),
        Err(_) => format!("steps {start} to {end}"),
    }
}

fn baud_rate_text(baud_rate: Option<BaudRate>, is_ignored: bool) -> String {
    match baud_rate {
        None => "none (USB)".to_owned(),
        Some(rate) if is_ignored => {
            format!("none, though {rate} is set: {}", wire_speed::explanation(rate))
        }
        Some(rate) => {
            let most = 1.0 / Window::DETECTION.wire_time(rate).as_secs_f64();
            format!("{rate} baud: at most {most:.1} scans a second of the whole detection window")
        }
    }
}
