//! The sensor that an argument names: a port, or `emulated` for one in software. A service
//! of yours needs only `builder.open(port)`.

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
pub(crate) async fn open(builder: SensorBuilder, port: &str) -> Result<Sensor, Error> {
    if port == "emulated" {
        return builder.connect(emulator()).await;
    }
    builder.open(port).await
}

/// Each emulated sensor stands in a room of its own.
fn emulator() -> Emulator {
    use std::sync::atomic::{AtomicU64, Ordering};
    static ROOMS: AtomicU64 = AtomicU64::new(0);

    let number = ROOMS.fetch_add(1, Ordering::Relaxed);
    Emulator::builder().serial_number(format!("H{number:07}")).world(Room::new(number)).build()
}
