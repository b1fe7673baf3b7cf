//! `urg laser`: switches the laser.

use crate::failure::Failure;
use crate::output::notice::notice;
use crate::port::open::SensorArgs;

/// Switch the laser on or off
///
/// The laser keeps this state after the program exits, until you power-cycle the sensor or a program
/// asks for scans. In SCIP 2 each program that opens the sensor first switches the laser off.
#[derive(Debug, clap::Args)]
#[command(allow_missing_positional = true, after_help = "Example:\n  urg laser /dev/ttyACM0 off")]
pub(crate) struct Laser {
    #[command(flatten)]
    sensor: SensorArgs,
    /// New state of the laser
    #[arg(value_name = "on|off", value_parser = is_on, action = clap::ArgAction::Set,
        help_heading = None)]
    is_on: bool,
}

fn is_on(text: &str) -> Result<bool, &'static str> {
    match text {
        "on" => Ok(true),
        "off" => Ok(false),
        _ => Err("expected on or off, after PORT and before options: `urg laser PORT off`"),
    }
}

impl Laser {
    pub(crate) async fn run(self) -> Result<(), Failure> {
        let (port, sensor) = self.sensor.open().await?;
        let (switched, state) = match self.is_on {
            true => (sensor.laser_on().await, "on"),
            false => (sensor.laser_off().await, "off"),
        };
        switched.map_err(|error| Failure::at(&port, &error))?;
        notice(format_args!("{port}: the laser is {state}"));
        Ok(())
    }
}
