//! `urg baud`: sets the baud rate of the sensor.

use tokio_scip::BaudRate;

use crate::args::LinkArgs;
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::output::notice::notice;
use crate::port::name::PortArg;
use crate::port::open::{open, proven_baud_rate};

/// Set the baud rate of the sensor
///
/// The sensor keeps this baud rate until you power-cycle it. After that it is at its
/// default again, usually 19200. `urg` and programs that use tokio-scip detect it at any baud rate.
#[derive(Debug, clap::Args)]
#[command(
    allow_missing_positional = true, mut_arg("baud", |option| option.hide(true)), // RATE instead
    mut_arg("intensity", |option| option.hide(true)), // It takes no scan.
    after_help = "Example:\n  urg baud /dev/ttyUSB0 115200"
)]
pub(crate) struct Baud {
    #[command(flatten)]
    port: PortArg,
    /// 19200, 57600, 115200, 250000, 500000 or 750000
    #[arg(value_name = "RATE")]
    baud_rate: BaudRate,
    #[command(flatten)]
    link: LinkArgs,
}

impl Baud {
    pub(crate) async fn run(self) -> Result<(), Failure> {
        let port = self.port.required().await?;
        port.require_sensor()?;
        let sensor = open(&port, &self.link, Delivery::Newest).await?;
        let moved = sensor.set_baud_rate(self.baud_rate).await;
        moved.map_err(|error| Failure::at(&port, &error))?;
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
