//! Arguments of `urg view` and `urg serve`: the sensors of one picture, and how to show them.

use std::collections::BTreeSet;

use tokio_scip::Rate;

use crate::args::{LinkArgs, WindowArgs};
use crate::failure::Failure;
use crate::playback::PlaybackArgs;
use crate::port::name::{PortArg, missing_port};
use crate::port::named::{NamedPort, PlacedPort};

/// Sensors of one picture: one PORT, or several NAME=PORT@X,Y,YAW, and how to show them.
#[derive(Debug, clap::Args)]
pub(crate) struct PictureArgs {
    /// Where the sensor is: a serial port, serial:NUMBER, tcp://HOST:PORT, FILE.mcap, or
    /// emulated (see `urg help`). To show several sensors in one picture, give each as
    /// NAME=PORT@X,Y,YAW
    #[arg(value_name = "PORT")]
    ports: Vec<PlacedPort>,
    /// Scans a second, or `max` for as fast as the sensor answers [default: 10]
    #[arg(long, value_name = "HZ", allow_hyphen_values = true)]
    rate: Option<Rate>,
    #[command(flatten)]
    pub(crate) window: WindowArgs,
    #[command(flatten)]
    pub(crate) playback: PlaybackArgs,
    #[command(flatten)]
    pub(crate) link: LinkArgs,
}

impl PictureArgs {
    /// Resolves each port and its rate. Several sensors need unique names.
    pub(crate) async fn polled(&self) -> Result<Vec<(PlacedPort, Rate)>, Failure> {
        if self.ports.is_empty() {
            return Err(missing_port().await);
        }
        let names = self.ports.iter().filter_map(|port| port.named.name.as_deref());
        let unique: BTreeSet<_> = names.collect();
        if self.ports.len() > 1 && unique.len() < self.ports.len() {
            let text = "several sensors need a name each, such as \
                        `front=/dev/ttyACM0@0.2,0,0 rear=/dev/ttyACM1@-0.2,0,180`";
            return Err(Failure::Usage(text.to_owned()));
        }
        let mut polled = Vec::new();
        for placed in &self.ports {
            let arg = PortArg { name: Some(placed.named.port.clone()) };
            let (port, rate) = arg.polled_at(self.rate).await?;
            let named = NamedPort { port, ..placed.named.clone() };
            polled.push((PlacedPort { named, pose: placed.pose }, rate));
        }
        let ports = polled.iter_mut().map(|(placed, _)| &mut placed.named.port);
        self.playback.apply(ports, self.rate.is_some())?;
        Ok(polled)
    }
}
