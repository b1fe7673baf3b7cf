//! `urg baud`: moves the sensor to another baud rate.

use tokio_scip::BaudRate;

use crate::args::LinkArgs;
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::output::notice::notice;
use crate::port::name::PortArg;
use crate::port::open::open;

/// Move the sensor to another baud rate
///
/// It stays there when the program has ended, until it is powered up anew: then
/// it is at 19200 baud. Programs of this crate find it at any speed.
#[derive(Debug, clap::Args)]
#[command(allow_missing_positional = true, after_help = "Example:\n  urg baud /dev/ttyUSB0 115200")]
pub(crate) struct Baud {
    #[command(flatten)]
    port: PortArg,
    /// 19200, 57600, 115200, 250000, 500000 or 750000
    speed: BaudRate,
    /// Wait for the sensor to appear, however long that takes
    #[arg(long)]
    wait: bool,
}

impl Baud {
    pub(crate) async fn run(self) -> Result<(), Failure> {
        let port = self.port.required().await?;
        let link = LinkArgs { baud: None, wait: self.wait };
        let sensor = open(&port, &link, Delivery::Newest).await?;
        let moved = sensor.set_baud_rate(self.speed).await;
        moved.map_err(|error| Failure::at(&port.to_string(), &error))?;
        let baud_rate = sensor.state().borrow().baud_rate();
        match baud_rate {
            Some(baud_rate) => notice(format_args!("{port}: the baud rate is {baud_rate} baud")),
            None => notice(format_args!("{port}: the sensor is on USB, which has no baud rate")),
        }
        Ok(())
    }
}
