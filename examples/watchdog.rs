//! A service that systemd restarts when no fresh scan arrives, whatever the cause:
//!
//! ```sh
//! systemd-run --user --pty --property=Type=notify --property=WatchdogSec=10s \
//!     cargo run --example watchdog emulated
//! ```
//!
//! `systemctl status` shows why there is no scan. A driver that has lost its sensor reconnects
//! without a restart: choose a `WatchdogSec` that leaves it the time for that.

#[cfg(unix)]
mod port;

#[cfg(unix)]
#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    use std::time::Duration;

    use sd_notify::NotifyState::{Ready, Status, Watchdog};
    use tokio_scip::{ErrorChain, Rate, Sensor, Window};

    let sensor = port::open(Sensor::builder().wait_for_sensor(true), &port::argument()).await?;
    let scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
    println!("tells systemd every second whether scans are fresh");
    // The service does its work in other tasks, with clones of the stream.
    sd_notify::notify(&[Ready])?;
    let mut ticks = tokio::time::interval(Duration::from_secs(1));
    loop {
        ticks.tick().await;
        match scans.freshness().check(Duration::from_millis(500)) {
            Ok(()) => sd_notify::notify(&[Watchdog, Status("scans are fresh")])?,
            Err(stale) => sd_notify::notify(&[Status(&ErrorChain(&stale).to_string())])?,
        }
    }
}

#[cfg(not(unix))]
fn main() {
    eprintln!("systemd runs on Linux only");
}
