//! `urg laser`: switches the laser.

use std::str::FromStr;

use crate::args::LinkArgs;
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::output::notice::notice;
use crate::port::name::PortArg;
use crate::port::open::open;

/// Switch the laser on or off
///
/// The laser keeps this state after the program exits, until you power-cycle the
/// sensor or a program asks for scans.
#[derive(Debug, clap::Args)]
#[command(allow_missing_positional = true, after_help = "Example:\n  urg laser /dev/ttyACM0 off")]
pub(crate) struct Laser {
    #[command(flatten)]
    port: PortArg,
    /// New state of the laser
    #[arg(value_name = "on|off")]
    switch: Switch,
    #[command(flatten)]
    link: LinkArgs,
}

#[derive(Debug, Clone, Copy)]
enum Switch {
    On,
    Off,
}

impl FromStr for Switch {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "on" => Ok(Self::On),
            "off" => Ok(Self::Off),
            _ => Err("expected on or off, after PORT: `urg laser PORT off`".to_owned()),
        }
    }
}

impl Laser {
    pub(crate) async fn run(self) -> Result<(), Failure> {
        let port = self.port.required().await?;
        port.require_sensor()?;
        let sensor = open(&port, &self.link, Delivery::Newest).await?;
        let (switched, state) = match self.switch {
            Switch::On => (sensor.laser_on().await, "on"),
            Switch::Off => (sensor.laser_off().await, "off"),
        };
        switched.map_err(|error| Failure::at(&port, &error))?;
        notice(format_args!("{port}: the laser is {state}"));
        Ok(())
    }
}
