//! PORT: what it may say, what to offer where it is missing, and how the sensor
//! behind it is opened.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use tokio_scip::emulator::Emulator;
use tokio_scip::port::{self, PortInfo};
use tokio_scip::{BaudRate, Endpoint, Error, Sensor, SensorBuilder};

use crate::args::LinkArgs;
use crate::failure::Failure;
use crate::notice::notice;

/// How long opening takes before the user is told what it waits for.
const PATIENCE: Duration = Duration::from_secs(1);

/// A PORT argument.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct PortArg {
    /// Where the sensor is: a serial port, serial:NUMBER, tcp://HOST:PORT or
    /// emulated (`urg help` says more)
    #[arg(value_name = "PORT")]
    port: Option<PortName>,
}

/// Where a sensor is.
#[derive(Debug, Clone)]
pub(crate) enum PortName {
    /// A port that is there.
    Endpoint(Endpoint),
    /// A sensor in software, inside this program: a name that only the program
    /// knows, so that no service takes scans of nothing for real ones.
    Emulated,
}

impl FromStr for PortName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "emulated" => Ok(Self::Emulated),
            _ => text.parse().map(Self::Endpoint).map_err(|error| match error {
                // clap has shown the text already.
                Error::InvalidEndpoint { reason, .. } => reason.to_owned(),
                error => error.to_string(),
            }),
        }
    }
}

impl fmt::Display for PortName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Endpoint(endpoint) => endpoint.fmt(f),
            Self::Emulated => f.write_str("emulated"),
        }
    }
}

impl PortArg {
    /// The port, or what to write instead of none.
    pub(crate) async fn required(&self) -> Result<PortName, Failure> {
        match &self.port {
            Some(port) => Ok(port.clone()),
            None => Err(Failure::Usage(offer(&port::list().await.unwrap_or_default()))),
        }
    }
}

/// What to say where PORT is missing.
fn offer(ports: &[PortInfo]) -> String {
    let mut likely = ports.iter().filter(|port| port.is_likely_sensor());
    let example = |port: &str| {
        let mut words: Vec<_> = std::env::args().skip(1).collect();
        words.insert(words.len().min(1), port.to_owned());
        format!("urg {}", words.join(" "))
    };
    match (likely.next(), likely.next()) {
        (Some(only), None) => {
            format!(
                "which PORT? The only likely sensor here is on {0}: `{1}`",
                only.path,
                example(&only.path)
            )
        }
        (Some(one), Some(other)) => format!(
            "which PORT? There are likely sensors on {}, {} and maybe more, see `urg list`",
            one.path, other.path
        ),
        _ if ports.is_empty() => format!(
            "which PORT? No serial port is here: plug the sensor in, or try `{}`",
            example("emulated")
        ),
        _ => format!(
            "which PORT? No likely sensor is here: `urg list` shows the serial ports, `{}` tries it out",
            example("emulated")
        ),
    }
}

/// Opens the sensor. `depth` is how many scans its streams keep.
pub(crate) async fn open(
    port: &PortName,
    link: &LinkArgs,
    depth: usize,
) -> Result<Sensor, Failure> {
    let mut builder = Sensor::builder().ring_depth(depth);
    if let Some(speed) = link.baud {
        builder = builder.baud_rate(speed);
    }
    if link.wait {
        builder = builder.wait_for_sensor();
    }
    let opening = connect(port, builder, link.baud);
    tokio::pin!(opening);
    let opened = tokio::select! {
        opened = &mut opening => opened,
        () = tokio::time::sleep(PATIENCE) => {
            if link.wait {
                notice(format_args!("waiting for a sensor on {port}, Ctrl-C ends it"));
            }
            opening.await
        }
    };
    opened.map_err(|error| Failure::at(&port.to_string(), &error))
}

async fn connect(
    port: &PortName,
    builder: SensorBuilder,
    speed: Option<BaudRate>,
) -> Result<Sensor, Error> {
    match port {
        PortName::Endpoint(endpoint) => builder.open(endpoint.clone()).await,
        PortName::Emulated => {
            let emulator = Emulator::builder();
            // To ask for a line speed is to ask for a sensor that has one.
            let emulator = match speed {
                Some(_) => emulator.line_speed(BaudRate::B19200),
                None => emulator.usb(),
            };
            builder.connect(emulator.build()).await
        }
    }
}
