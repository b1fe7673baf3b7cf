//! Opens the sensor on a PORT, with a notice if that takes longer than a second.

use std::time::Duration;

use futures_util::future::join_all;
use parking_lot::Mutex;
use tokio::time::timeout;
use tokio_scip::port::Connect;
use tokio_scip::protocol::Protocol;
use tokio_scip::{BaudRate, Endpoint, Error, ErrorKind, Sensor, SensorBuilder, State, Window};
use urg_emulator::{Emulator, Firmware, Room};

use super::name::{PortArg, PortName, argument};
use crate::args::{LinkArgs, ProtocolName};
use crate::delivery::Delivery;
use crate::failure::{Failure, chain};
use crate::interrupt::COMMAND_GRACE;
use crate::output::notice::notice;

/// Sensors to close at the end.
static OPENED: Mutex<Vec<Sensor>> = Mutex::new(Vec::new());

/// Wait before a notice names what the program is waiting for.
const SILENT_WAIT: Duration = Duration::from_secs(1);

/// Arguments of a command that changes a sensor and takes no scan.
#[derive(Debug, clap::Args)]
#[command(mut_arg("intensity", |option| option.hide(true)))]
pub(crate) struct SensorArgs {
    /// Where the sensor is: a serial port, serial:NUMBER, tcp://HOST or emulated (see `urg help`)
    #[arg(value_name = "PORT", value_parser = argument::<PortName>())]
    name: Option<PortName>,
    #[command(flatten)]
    link: LinkArgs,
}

impl SensorArgs {
    /// Opens the sensor. A recording answers, but has nothing to change: usage error.
    pub(crate) async fn open(self) -> Result<(PortName, Sensor), Failure> {
        let port = PortArg { name: self.name }.required().await?;
        if port.recorded().is_some() {
            return Err(Failure::Usage(format!("{port} is a recording, and no sensor")));
        }
        let sensor = open(&port, &self.link, Delivery::Newest).await?;
        Ok((port, sensor))
    }
}

pub(crate) async fn open(
    port: &PortName,
    link: &LinkArgs,
    delivery: Delivery,
) -> Result<Sensor, Failure> {
    let sensor = begin(port, link, delivery)?;
    opened(port, link, &sensor).await?;
    Ok(sensor)
}

/// Spawns the driver, which opens the sensor. Does not wait; see [`opened`].
pub(crate) fn begin(
    port: &PortName,
    link: &LinkArgs,
    delivery: Delivery,
) -> Result<Sensor, Failure> {
    let mut builder = Sensor::builder()
        .depth(delivery.ring_depth())
        .intensities(link.intensity)
        .wait_for_sensor(link.wait);
    if let Some(rate) = link.baud {
        builder = builder.baud_rate(rate);
    }
    let protocol = link.protocol.wanted();
    if let Some(protocol) = protocol {
        builder = builder.protocol(protocol);
    }
    if let Some(timeout) = link.timeout {
        builder = builder.open_timeout(timeout);
    }
    Ok(match port {
        PortName::Endpoint(endpoint) => spawn(builder, endpoint.clone().into_connector()),
        PortName::Emulated(pose) => {
            let emulator = Emulator::builder().world(Room::new(0).seen_from(*pose));
            let emulator = match protocol {
                // Not each firmware speaks it.
                Some(Protocol::Scip2) => emulator.firmware(Firmware::V31),
                _ => emulator,
            };
            // `--baud` needs an emulated RS-232 sensor: USB has no baud rate.
            let emulator = match link.baud {
                Some(_) => emulator.baud_rate(BaudRate::B19200),
                None => emulator.intact_usb(),
            };
            spawn(builder, emulator.build())
        }
        PortName::Recording(recorded) => recorded.start(builder, delivery)?,
    })
}

fn spawn(builder: SensorBuilder, connect: impl Connect) -> Sensor {
    let (sensor, driver) = builder.build(connect);
    tokio::spawn(driver);
    OPENED.lock().push(sensor.clone());
    sensor
}

/// Closes all sensors, if that takes no longer than [`COMMAND_GRACE`]: one of SCIP 2 would go on sending
/// scans, also to the next program.
pub(crate) async fn close_all() {
    let opened = std::mem::take(&mut *OPENED.lock());
    let _ = timeout(COMMAND_GRACE, join_all(opened.iter().map(Sensor::close))).await;
}

/// Baud rate of the line. `None` without one, or if fast replies have shown that the port ignores it.
pub(crate) fn line_baud_rate(sensor: &Sensor) -> Option<BaudRate> {
    sensor.watch_state().get().baud_rate().filter(|_| !sensor.stats().baud_rate_disproved)
}

/// Explains a port that ignores its baud rate, as pseudo-terminals and some adapters do. Such
/// a sensor is found at the first baud rate tried.
pub(crate) fn ignored_baud_rate(baud_rate: BaudRate) -> String {
    format!(
        "replies come faster than {baud_rate} baud can carry: this port ignores the baud rate, \
         as pseudo-terminals, USB and Ethernet do"
    )
}

/// Checks the baud rate with a long reply: one that arrives too fast shows that the port
/// ignores the baud rate, and adds an explanation. If the sensor sends no long reply, the
/// baud rate counts as correct.
pub(crate) async fn proven_baud_rate(sensor: &Sensor) -> Option<(BaudRate, Option<String>)> {
    let baud_rate = sensor.watch_state().get().baud_rate()?;
    if !sensor.stats().baud_rate_disproved {
        let _ = sensor.scan(Window::DETECTION).await;
    }
    Some((baud_rate, sensor.stats().baud_rate_disproved.then(|| ignored_baud_rate(baud_rate))))
}

/// Waits until the sensor is open. After a second, a notice names what it is waiting for.
pub(crate) async fn opened(
    port: &PortName,
    link: &LinkArgs,
    sensor: &Sensor,
) -> Result<(), Failure> {
    let mut state = sensor.watch_state();
    let opened = tokio::select! {
        opened = state.connected() => opened,
        () = tokio::time::sleep(SILENT_WAIT) => {
            if link.wait {
                let why = match sensor.watch_state().get() {
                    State::Connecting { error: Some(error) } => format!(": {}", chain(&error)),
                    _ => String::new(),
                };
                notice(format_args!("waiting for a sensor on {port}, Ctrl-C ends it{why}"));
            }
            sensor.watch_state().connected().await
        }
    };
    opened.map_err(|error| not_opened(port, link, &error))?;
    let has_intensities = || match port {
        PortName::Recording(recorded) => recorded.may_have_intensities(),
        _ => sensor.parameters().is_some_and(|parameters| parameters.has_intensities()),
    };
    if link.intensity && !has_intensities() {
        notice(format_args!("{port} has no intensities"));
    }
    Ok(())
}

fn not_opened(port: &PortName, link: &LinkArgs, error: &Error) -> Failure {
    let failure = Failure::at(port, error);
    match (port, error.kind()) {
        (_, ErrorKind::Timeout { .. }) if link.protocol == ProtocolName::Scip2 => {
            failure.advise("a URG-04LX with old firmware has no SCIP 2: leave out --protocol")
        }
        (PortName::Endpoint(Endpoint::Tcp { .. }), ErrorKind::Disconnected { .. }) => {
            failure.advise("a sensor on Ethernet may still boot, or serve another client")
        }
        _ => failure,
    }
}
