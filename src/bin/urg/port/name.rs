//! The PORT argument: an endpoint of the library, `emulated`, or a recording.

use std::fmt;
use std::path::Path;
use std::str::FromStr;
use std::time::Duration;

use tokio_scip::{Endpoint, Error, Rate, Window};

use super::missing;
use super::sampled::ByteSample;
use crate::failure::Failure;
use crate::recording::span::TimeSpan;
use crate::recording::{self, recorded::Recorded};

/// The rate of polls by default: one for each revolution of the motor.
const DEFAULT_RATE: Rate = Rate::every(Duration::from_millis(100));

/// A PORT argument.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct PortArg {
    #[arg(value_name = "PORT", help = help())]
    pub(crate) name: Option<PortName>,
}

fn help() -> String {
    let recording = if recording::AVAILABLE { "FILE.mcap " } else { "" };
    format!(
        "Where the sensor is: a serial port, serial:NUMBER, tcp://HOST:PORT, \
         {recording}or emulated (see `urg help`)"
    )
}

/// The place of a sensor.
#[derive(Debug, Clone)]
pub(crate) enum PortName {
    /// A real port, and a sample of what came from it.
    Endpoint(Endpoint, ByteSample),
    /// A sensor in software, inside this program. Only the program knows the
    /// name, so that no service takes scans of nothing for real ones.
    Emulated,
    /// A recording of a sensor.
    Recording(Recorded),
}

impl FromStr for PortName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(recorded) = Recorded::named(text)? {
            return Ok(Self::Recording(recorded));
        }
        match text {
            "emulated" => Ok(Self::Emulated),
            "on" | "off" => Err(format!("expected a port, and {text} after it")),
            _ if is_nearly(text, "emulated") => Err("did you mean `emulated`?".to_owned()),
            _ => text
                .parse()
                .map(|endpoint| Self::Endpoint(endpoint, ByteSample::default()))
                .map_err(|error| match error {
                    // clap has shown the text already.
                    Error::InvalidEndpoint { reason, .. } => reason.to_owned(),
                    error => error.to_string(),
                }),
        }
    }
}

/// Returns whether `text` is a misspelt `word`, and no file.
fn is_nearly(text: &str, word: &str) -> bool {
    strsim::osa_distance(text, word) <= 2 && !Path::new(text).exists()
}

impl fmt::Display for PortName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Endpoint(endpoint, _) => endpoint.fmt(f),
            Self::Emulated => f.write_str("emulated"),
            Self::Recording(recorded) => recorded.fmt(f),
        }
    }
}

impl PortName {
    pub(crate) fn recorded(&self) -> Option<&Recorded> {
        match self {
            Self::Recording(recorded) => Some(recorded),
            Self::Endpoint(..) | Self::Emulated => None,
        }
    }

    /// Restricts a recording to a part of it. Fails for a sensor.
    pub(crate) fn restrict(&mut self, range: Option<TimeSpan>) -> Result<(), Failure> {
        let Some(range) = range else { return Ok(()) };
        match self {
            Self::Recording(recorded) => {
                recorded.restrict(range);
                Ok(())
            }
            Self::Endpoint(..) | Self::Emulated => Err(Failure::Usage(format!(
                "--range is for a recording, FILE.mcap: {self} is a sensor, and --duration ends it"
            ))),
        }
    }

    /// Returns the default window: the recorded one, or the whole detection
    /// window.
    pub(crate) fn default_window(&self) -> Window {
        self.recorded().and_then(Recorded::window).unwrap_or(Window::DETECTION)
    }
}

impl PortArg {
    /// Returns the port. Fails with a hint if there is none on the command line,
    /// and if it is a recording that cannot be read.
    pub(crate) async fn required(&self) -> Result<PortName, Failure> {
        let Some(mut port) = self.name.clone() else { return Err(missing::failure().await) };
        if let PortName::Recording(recorded) = &mut port {
            recorded.read_settings()?;
        }
        Ok(port)
    }

    /// Returns the port, and the rate of its polls: `rate`, or else the
    /// recorded or the default one.
    pub(crate) async fn polled_at(&self, rate: Option<Rate>) -> Result<(PortName, Rate), Failure> {
        let mut port = self.required().await?;
        let recorded = match &mut port {
            PortName::Recording(recorded) => recorded.set_pace(rate),
            PortName::Endpoint(..) | PortName::Emulated => None,
        };
        Ok((port, rate.or(recorded).unwrap_or(DEFAULT_RATE)))
    }
}
