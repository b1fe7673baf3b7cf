//! PORT: what it may say, what to offer where it is missing, and how the sensor
//! behind it is opened.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use tokio_scip::emulator::Emulator;
use tokio_scip::port::{self, PortInfo};
use tokio_scip::{BaudRate, Connect, Endpoint, Error, Rate, Sensor, SensorBuilder, State, Window};

use crate::args::LinkArgs;
use crate::failure::{Failure, chain};
use crate::notice::notice;
use crate::recorded::Recorded;

/// How long opening takes before the user is told what it waits for.
const PATIENCE: Duration = Duration::from_secs(1);

/// How often a sensor is polled unless told otherwise: each turn of its motor.
const RATE: Rate = Rate::every(Duration::from_millis(100));

/// A PORT argument.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct PortArg {
    /// Where the sensor is: a serial port, serial:NUMBER, tcp://HOST:PORT,
    /// FILE.mcap or emulated (`urg help` says more)
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
    /// What one was recorded saying.
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
            Self::Recording(recorded) => recorded.fmt(f),
        }
    }
}

impl PortName {
    pub(crate) fn recorded(&self) -> Option<&Recorded> {
        match self {
            Self::Recording(recorded) => Some(recorded),
            Self::Endpoint(_) | Self::Emulated => None,
        }
    }

    /// The window to look at unless told otherwise.
    pub(crate) fn window(&self) -> Window {
        self.recorded().and_then(Recorded::window).unwrap_or(Window::DETECTION)
    }
}

impl PortArg {
    /// The port, or what to write instead of none.
    pub(crate) async fn required(&self) -> Result<PortName, Failure> {
        let Some(mut port) = self.port.clone() else {
            return Err(Failure::Usage(offer(&port::list().await.unwrap_or_default())));
        };
        if let PortName::Recording(recorded) = &mut port {
            recorded.look()?;
        }
        Ok(port)
    }

    /// The same, and how often it is polled where it was asked for `rate`.
    pub(crate) async fn polled_at(&self, rate: Option<Rate>) -> Result<(PortName, Rate), Failure> {
        let mut port = self.required().await?;
        let own = match &mut port {
            PortName::Recording(recorded) => recorded.paced_at(rate),
            PortName::Endpoint(_) | PortName::Emulated => None,
        };
        Ok((port, rate.or(own).unwrap_or(RATE)))
    }

    /// What to say where a recording is asked for with but one name: either which
    /// FILE, or, where it is one, which PORT.
    #[cfg(feature = "mcap")]
    pub(crate) async fn alone(&self) -> Failure {
        let offer = match &self.port {
            Some(port) if port.recorded().is_none() => {
                format!("which FILE.mcap? The recording needs a name: `urg record {port} run.mcap`")
            }
            _ => offer(&port::list().await.unwrap_or_default()),
        };
        Failure::Usage(offer)
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
    open_with(port, link, depth, Sensor::builder()).await
}

/// Opens the sensor as `builder` has it.
pub(crate) async fn open_with(
    port: &PortName,
    link: &LinkArgs,
    depth: usize,
    builder: SensorBuilder,
) -> Result<Sensor, Failure> {
    let sensor = begin(port, link, depth, builder)?;
    opened(port, link, &sensor).await?;
    Ok(sensor)
}

/// Begins to open the sensor, on a driver of its own.
pub(crate) fn begin(
    port: &PortName,
    link: &LinkArgs,
    depth: usize,
    builder: SensorBuilder,
) -> Result<Sensor, Failure> {
    let mut builder = builder.ring_depth(depth);
    if let Some(speed) = link.baud {
        builder = builder.baud_rate(speed);
    }
    if link.wait {
        builder = builder.wait_for_sensor();
    }
    Ok(match port {
        PortName::Endpoint(endpoint) => start(builder, endpoint.clone().into_connector()),
        PortName::Emulated => {
            let emulator = Emulator::builder();
            // To ask for a baud rate is to ask for a sensor that has one.
            let emulator = match link.baud {
                Some(_) => emulator.baud_rate(BaudRate::B19200),
                None => emulator.usb(),
            };
            start(builder, emulator.build())
        }
        // Who keeps more than the newest scan wants them all.
        PortName::Recording(recorded) => recorded.start(builder, depth > 1)?,
    })
}

fn start(builder: SensorBuilder, connect: impl Connect) -> Sensor {
    let (sensor, driver) = builder.build(connect);
    tokio::spawn(driver);
    sensor
}

/// Waits until it is open. Where that takes long it tells what it waits for.
pub(crate) async fn opened(
    port: &PortName,
    link: &LinkArgs,
    sensor: &Sensor,
) -> Result<(), Failure> {
    let opened = tokio::select! {
        opened = sensor.opened() => opened,
        () = tokio::time::sleep(PATIENCE) => {
            if link.wait {
                let why = match &*sensor.state().borrow() {
                    State::Connecting { error: Some(error) } => format!(": {}", chain(error)),
                    _ => String::new(),
                };
                notice(format_args!("waiting for a sensor on {port}, Ctrl-C ends it{why}"));
            }
            sensor.opened().await
        }
    };
    opened.map_err(|error| Failure::at(&port.to_string(), &error))
}
