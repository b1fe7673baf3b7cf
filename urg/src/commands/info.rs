//! `urg info`: identity and settings of a sensor.

use std::fmt::Write;

use clap::ValueEnum;
use serde_json::{Value, json};
use tokio_scip::{BaudRate, Geometry, Version, Window};

use crate::args::LinkArgs;
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::format::json_line;
use crate::output::notice::escaped;
use crate::output::stdout::print;
use crate::port::name::{PortArg, PortName};
use crate::port::open::{open, proven_baud_rate};
use crate::recording::contents::Contents;
use crate::recording::span::TopicArgs;

/// Show the identity and settings of a sensor
///
/// Finds the sensor at any baud rate. It cannot show whether the laser is on: SCIP 1.1
/// has no request for that. For a recording you also see the number of scans and the
/// gaps.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  urg info /dev/ttyACM0\n  urg info serial:H0713090 --format json"
)]
pub(crate) struct Info {
    #[command(flatten)]
    port: PortArg,
    /// Output format
    #[arg(long, value_enum, default_value_t = InfoFormat::Text)]
    format: InfoFormat,
    #[command(flatten)]
    topic: TopicArgs,
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
        let mut port = self.port.required().await?;
        port.choose_topic(&self.topic)?;
        let (version, baud_rate, rows) = match port.recorded() {
            Some(recorded) => {
                let Contents { version, baud_rate, rows, .. } = recorded.contents().await?;
                (version, baud_rate.map(|rate| rate.map(|rate| (rate, None))), rows)
            }
            None => {
                let sensor = open(&port, &self.link, Delivery::Newest).await?;
                let version = sensor.version().await;
                let version = version.map_err(|error| Failure::at(&port, &error))?;
                (version, Some(proven_baud_rate(&sensor).await), Vec::new())
            }
        };
        let output = match self.format {
            InfoFormat::Text => {
                let mut text = text(&port, &version, baud_rate.as_ref());
                rows.iter().for_each(|(name, _, value)| row(&mut text, name, value));
                text
            }
            InfoFormat::Json => {
                let baud_rate = baud_rate.flatten();
                let mut info = json!({
                    "port": port.to_string(),
                    "baud_rate": baud_rate.as_ref().map(|(rate, _)| rate),
                    "baud_rate_is_ignored": matches!(baud_rate, Some((_, Some(_)))),
                    "version": version,
                });
                if let Value::Object(info) = &mut info {
                    info.extend(rows.into_iter().map(|(name, data, _)| (name.to_owned(), data)));
                }
                json_line(&info)?
            }
        };
        print(output).await
    }
}

/// Baud rate, and why the port ignores it; `None` on USB.
type Speed = Option<(BaudRate, Option<String>)>;

/// Rows of what is known.
fn text(port: &PortName, version: &Version, baud_rate: Option<&Speed>) -> String {
    let mut text = String::new();
    let mut row = |name, value: String| {
        if !value.is_empty() {
            row(&mut text, name, &value);
        }
    };
    row("port", port.to_string());
    row("baud rate", baud_rate.map(baud_rate_text).unwrap_or_default());
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
                format!(
                    "{rpm} rpm nominal: {} revolutions, and so scans, a second; \
                     urg check polls, and measures it",
                    f64::from(rpm) / 60.0
                ),
            );
        }
    }
    text
}

fn row(text: &mut String, name: &str, value: &str) {
    // Writing to a `String` is infallible. A file name may contain control characters.
    let _ = writeln!(text, "{:<14} {}", name.replace('_', " "), escaped(value));
}

/// Formats the sensor's steps, with their directions.
fn window(start: u16, end: u16) -> String {
    match Window::new(start..=end) {
        Ok(window) => format!(
            "steps {start} to {end}, {:.2}° to {:.2}°",
            Geometry::URG_04LX.degrees(window.start()),
            Geometry::URG_04LX.degrees(window.end())
        ),
        Err(_) => format!("steps {start} to {end}"),
    }
}

fn baud_rate_text(baud_rate: &Speed) -> String {
    match baud_rate {
        None => "none (USB)".to_owned(),
        Some((_, Some(why))) => format!("none: {why}"),
        Some((rate, None)) => {
            let most = 1.0 / Window::DETECTION.wire_time(*rate).as_secs_f64();
            format!("{rate} baud: at most {most:.1} scans a second of the whole detection window")
        }
    }
}
