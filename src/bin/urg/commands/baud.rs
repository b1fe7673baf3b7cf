//! `urg baud`: moves the sensor to another baud rate.

use tokio_scip::{BaudRate, Sensor};

use crate::args::LinkArgs;
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::output::notice::notice;
use crate::port::name::PortArg;
use crate::port::open::open_with;
use crate::stream::wire_speed::{self, FastestReply};

/// Set the baud rate of the sensor
///
/// The sensor keeps the baud rate after the program has ended. At its next power-up it
/// is at 19200 baud again. Programs of this crate detect it at any baud rate.
#[derive(Debug, clap::Args)]
#[command(allow_missing_positional = true, after_help = "Example:\n  urg baud /dev/ttyUSB0 115200")]
pub(crate) struct Baud {
    #[command(flatten)]
    port: PortArg,
    /// 19200, 57600, 115200, 250000, 500000 or 750000
    #[arg(value_name = "RATE")]
    baud_rate: BaudRate,
    /// Wait for the sensor to appear, however long that takes
    #[arg(long)]
    wait: bool,
}

impl Baud {
    pub(crate) async fn run(self) -> Result<(), Failure> {
        let port = self.port.required().await?;
        let link = LinkArgs { wait: self.wait, ..LinkArgs::default() };
        let fastest = FastestReply::default();
        let builder = Sensor::builder().on_reply(fastest.observer());
        let sensor = open_with(&port, &link, Delivery::Newest, builder).await?;
        let before = sensor.state().borrow().baud_rate();
        let ignored = before.filter(|before| fastest.outruns(*before));
        let moved = sensor.set_baud_rate(self.baud_rate).await;
        moved.map_err(|error| Failure::at(&port.to_string(), &error))?;
        let after = sensor.state().borrow().baud_rate();
        match (after, ignored) {
            (None, _) => {
                notice(format_args!("{port}: the sensor is on USB, which has no baud rate"));
            }
            (Some(_), Some(ignored)) => {
                notice(format_args!("{port}: {}", wire_speed::explanation(ignored)));
            }
            (Some(after), None) => {
                notice(format_args!("{port}: the baud rate is {after} baud"));
            }
        }
        Ok(())
    }
}
