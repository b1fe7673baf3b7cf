//! `urg info`: who the sensor is, and how it is set.

use std::fmt::Write;

use clap::ValueEnum;
use serde_json::{Value, json};
use tokio_scip::{BaudRate, Version, Window};

use crate::args::LinkArgs;
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::format::json;
use crate::output::stdout::print;
use crate::port::name::{PortArg, PortName};
use crate::port::open::open;

/// Show who the sensor is, and how it is set
///
/// Finds the sensor at whatever baud rate it has. SCIP 1.1 has no way to ask
/// whether the laser is on. Of a recording it also tells how many scans are in it,
/// and where there are gaps.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  urg info /dev/ttyACM0\n  urg info serial:H0713090 --format json"
)]
pub(crate) struct Info {
    #[command(flatten)]
    port: PortArg,
    /// How to write it
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    #[command(flatten)]
    link: LinkArgs,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Format {
    Text,
    Json,
}

impl Info {
    pub(crate) async fn run(self) -> Result<(), Failure> {
        let port = self.port.required().await?;
        let sensor = open(&port, &self.link, Delivery::Newest).await?;
        let version =
            sensor.version().await.map_err(|error| Failure::at(&port.to_string(), &error))?;
        let speed = sensor.state().borrow().baud_rate();
        let contents = match port.recorded() {
            Some(recorded) => recorded.contents().await?,
            None => Vec::new(),
        };
        match self.format {
            Format::Text => {
                let mut text = text(&port, &version, speed);
                for (name, _, told) in contents {
                    row(&mut text, name, &told);
                }
                print(&text).await
            }
            Format::Json => {
                let port = port.to_string();
                let mut info = json!({ "port": port, "baud_rate": speed, "version": version });
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

fn text(port: &PortName, version: &Version, speed: Option<BaudRate>) -> String {
    let mut text = String::new();
    let mut row = |name, value: String| row(&mut text, name, &value);
    row("port", port.to_string());
    row("baud rate", baud_rate(speed));
    row("product", version.product.to_string());
    row("vendor", version.vendor.to_string());
    row("serial number", version.serial_number.to_string());
    row("firmware", version.firmware.to_string());
    row("protocol", version.protocol.to_string());
    if let Some(status) = &version.status {
        row("status", status.to_string());
    }
    for line in &version.other {
        row("also says", line.to_string());
    }
    if let Some(specification) = &version.specification {
        if let Some(range) = &specification.range {
            row("measures", format!("{} to {} mm", range.start(), range.end()));
        }
        if let Some(steps) = &specification.steps {
            row("window", window(*steps.start(), *steps.end()));
        }
        if let Some(rpm) = specification.motor_speed {
            row("motor", format!("{rpm} rpm, {} scans a second", f64::from(rpm) / 60.0));
        }
    }
    text
}

fn row(text: &mut String, name: &str, value: &str) {
    // Writing to a string does not fail.
    let _ = writeln!(text, "{name:<14} {value}");
}

/// The steps that the sensor measures, with their directions where they have any.
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

fn baud_rate(speed: Option<BaudRate>) -> String {
    match speed {
        None => "none (USB)".to_owned(),
        Some(speed) => {
            let most = 1.0 / Window::DETECTION.wire_time(speed).as_secs_f64();
            format!("{speed} baud: at most {most:.1} scans a second of the whole detection window")
        }
    }
}
