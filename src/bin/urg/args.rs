//! What can be written on the command line: the commands, and the options that
//! several of them share. An option of one command is with that command.

use std::time::Duration;

use clap::{Args, Parser, Subcommand};
use tokio_scip::{BaudRate, Rate, Window};

#[cfg(feature = "mcap")]
use crate::commands::record;
#[cfg(feature = "web")]
use crate::commands::serve;
use crate::commands::{
    baud, check, completions, emulate, info, laser, list, man, scan, stream, view,
};
use crate::failure::Failure;
use crate::port::PortName;

/// Talks to Hokuyo URG laser range sensors that speak SCIP 1.1.
///
/// Data goes to standard output, all else to standard error. Exit codes: 0 when
/// done or stopped by Ctrl-C, 1 on failure, 2 for a command line that makes no
/// sense. RUST_LOG=debug shows what the driver does.
#[derive(Debug, Parser)]
#[command(
    name = "urg",
    version,
    arg_required_else_help = true,
    after_help = help()
)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    List(list::List),
    Info(info::Info),
    Scan(scan::ScanOnce),
    Stream(stream::Stream),
    View(view::View),
    #[cfg(feature = "mcap")]
    Record(record::Record),
    Check(check::Check),
    #[cfg(feature = "web")]
    Serve(serve::Serve),
    Laser(laser::Laser),
    Baud(baud::Baud),
    Emulate(emulate::Emulate),
    Completions(completions::Completions),
    #[command(hide = true)]
    Man(man::Manual),
}

impl Command {
    /// Whether it takes the terminal for itself.
    pub(crate) fn draws(&self) -> bool {
        matches!(self, Self::View(_))
    }
}

/// What PORT may be, and how to begin.
fn help() -> String {
    let (recording, record) = match cfg!(feature = "mcap") {
        true => (
            "\n  FILE.mcap               a recording: the sensor as it was",
            "\n  urg record /dev/ttyACM0 run.mcap          record, and then: urg view run.mcap",
        ),
        false => ("", ""),
    };
    format!(
        "\
PORT is one of
  /dev/ttyACM0, COM3      a serial port; /dev/serial/by-path/... names stay the same
  serial:H0713090         the sensor of this serial number, wherever it is plugged in
  tcp://HOST:PORT         a raw TCP bridge to a serial port; ?baud=N for its baud rate{recording}
  emulated                a sensor in software, to try things out

Examples:
  urg list                                  which ports are there?
  urg info /dev/ttyACM0                     who is it, and how is it set?
  urg view emulated                         a live radar, without any hardware
  urg stream emulated --count 20            20 scans as NDJSON, without any hardware{record}
  urg emulate --link /tmp/urg               an emulated sensor for other programs"
    )
}

/// How to get to the sensor.
#[derive(Debug, Args)]
#[command(next_help_heading = "Link")]
pub(crate) struct LinkArgs {
    /// Baud rate to run at; without it the sensor is left at the one it has
    ///
    /// One of 19200, 57600, 115200, 250000, 500000 and 750000. The sensor is
    /// found at whatever speed it has, and moved to this one. A sensor on USB
    /// has none.
    #[arg(long, value_name = "SPEED")]
    pub(crate) baud: Option<BaudRate>,
    /// Wait for the sensor to appear, however long that takes
    #[arg(long)]
    pub(crate) wait: bool,
}

/// Which steps to measure; of a recording, those that were recorded unless told
/// otherwise.
#[derive(Debug, Args)]
#[command(next_help_heading = "Window")]
pub(crate) struct WindowArgs {
    /// First step, 0 to 768: 0 is -135 degrees (right), 384 the front [default: 44, or as recorded]
    #[arg(long, value_name = "STEP", value_parser = clap::value_parser!(u16).range(0..=768))]
    start: Option<u16>,
    /// Last step, 0 to 768: 768 is +135 degrees (left) [default: 725, or as recorded]
    #[arg(long, value_name = "STEP", value_parser = clap::value_parser!(u16).range(0..=768))]
    end: Option<u16>,
    /// Steps that make one point, 1 to 99; the sensor sends the smallest value
    /// of each cluster, in which an error code wins over any distance [default: 1, or as
    /// recorded]
    #[arg(long, value_name = "STEPS", value_parser = clap::value_parser!(u8).range(1..=99))]
    cluster: Option<u8>,
    /// Direction to start at, -135deg (right) to 135deg (left), instead of --start
    #[arg(long, value_name = "DEGREES", value_parser = degrees, allow_hyphen_values = true,
        conflicts_with_all = ["start", "end"])]
    from: Option<f64>,
    /// Direction to end at, as --from, instead of --end
    #[arg(long, value_name = "DEGREES", value_parser = degrees, allow_hyphen_values = true,
        conflicts_with_all = ["start", "end"])]
    to: Option<f64>,
}

