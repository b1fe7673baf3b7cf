//! Options that several commands share, and the parsers of their values. Options of a single
//! command are in its own file.

use std::time::Duration;

use clap::{Args, ValueEnum};
use tokio_scip::protocol::Protocol;
use tokio_scip::{BaudRate, Rate, Window};
use urg_recording::Compression;

use crate::failure::Failure;

/// Options for the link to the sensor.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "Link")]
pub(crate) struct LinkArgs {
    /// Baud rate to use [default: the sensor's current baud rate]
    ///
    /// One of 19200, 57600, 115200, 250000, 500000 and 750000. You need not know the current one: the
    /// sensor is detected at any of them, then set to this one. A sensor on USB has no baud rate.
    #[arg(long, value_name = "RATE")]
    pub(crate) baud: Option<BaudRate>,
    /// Protocol to speak; `auto` takes the one that the sensor speaks
    ///
    /// `scip2` makes a URG-04LX speak SCIP 2 until it is power-cycled: it then measures up to
    /// 5.6 m. `scip1` refuses a sensor that speaks SCIP 2.
    #[arg(long, value_enum, value_name = "NAME", default_value_t = ProtocolName::Auto)]
    pub(crate) protocol: ProtocolName,
    /// Measure intensities, too, with a UTM or UST
    ///
    /// JSON, CSV, the table and the messages of ROS have them, and pictures show them as shades.
    /// They double the length of a reply.
    #[arg(long)]
    pub(crate) intensity: bool,
    /// Wait for the sensor to appear, without a time limit
    #[arg(long)]
    pub(crate) wait: bool,
    /// Fail if the sensor is not found within this time [default: 5s]
    #[arg(long, value_name = "TIME", value_parser = duration, allow_hyphen_values = true,
        conflicts_with = "wait")]
    pub(crate) timeout: Option<Duration>,
}

/// Protocol of the sensor, as the user names it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub(crate) enum ProtocolName {
    #[default]
    Auto,
    Scip1,
    Scip2,
}

impl ProtocolName {
    /// Protocol to ask for, or `None` to take the sensor's own.
    pub(crate) fn wanted(self) -> Option<Protocol> {
        match self {
            Self::Auto => None,
            Self::Scip1 => Some(Protocol::Scip1),
            Self::Scip2 => Some(Protocol::Scip2),
        }
    }
}

/// Compression of a recording that is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum CompressionName {
    None,
    #[cfg(feature = "compression")]
    Lz4,
    #[cfg(feature = "zstd")]
    Zstd,
}

impl From<CompressionName> for Compression {
    fn from(name: CompressionName) -> Self {
        match name {
            CompressionName::None => Self::Plain,
            #[cfg(feature = "compression")]
            CompressionName::Lz4 => Self::Lz4,
            #[cfg(feature = "zstd")]
            CompressionName::Zstd => Self::Zstd,
        }
    }
}

/// Option of the commands that write a recording anew.
#[derive(Debug, Clone, Copy, Args)]
pub(crate) struct CopyArgs {
    /// Compression of the copy [default: as in the files that are read]
    #[arg(long, value_name = "NAME", value_enum)]
    compress: Option<CompressionName>,
}

impl CopyArgs {
    /// Compression, or `None` to keep the compression of the inputs.
    pub(crate) fn compression(&self) -> Option<Compression> {
        self.compress.map(Compression::from)
    }
}

/// Options for the steps to measure. A recording has its own default.
#[derive(Debug, Args)]
#[command(next_help_heading = "Window")]
pub(crate) struct WindowArgs {
    /// Steps to measure: detection (all that the sensor measures), full (all that it sends, which is
    /// more in SCIP 1.1: 0..768), or FIRST..LAST [default: detection, or as recorded]
    ///
    /// Step 0 is at the right, and a model has steps of its own (see `urg info`): of a URG-04LX step
    /// 384 is the front, of a UST 540. --from and --to mean the same directions for each model.
    #[arg(long, value_name = "WINDOW", value_parser = named_window,
        conflicts_with_all = ["from", "to"])]
    window: Option<Window>,
    /// Steps per point, 1 to 99; the sensor sends the smallest distance of each cluster, but in
    /// SCIP 1.1 any error code hides it [default: 1, or as recorded]
    #[arg(long, value_name = "STEPS", value_parser = clap::value_parser!(u8).range(1..=99))]
    cluster: Option<u8>,
    /// First direction, -135deg (right) to 135deg (left), instead of --window [default: the last
    /// one that the sensor measures]
    #[arg(long, value_name = "DEGREES", value_parser = degrees, allow_hyphen_values = true)]
    from: Option<f64>,
    /// Last direction, as for --from
    #[arg(long, value_name = "DEGREES", value_parser = degrees, allow_hyphen_values = true)]
    to: Option<f64>,
}

impl WindowArgs {
    /// Computes the requested window. `default` provides what the options leave out.
    pub(crate) fn window(&self, default: Window) -> Result<Window, Failure> {
        let window = match (self.window, self.from, self.to) {
            (Some(window), ..) => Ok(window),
            (None, None, None) => default.with_cluster_count(1),
            (None, from, to) => {
                Window::degrees(from.unwrap_or(f64::NEG_INFINITY)..=to.unwrap_or(f64::INFINITY))
            }
        };
        window
            .and_then(|window| {
                window.with_cluster_count(self.cluster.unwrap_or(default.cluster_count()))
            })
            .map_err(|error| Failure::Usage(error.to_string()))
    }
}

