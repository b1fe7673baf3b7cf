//! `urg reboot`: restarts the sensor.

use crate::args::LinkArgs;
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::output::notice::notice;
use crate::port::name::PortArg;
use crate::port::open::open;

/// Restart the sensor, as if you had power-cycled it
///
/// Use it if the sensor refuses to measure with status '0L'. It measures again after some seconds.
/// SCIP 1.1 has no such command: power-cycle the sensor.
#[derive(Debug, clap::Args)]
#[command(
    // It takes no scan.
    mut_arg("intensity", |option| option.hide(true)),
    after_help = "Example:\n  urg reboot tcp://192.168.0.10"
)]
pub(crate) struct Reboot {
    #[command(flatten)]
    port: PortArg,
    #[command(flatten)]
    link: LinkArgs,
}

impl Reboot {
    pub(crate) async fn run(self) -> Result<(), Failure> {
        let port = self.port.required().await?;
        port.require_sensor()?;
        let sensor = open(&port, &self.link, Delivery::Newest).await?;
        sensor.reboot().await.map_err(|error| Failure::at(&port, &error))?;
        notice(format_args!("{port}: the sensor restarts"));
        Ok(())
    }
}