impl WindowArgs {
    /// The window of `port`, where there is such a one.
    pub(crate) fn window(&self, port: &PortName) -> Result<Window, Failure> {
        let whole = port.window();
        let window = if self.from.is_some() || self.to.is_some() {
            let from = self.from.unwrap_or_else(|| whole.start().degrees().into());
            let to = self.to.unwrap_or_else(|| whole.end().degrees().into());
            Window::degrees(from..=to)
        } else {
            let start = self.start.unwrap_or(whole.start().number());
            Window::new(start..=self.end.unwrap_or(whole.end().number()))
        };
        window
            .and_then(|window| {
                window.with_cluster_count(self.cluster.unwrap_or(whole.cluster_count()))
            })
            .map_err(|error| Failure::Usage(error.to_string()))
    }
}

/// How often, and for how long.
#[derive(Debug, Args)]
#[command(next_help_heading = "Pace")]
pub(crate) struct PaceArgs {
    /// Scans a second, or `max` for as fast as the sensor answers [default: 10; a
    /// recording: its own pace]
    #[arg(long, value_name = "HZ")]
    pub(crate) rate: Option<Rate>,
    /// Stop after this many scans
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) count: Option<u64>,
    /// Stop after this time: 10s, 500ms, 5m, 1h
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub(crate) duration: Option<Duration>,
}

/// `-90deg`, or just `-90`.
fn degrees(text: &str) -> Result<f64, &'static str> {
    let number = text.strip_suffix("deg").unwrap_or(text).trim_end();
    number.parse().ok().filter(|degrees: &f64| degrees.is_finite()).ok_or("write it as -90deg")
}

/// An address to listen on. A lone port number is one of this machine only:
/// whoever can connect can use the sensor.
pub(crate) fn at_home(address: &str) -> String {
    let port = address.strip_prefix(':').unwrap_or(address);
    match port.parse::<u16>() {
        Ok(port) => format!("127.0.0.1:{port}"),
        Err(_) => address.to_owned(),
    }
}

/// `10s`, `500ms`, `5m`, `1h`.
pub(crate) fn duration(text: &str) -> Result<Duration, &'static str> {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let seconds = match text.strip_prefix(digits) {
        Some("ms") => 0.001,
        Some("s") => 1.0,
        Some("m" | "min") => 60.0,
        Some("h") => 3600.0,
        _ => return Err("write it as 10s, 500ms, 5m or 1h"),
    };
    digits
        .parse::<f64>()
        .ok()
        .and_then(|number| Duration::try_from_secs_f64(number * seconds).ok())
        .filter(|duration| !duration.is_zero())
        .ok_or("write it as a number above 0 and a unit: 10s, 500ms, 5m or 1h")
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_command_line_is_sound() {
        Cli::command().debug_assert();
    }

    #[test]
    fn a_duration_is_a_number_and_a_unit() {
        for (text, millis) in [("10s", 10_000), ("500ms", 500), ("1.5m", 90_000), ("1h", 3_600_000)]
        {
            assert_eq!(duration(text), Ok(Duration::from_millis(millis)), "{text}");
        }
        for text in ["10", "s", "", "-1s", "0s", "nans", "infs", "1e30h", "1 s", "1d"] {
            assert!(duration(text).is_err(), "{text}");
        }
    }

    #[test]
    fn degrees_may_have_their_unit() {
        assert_eq!(degrees("-90deg"), Ok(-90.0));
        assert_eq!(degrees("12.5"), Ok(12.5));
        assert!(degrees("inf").is_err());
        assert!(degrees("1rad").is_err());
    }
}