/// Options for the rate and the length of a stream.
#[derive(Debug, Args)]
#[command(next_help_heading = "Pace")]
pub(crate) struct PaceArgs {
    /// Scans a second, or `max` for as fast as the sensor answers [default: 10; a
    /// recording: its own pace]
    #[arg(long, value_name = "HZ", allow_hyphen_values = true)]
    pub(crate) rate: Option<Rate>,
    /// Stop after this many scans
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) count: Option<u64>,
    /// Stop after this time, without the wait for the sensor: 10s, 500ms, 5m, 1h
    #[arg(long, value_name = "TIME", value_parser = duration, allow_hyphen_values = true)]
    pub(crate) duration: Option<Duration>,
}

/// Parses `detection`, `full` or `44..725`.
fn named_window(text: &str) -> Result<Window, String> {
    let steps = || text.split_once("..").map(|(from, to)| (from, to.trim_start_matches('=')));
    match text {
        "detection" => return Ok(Window::DETECTION),
        "full" => return Ok(Window::FULL),
        _ => {}
    }
    match steps().map(|(from, to)| (from.parse::<u16>(), to.parse::<u16>())) {
        Some((Ok(from), Ok(to))) => Window::new(from..=to).map_err(|error| error.to_string()),
        _ => Err("expected detection, full, or two steps such as 44..725".to_owned()),
    }
}

/// Parses `-90deg` or `-90`.
fn degrees(text: &str) -> Result<f64, &'static str> {
    let number = text.strip_suffix("deg").unwrap_or(text).trim_end();
    number
        .parse()
        .ok()
        .filter(|degrees: &f64| degrees.is_finite())
        .ok_or("expected a number of degrees, such as -90 or -90deg")
}

/// Parses an address to listen on. A port number alone, such as `8080`, means this machine
/// only: there is no password.
pub(crate) fn listen_address(text: &str) -> Result<String, &'static str> {
    let (host, port) = text.rsplit_once(':').unwrap_or(("", text));
    match (host, port.parse::<u16>()) {
        ("", Ok(port)) => Ok(format!("127.0.0.1:{port}")),
        (_, Ok(_)) => Ok(text.to_owned()),
        (_, Err(_)) => {
            Err("expected a port number such as 8080, or ADDRESS:PORT such as 0.0.0.0:8080")
        }
    }
}

/// Checks the name of a coordinate frame. ROS uses it unchanged.
pub(crate) fn frame_id(text: &str) -> Result<String, &'static str> {
    urg_recording::ros::is_frame_id(text).then(|| text.to_owned()).ok_or(
        "expected a name such as laser, without a leading `/`, blanks and control characters",
    )
}

/// Parses `10s`, `500ms`, `5m`, `1h`, a sum such as `1h 30m`, `1:30:00`, or a number of seconds.
pub(crate) fn duration(text: &str) -> Result<Duration, &'static str> {
    clock_time(text)
        .filter(|duration| !duration.is_zero())
        .ok_or("expected a time above 0, such as 500ms, 10s, 5m or 1h")
}

/// Parses `90s`, `1m 30s`, `90`, `1:30` or `1:02:03`.
pub(crate) fn clock_time(text: &str) -> Option<Duration> {
    if text.contains(char::is_alphabetic) {
        return humantime::parse_duration(&text.replace(',', " ")).ok();
    }
    let parts = text.split(':').map(|part| part.parse::<f64>().ok().filter(|n| *n >= 0.0));
    let seconds = parts.into_iter().try_fold(0.0, |sum, part| Some(sum * 60.0 + part?))?;
    Duration::try_from_secs_f64(seconds).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_duration_is_a_number_and_a_unit() {
        for (text, millis) in [
            ("10s", 10_000),
            ("10", 10_000),
            ("0.5", 500),
            ("500ms", 500),
            ("1.5m", 90_000),
            ("5min", 300_000),
            ("1h", 3_600_000),
            ("1h 30m", 5_400_000),
            ("1 hour, 30 minutes", 5_400_000),
            ("1:30:00", 5_400_000),
        ] {
            assert_eq!(duration(text), Ok(Duration::from_millis(millis)), "{text}");
        }
        for text in ["s", "", "-1", "-1s", "0", "0s", "nans", "infs", "1e30h", "1:-30"] {
            assert!(duration(text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_frame_has_a_name() {
        assert_eq!(frame_id("front/laser"), Ok("front/laser".to_owned()));
        for text in ["", " ", "a b", "a\u{1b}[2J", "a\n", "/laser", &"n".repeat(241)] {
            assert!(frame_id(text).is_err(), "{text:?}");
        }
    }

    #[test]
    fn a_window_has_a_name_or_two_steps() {
        for text in ["44..725", "44..=725", "detection"] {
            assert_eq!(named_window(text), Ok(Window::DETECTION), "{text}");
        }
        assert_eq!(named_window("0..1080").unwrap().points(), 1081);
        for text in ["", "half", "..", "1..", "200..100", "0..10000", "-1..5"] {
            assert!(named_window(text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_port_number_alone_listens_on_this_machine() {
        for (text, address) in [
            ("4001", "127.0.0.1:4001"),
            (":4001", "127.0.0.1:4001"),
            ("[::]:4001", "[::]:4001"),
            ("robot.local:0", "robot.local:0"),
        ] {
            assert_eq!(listen_address(text).as_deref(), Ok(address), "{text}");
        }
        for text in ["", "1.2.3.4", "localhost:", "[::1]", "0.0.0.0:65536"] {
            assert!(listen_address(text).is_err(), "{text}");
        }
    }
}
