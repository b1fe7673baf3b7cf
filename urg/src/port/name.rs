//! PORT argument: an endpoint of the library, `emulated`, or a recording.

use std::ffi::OsString;
use std::fmt;
use std::path::Path;
use std::str::FromStr;
use std::time::Duration;

use clap::builder::{OsStringValueParser, TypedValueParser};
use tokio_scip::port;
use tokio_scip::scan::Pose;
use tokio_scip::{BaudRate, Endpoint, Error, ErrorKind, Rate, Window};

use crate::failure::Failure;
use crate::recording::recorded::Recorded;
use crate::recording::span::{RangeArgs, TopicArgs};

/// Default rate: one poll per revolution of the motor.
const DEFAULT_RATE: Rate = Rate::every(Duration::from_millis(100));

#[derive(Debug, Clone, clap::Args)]
pub(crate) struct PortArg {
    /// Where the sensor is: a serial port, serial:NUMBER, tcp://HOST, FILE.mcap, - or
    /// emulated (see `urg help`)
    #[arg(value_name = "PORT", value_parser = argument::<PortName>())]
    pub(crate) name: Option<PortName>,
}

#[derive(Debug, Clone)]
pub(crate) enum PortName {
    Endpoint(Endpoint),
    /// Sensor emulated inside this program. The library does not know the name, so that no
    /// service mistakes emulated scans for real ones. All share one room, each at its own pose.
    Emulated(Pose),
    Recording(Recorded),
}

impl FromStr for PortName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "emulated" => return Ok(Self::Emulated(Pose::default())),
            after if matches!(after, "on" | "off") || after.parse::<BaudRate>().is_ok() => {
                return Err(format!("expected a port, and {after} after it"));
            }
            _ => {}
        }
        if let Some(recorded) = Recorded::named(Path::new(text)) {
            return Ok(Self::Recording(recorded));
        }
        if is_nearly(text, "emulated") {
            return Err("did you mean `emulated`?".to_owned());
        }
        text.parse().map(Self::Endpoint).map_err(|error: Error| match error.kind() {
            // clap's message already shows the text.
            ErrorKind::InvalidEndpoint { reason, .. } => (*reason).to_owned(),
            _ => error.to_string(),
        })
    }
}

/// Parser of an argument with a port. The path of a recording need not be UTF-8.
pub(crate) fn argument<T>() -> impl TypedValueParser<Value = T>
where
    T: FromStr<Err = String> + From<PortName> + Clone + Send + Sync + 'static,
{
    OsStringValueParser::new().try_map(|argument: OsString| match argument.to_str() {
        Some(text) => text.parse(),
        None => match Recorded::named(Path::new(&argument)) {
            Some(recorded) => Ok(PortName::Recording(recorded).into()),
            None => Err("expected UTF-8, or the path of a recording, FILE.mcap".to_owned()),
        },
    })
}

/// Checks whether `text` is a misspelt `word`, and not a file.
fn is_nearly(text: &str, word: &str) -> bool {
    strsim::osa_distance(text, word) <= 2 && !Path::new(text).exists()
}

impl fmt::Display for PortName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Endpoint(endpoint) => endpoint.fmt(f),
            Self::Emulated(_) => f.write_str("emulated"),
            Self::Recording(recorded) => recorded.fmt(f),
        }
    }
}

impl PortName {
    /// Name of the line to a sensor that has no baud rate.
    pub(crate) fn line(&self) -> &'static str {
        match self {
            Self::Endpoint(Endpoint::Tcp { .. }) => "Ethernet",
            Self::Recording(_) => "USB or Ethernet",
            Self::Endpoint(_) | Self::Emulated(_) => "USB",
        }
    }

    pub(crate) fn recorded(&self) -> Option<&Recorded> {
        match self {
            Self::Recording(recorded) => Some(recorded),
            Self::Endpoint(..) | Self::Emulated(_) => None,
        }
    }

    /// Chooses the part of a recording and the topic of its scans. A sensor has neither: usage error.
    pub(crate) fn choose(&mut self, range: RangeArgs, topic: &TopicArgs) -> Result<(), Failure> {
        let (option, instead) = match self {
            Self::Recording(recorded) => {
                recorded.range = range.range;
                recorded.topic.clone_from(&topic.topic);
                return Ok(());
            }
            _ if range.range.is_some() => ("--range", ", and --duration ends it"),
            _ if topic.topic.is_some() => ("--topic", ""),
            _ => return Ok(()),
        };
        let text = format!("{option} is for a recording, FILE.mcap: {self} is a sensor{instead}");
        Err(Failure::Usage(text))
    }

    /// Default window: the recorded window, else [`Window::DETECTION`].
    pub(crate) fn default_window(&self) -> Window {
        self.recorded().and_then(Recorded::window).unwrap_or(Window::DETECTION)
    }
}

impl PortArg {
    /// Resolves the port, and reads the settings of a recording. Without PORT, the error suggests one.
    pub(crate) async fn required(&self) -> Result<PortName, Failure> {
        let Some(mut port) = self.name.clone() else { return Err(missing_port().await) };
        if let PortName::Recording(recorded) = &mut port {
            recorded.read_settings().await?;
        }
        Ok(port)
    }

    /// Resolves the port and its rate: `rate`, else the recorded rate, else the default.
    pub(crate) async fn polled_at(&self, rate: Option<Rate>) -> Result<(PortName, Rate), Failure> {
        let mut port = self.required().await?;
        let rate = match &mut port {
            PortName::Recording(recorded) => recorded.set_pace(rate),
            PortName::Endpoint(..) | PortName::Emulated(_) => rate.unwrap_or(DEFAULT_RATE),
        };
        Ok((port, rate))
    }
}

/// Error for a command line without PORT. Suggests the likely sensors of this machine.
pub(crate) async fn missing_port() -> Failure {
    let ports = port::list().await.unwrap_or_default();
    let likely = ports.iter().filter(|port| port.likely_sensor);
    let likely: Vec<_> = likely.map(|port| port.path.as_str()).collect();
    let mut words: Vec<_> = std::env::args_os().skip(1).collect();
    // The emulated sensor speaks SCIP 1.1, which cannot restart it.
    let is_reboot = words.first().is_some_and(|command| command == "reboot");
    let example = likely.first().unwrap_or(if is_reboot { &"tcp://HOST" } else { &"emulated" });
    words.insert(words.len().min(1), example.into());
    let found = match likely.as_slice() {
        [] => "No serial port here is a likely sensor".to_owned(),
        likely => format!("Likely sensors: {}", likely.join(", ")),
    };
    let words = words.join(" ".as_ref()).to_string_lossy().into_owned();
    Failure::Usage(format!("which PORT? {found} (see `urg list`). Try `urg {words}`"))
}
