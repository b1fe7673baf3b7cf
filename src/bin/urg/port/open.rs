//! Opens the sensor on a PORT, with a notice if that takes long.

use std::time::Duration;

use tokio_scip::emulator::Emulator;
use tokio_scip::{BaudRate, Connect, Error, Sensor, SensorBuilder, State};

use super::name::PortName;
use super::sampled::SampledConnect;
use crate::args::LinkArgs;
use crate::delivery::Delivery;
use crate::failure::{Failure, chain};
use crate::output::notice::notice;

/// Opening may take so long before a notice names what it waits for.
const SILENT_WAIT: Duration = Duration::from_secs(1);

/// Opens the sensor.
pub(crate) async fn open(
    port: &PortName,
    link: &LinkArgs,
    delivery: Delivery,
) -> Result<Sensor, Failure> {
    open_with(port, link, delivery, Sensor::builder()).await
}

/// Opens the sensor with the settings of `builder`.
pub(crate) async fn open_with(
    port: &PortName,
    link: &LinkArgs,
    delivery: Delivery,
    builder: SensorBuilder,
) -> Result<Sensor, Failure> {
    let sensor = begin(port, link, delivery, builder)?;
    opened(port, link, &sensor).await?;
    Ok(sensor)
}

/// Begins to open the sensor, and spawns its driver.
pub(crate) fn begin(
    port: &PortName,
    link: &LinkArgs,
    delivery: Delivery,
    builder: SensorBuilder,
) -> Result<Sensor, Failure> {
    let mut builder = builder.ring_depth(delivery.ring_depth());
    if let Some(rate) = link.baud {
        builder = builder.baud_rate(rate);
    }
    if link.wait {
        builder = builder.wait_for_sensor();
    }
    if let Some(timeout) = link.timeout {
        builder = builder.open_timeout(timeout);
    }
    if link.firmware.is_some() && !matches!(port, PortName::Emulated) {
        let text = format!("--firmware is for PORT `emulated`: {port} is a sensor of its own");
        return Err(Failure::Usage(text));
    }
    Ok(match port {
        PortName::Endpoint(endpoint, sample) => {
            let connect = endpoint.clone().into_connector();
            spawn(builder, SampledConnect { connect, sample: sample.clone() })
        }
        PortName::Emulated => {
            let emulator = Emulator::builder();
            let emulator = match link.firmware {
                Some(firmware) => emulator.firmware(firmware.into()),
                None => emulator,
            };
            // A request for a baud rate needs a sensor that has one.
            let emulator = match link.baud {
                Some(_) => emulator.baud_rate(BaudRate::B19200),
                None => emulator.usb(),
            };
            spawn(builder, emulator.build())
        }
        PortName::Recording(recorded) => recorded.start(builder, delivery)?,
    })
}

fn spawn(builder: SensorBuilder, connect: impl Connect) -> Sensor {
    let (sensor, driver) = builder.build(connect);
    tokio::spawn(driver);
    sensor
}

/// Waits until the sensor is open. After a second a notice names what it
/// waits for.
pub(crate) async fn opened(
    port: &PortName,
    link: &LinkArgs,
    sensor: &Sensor,
) -> Result<(), Failure> {
    let opened = tokio::select! {
        opened = sensor.opened() => opened,
        () = tokio::time::sleep(SILENT_WAIT) => {
            if link.wait {
                let why = match &*sensor.state().borrow() {
                    State::Connecting { error: Some(error) } => format!(": {}", chain(error)),
                    _ => String::new(),
                };
                notice(format_args!("waiting for a sensor on {port}, Ctrl-C ends it{why}"));
            }
            sensor.opened().await
        }
    };
    opened.map_err(|error| {
        let failure = Failure::at(&port.to_string(), &error);
        match (failure, port, &error) {
            (
                Failure::Failed(line),
                PortName::Endpoint(_, sample),
                Error::NoAnswer { .. } | Error::Malformed { .. } | Error::Disconnected { .. },
            ) => Failure::Failed(match sample.text() {
                Some(sample) => format!("{line}; the first bytes: {sample}"),
                None => line,
            }),
            (failure, ..) => failure,
        }
    })
}
