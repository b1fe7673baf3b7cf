//! The sensor that an argument names: a port, or `emulated` for one in software. A service
//! of yours needs only `builder.open(port)` or `builder.open_in_background(port)`.

use tokio_scip::{Error, Sensor, SensorBuilder};
use urg_emulator::{Emulator, Room};

/// Returns an argument of the program, without the program's name.
#[allow(dead_code, reason = "not each example takes just one port")]
pub(crate) fn argument() -> String {
    std::env::args().nth(1).unwrap_or_else(|| {
        eprintln!("expected a port, such as /dev/ttyACM0 or tcp://10.0.0.7:2000, or: emulated");
        std::process::exit(2)
    })
}

/// Opens the sensor at `port`.
#[allow(dead_code, reason = "some examples open it in the background")]
pub(crate) async fn open(builder: SensorBuilder, port: &str) -> Result<Sensor, Error> {
    if port == "emulated" {
        return builder.connect(emulator()).await;
    }
    builder.open(port).await
}

/// Returns a sensor at once, even if it is not there yet.
#[allow(dead_code, reason = "some examples need the sensor at once")]
pub(crate) fn open_in_background(builder: SensorBuilder, port: &str) -> Result<Sensor, Error> {
    if port == "emulated" {
        let (sensor, driver) = builder.build(emulator());
        tokio::spawn(driver);
        return Ok(sensor);
    }
    builder.open_in_background(port)
}

/// Each emulated sensor stands in a room of its own.
fn emulator() -> Emulator {
    use std::sync::atomic::{AtomicU64, Ordering};
    static ROOMS: AtomicU64 = AtomicU64::new(0);

    let number = ROOMS.fetch_add(1, Ordering::Relaxed);
    Emulator::builder().serial_number(format!("H{number:07}")).world(Room::new(number)).build()
}
