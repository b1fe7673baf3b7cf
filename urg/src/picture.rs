//! Arguments of `urg view` and `urg serve`: the sensors of one picture, and how to show them.

use std::collections::BTreeSet;

use tokio_scip::scan::Pose;
use tokio_scip::{Rate, Window};

use crate::args::{LinkArgs, WindowArgs};
use crate::failure::Failure;
use crate::playback::PlaybackArgs;
use crate::port::name::{PortArg, PortName, argument, missing_port};
use crate::port::named::{NamedPort, PlacedPort};

/// Sensors of one picture: one PORT, or several NAME=PORT@X,Y,YAW, and how to show them.
#[derive(Debug, clap::Args)]
pub(crate) struct PictureArgs {
    /// Where the sensor is: a serial port, serial:NUMBER, tcp://HOST, FILE.mcap, or emulated (see
    /// `urg help`). To show several sensors in one picture, give each as NAME=PORT@X,Y,YAW
    #[arg(value_name = "PORT", value_parser = argument::<PlacedPort>())]
    ports: Vec<PlacedPort>,
    /// Scans a second, or `max` for as fast as the sensor answers [default: 10]
    #[arg(long, value_name = "HZ", allow_hyphen_values = true)]
    rate: Option<Rate>,
    #[command(flatten)]
    window: WindowArgs,
    #[command(flatten)]
    pub(crate) playback: PlaybackArgs,
    #[command(flatten)]
    pub(crate) link: LinkArgs,
}

/// Sensor or recording of a picture, its place, and how to poll it.
#[derive(Debug)]
pub(crate) struct PictureSource {
    /// Set if the user named it.
    pub(crate) name: Option<String>,
    pub(crate) port: PortName,
    /// Place in the common frame.
    pub(crate) pose: Pose,
    pub(crate) window: Window,
    pub(crate) rate: Rate,
}

impl PictureArgs {
    /// Resolves each port, its window and its rate. Several sensors need unique names.
    pub(crate) async fn sources(&self) -> Result<Vec<PictureSource>, Failure> {
        if self.ports.is_empty() {
            return Err(missing_port().await);
        }
        let names = || self.ports.iter().filter_map(|port| port.named.name.as_deref());
        let mut unique = BTreeSet::new();
        if let Some(twice) = names().find(|name| !unique.insert(*name)) {
            let text = format!("two sensors are named {twice}: give each a name of its own");
            return Err(Failure::Usage(text));
        }
        if self.ports.len() > 1 && unique.len() < self.ports.len() {
            let text = "several sensors need a name each, such as \
                        `front=/dev/ttyACM0@0.2,0,0 rear=/dev/ttyACM1@-0.2,0,180`";
            return Err(Failure::Usage(text.to_owned()));
        }
        let mut sources = Vec::new();
        for PlacedPort { named: NamedPort { name, port }, pose } in self.ports.iter().cloned() {
            let (port, rate) = PortArg { name: Some(port) }.polled_at(self.rate).await?;
            sources.push(PictureSource { name, port, pose, window: Window::DETECTION, rate });
        }
        let ports = sources.iter_mut().map(|source| &mut source.port);
        self.playback.apply(ports, self.rate.is_some())?;
        for source in &mut sources {
            source.window = self.window.window(source.port.default_window())?;
        }
        Ok(sources)
    }
}
