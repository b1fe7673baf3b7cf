//! `urg baud`: sets the baud rate of the sensor.

use tokio_scip::BaudRate;

use crate::failure::Failure;
use crate::output::notice::notice;
use crate::port::open::{SensorArgs, proven_baud_rate};

/// Set the baud rate of the sensor
///
/// The sensor keeps this baud rate until you power-cycle it. After that it is at its
/// default again, usually 19200. `urg` and programs that use tokio-scip detect it at any baud rate.
#[derive(Debug, clap::Args)]
#[command(
    allow_missing_positional = true, mut_arg("baud", |option| option.hide(true)), // RATE instead
    after_help = "Example:\n  urg baud /dev/ttyUSB0 115200"
)]
pub(crate) struct Baud {
    #[command(flatten)]
    sensor: SensorArgs,
    /// 19200, 57600, 115200, 250000, 500000 or 750000
    #[arg(value_name = "RATE", help_heading = None, value_parser = |text: &str| text
        .parse::<BaudRate>().map_err(|error| format!("{error}, after PORT and before options")))]
    baud_rate: BaudRate,
}

impl Baud {
    pub(crate) async fn run(self) -> Result<(), Failure> {
        let (port, sensor) = self.sensor.open().await?;
        sensor.set_baud_rate(self.baud_rate).await.map_err(|error| Failure::at(&port, &error))?;
        match proven_baud_rate(&sensor).await {
            None => notice(format_args!(
                "{port}: the sensor is on {}, which has no baud rate",
                port.line()
            )),
            Some((_, Some(why))) => notice(format_args!("{port}: {why}")),
            Some((after, None)) => notice(format_args!("{port}: the baud rate is {after} baud")),
        }
        Ok(())
    }
}
