//! A vehicle that stops for an obstacle, and whenever it cannot see:
//!
//! ```sh
//! cargo run --example safety_stop emulated
//! ```
//!
//! The output becomes false, "stop", at the latest
//!
//! - [`LIMIT`] after the last good scan was received, whatever happened to the sensor, its
//!   link or its replies
//! - [`REACTION`] after an obstacle appeared that is nearer than [`CLEARANCE`] and at least
//!   [`WIDTH`] wide
//!
//! **This is no safety device.** Neither the sensor, nor this library, nor the operating
//! system is certified, and a flipped bit on the line can change a distance. An object that
//! returns no light looks like free space if it may be out of range. Use it in addition to
//! a bumper that stops the vehicle for certain.

mod port;

use std::time::Duration;

use tokio::sync::watch;
use tokio::time::{Instant, sleep_until};
use tokio_scip::scan::{CountsAs, Sector, Zone};
use tokio_scip::{Rate, ScanStream, Sensor, SensorBuilder};

/// How long the vehicle may drive on the newest good scan: one lost reply does not stop it.
pub(crate) const LIMIT: Duration = Duration::from_millis(500);
/// [`LIMIT`] plus the age of a scan when it is received: a revolution, and 50 ms for the
/// reply.
pub(crate) const REACTION: Duration = Duration::from_millis(650);
/// In metres, more than the stopping distance: at 0.5 m/s that is 0.33 m within
/// [`REACTION`], plus the braking distance.
pub(crate) const CLEARANCE: f64 = 0.6;
/// The width of the smallest obstacle, in metres.
pub(crate) const WIDTH: f64 = 0.1;
/// How far the path reaches to each side, in degrees.
const SIDE: f64 = 30.0;

/// With the default of 500 ms for a reply, each lost reply would stop the vehicle. The
/// sensor answers at the end of a revolution, so after at most 100 ms.
pub(crate) fn settings() -> SensorBuilder {
    Sensor::builder().reply_latency(Duration::from_millis(130))
}

/// Returns a stream of the path ahead.
pub(crate) async fn ahead(sensor: &Sensor) -> Result<ScanStream, Box<dyn std::error::Error>> {
    Ok(sensor.scans(path()?.window(), Rate::hz(10.0)).await?)
}

/// Returns the path that must be clear. In a real room half of the rays have no distance.
/// They stop the vehicle only if an obstacle could hide behind them. Error codes that mean
/// "beyond the range" count as free.
pub(crate) fn path() -> Result<Zone, Box<dyn std::error::Error>> {
    let path = Zone::sector(Sector::degrees(-SIDE, SIDE)?, 0.0..=CLEARANCE)?;
    Ok(path.smallest_obstacle(WIDTH)?.beyond_range(CountsAs::Free))
}

/// Permission to drive. Dropping it, for any reason, stops the vehicle.
struct Permission(watch::Sender<bool>);

impl Permission {
    fn set(&self, may_drive: bool) {
        self.0.send_if_modified(|now| std::mem::replace(now, may_drive) != may_drive);
    }
}

impl Drop for Permission {
    fn drop(&mut self) {
        self.set(false);
    }
}

/// Sets `may_drive` while the path is clear, until the stream ends. An error does not stop the
/// vehicle: it may drive until the last good scan is too old.
pub(crate) async fn guard(mut scans: ScanStream, path: Zone, may_drive: watch::Sender<bool>) {
    let permission = Permission(may_drive);
    let mut until = Instant::now();
    loop {
        tokio::select! {
            // The limit first: it holds even if scans arrive faster than they are checked.
            biased;
            () = sleep_until(until), if *permission.0.borrow() => permission.set(false),
            scan = scans.next() => match scan {
                Some(Ok(scan)) => {
                    until = scan.received_at() + LIMIT;
                    permission.set(path.check(&scan).is_clear() && Instant::now() < until);
                }
                Some(Err(error)) => eprintln!("no scan: {}", error.chain()),
                None => break,
            },
        }
    }
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let sensor = port::open(settings(), &port::argument()).await?;
    let (output, mut may_drive) = watch::channel(false);
    tokio::spawn(guard(ahead(&sensor).await?, path()?, output));
    println!("stops within {REACTION:?} of an obstacle, {LIMIT:?} after the last good scan");
    println!("stop");
    while may_drive.changed().await.is_ok() {
        println!("{}", if *may_drive.borrow_and_update() { "drive" } else { "stop" });
    }
    Ok(())
}
