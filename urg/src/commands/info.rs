//! `urg info`: identity and settings of a sensor.

use std::fmt::Write;

use clap::ValueEnum;
use serde_json::{Value, json};
use tokio_scip::protocol::scip2::State;
use tokio_scip::{BaudRate, Geometry, Version, Window};

use crate::args::LinkArgs;
use crate::delivery::Delivery;
use crate::failure::{Failure, chain};
use crate::format::{json_line, time};
use crate::output::notice::escaped;
use crate::output::stdout::print;
use crate::port::name::{PortArg, PortName};
use crate::port::open::{open, proven_baud_rate};
use crate::recording::contents::{Contents, Row};
use crate::recording::span::{RangeArgs, TopicArgs};

/// Show the identity and settings of a sensor
///
/// Finds the sensor at any baud rate, and its protocol. In SCIP 2 it also shows the sensor's
/// clock and state: SCIP 1.1 has no request for these. On a serial line one scan checks the baud
/// rate, and switches the laser on. For a recording you also see the number of scans and the gaps.
#[derive(Debug, clap::Args)]
#[command(
    // It shows no scan.
    mut_arg("intensity", |option| option.hide(true)),
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
        port.choose(RangeArgs::default(), &self.topic)?;
        let (version, geometry, baud_rate, rows): (_, _, _, Vec<Row>) = match port.recorded() {
            Some(recorded) => {
                let Contents { version, geometry, baud_rate, rows, .. } =
                    recorded.contents().await?;
                (version, geometry, baud_rate.map(|rate| rate.map(|rate| (rate, None))), rows)
            }
            None => {
                let sensor = open(&port, &self.link, Delivery::Newest).await?;
                let failed = |error| Failure::at(&port, &error);
                let version = sensor.version().await.map_err(failed)?;
                let geometry = sensor.geometry().await.map_err(failed)?;
                let rows = match sensor.sensor_state().await {
                    Ok(state) => state.map(|state| state_rows(&state).into()).unwrap_or_default(),
                    Err(error) => vec![("state", Value::Null, chain(&error))],
                };
                (version, Some(geometry), Some(proven_baud_rate(&sensor).await), rows)
            }
        };
        let output = match self.format {
            InfoFormat::Text => {
                let mut text = text(&port, &version, geometry.as_ref(), baud_rate.as_ref());
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
                    "protocol": geometry.map(|geometry| geometry.protocol().to_string()),
                    "geometry": geometry,
                    "revolution": geometry.map(|geometry| geometry.revolution().as_secs_f64()),
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

/// Describes what a sensor of SCIP 2 says of itself now.
fn state_rows(state: &State) -> [Row; 2] {
    // Not the laser: opening the sensor has just switched it off.
    let (diagnosis, measuring) = (state.diagnosis.to_string(), state.measuring.to_string());
    let mut words = vec![diagnosis.trim_end_matches('.'), &measuring];
    words.retain(|word| !word.is_empty());
    let clock = state.clock.map(|ms| f64::from(ms) / 1000.0);
    let data = json!({
        "diagnosis": state.diagnosis,
        "measuring": state.measuring,
        "laser_on": state.laser_on,
        "motor_speed": state.motor_speed,
    });
    let reading = clock.map_or("not told".to_owned(), |seconds| {
        format!("{} (starts at 0 with the sensor, and again every 4:39:37)", time::clock(seconds))
    });
    [("state", data, words.join(", ")), ("sensor_time", json!(clock), reading)]
}

/// Baud rate, and why the port ignores it; `None` on USB and Ethernet.
type Speed = Option<(BaudRate, Option<String>)>;

/// Rows of what is known.
fn text(
    port: &PortName,
    version: &Version,
    geometry: Option<&Geometry>,
    baud_rate: Option<&Speed>,
) -> String {
    let mut text = String::new();
    let mut row = |name, value: String| row(&mut text, name, &value);
    row("port", port.to_string());
    let baud_rate = baud_rate.map(|rate| baud_rate_text(port, rate, geometry));
    row("baud rate", baud_rate.unwrap_or_default());
    row("product", version.product.to_string());
    row("vendor", version.vendor.to_string());
    row("serial number", version.serial_number.to_string());
    row("firmware", version.firmware.to_string());
    let protocol = match geometry {
        // A bag of another program does not tell it.
        Some(geometry) if !version.protocol.as_bytes().is_empty() => {
            format!("{} (its own text: {})", geometry.protocol(), version.protocol)
        }
        _ => version.protocol.to_string(),
    };
    row("protocol", protocol);
    if let Some(status) = &version.status {
        row("status", status.to_string());
    }
    for line in &version.other {
        row("other", line.to_string());
    }
    let told = version.specification.as_ref();
    if let Some(geometry) = geometry {
        let (nearest, farthest) = geometry.distances().into_inner();
        row("measures", format!("{nearest} to {farthest} mm"));
        row("window", window(geometry));
        let nominal = 60.0 / geometry.revolution().as_secs_f64();
        row("motor", motor(told.and_then(|told| told.motor_speed).map_or(nominal, f64::from)));
    } else if let Some(told) = told {
        if let Some(range) = &told.range {
            row("measures", format!("{} to {} mm", range.start(), range.end()));
        }
        if let Some(steps) = &told.steps {
            row("window", format!("steps {} to {}", steps.start(), steps.end()));
        }
        row("motor", told.motor_speed.map(|rpm| motor(rpm.into())).unwrap_or_default());
    }
    text
}

fn row(text: &mut String, name: &str, value: &str) {
    if !value.is_empty() {
        // Writing to a `String` is infallible. A file name may contain control characters.
        let _ = writeln!(text, "{:<14} {}", name.replace('_', " "), escaped(value));
    }
}

/// Formats the sensor's steps, with their directions.
fn window(geometry: &Geometry) -> String {
    let (first, last) = geometry.steps().into_inner();
    let [from, to] = [first, last].map(|step| geometry.degrees(step));
    let apart = 360.0 / f64::from(geometry.steps_per_revolution());
    format!("steps {first} to {last}, {from:.2}° to {to:.2}°, {apart:.3}° apart")
}

fn motor(rpm: f64) -> String {
    let rate = (rpm / 6.0).round() / 10.0;
    format!("{rpm:.0} rpm nominal: {rate} revolutions and scans a second; urg check measures it")
}

fn baud_rate_text(port: &PortName, baud_rate: &Speed, geometry: Option<&Geometry>) -> String {
    match baud_rate {
        None => format!("none ({})", port.line()),
        Some((_, Some(why))) => format!("none: {why}"),
        Some((rate, None)) => {
            let geometry = geometry.unwrap_or(&Geometry::URG_04LX);
            let all = Window::DETECTION.resolve(geometry).unwrap_or(Window::DETECTION);
            let most = 1.0 / all.wire_time(*rate, geometry.protocol()).as_secs_f64();
            format!("{rate} baud: at most {most:.1} scans a second of the whole detection window")
        }
    }
}
