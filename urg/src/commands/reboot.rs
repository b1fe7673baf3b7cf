//! `urg reboot`: restarts the sensor.

use crate::failure::Failure;
use crate::output::notice::notice;
use crate::port::open::SensorArgs;

/// Restart the sensor, as if you had power-cycled it
///
/// Use it if the sensor refuses to measure with status '0L'. It measures again after some seconds.
/// SCIP 1.1 has no such command: power-cycle the sensor.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  urg reboot tcp://192.168.0.10")]
pub(crate) struct Reboot {
    #[command(flatten)]
    sensor: SensorArgs,
}

impl Reboot {
    pub(crate) async fn run(self) -> Result<(), Failure> {
        let (port, sensor) = self.sensor.open().await?;
        sensor.reboot().await.map_err(|error| Failure::at(&port, &error))?;
        notice(format_args!("{port}: the sensor restarts"));
        Ok(())
    }
}
