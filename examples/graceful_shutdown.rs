//! Stops on Ctrl-C and SIGTERM: finishes the scan under way, switches the laser off, and
//! frees the port:
//!
//! ```sh
//! cargo run --example graceful_shutdown emulated
//! ```

mod port;

use tokio_scip::{Error, ErrorChain, Rate, Sensor, Window};

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let sensor = port::open(Sensor::builder(), &port::argument()).await?;
    run(sensor, stop_signal()?).await?;
    println!("the laser is off, and the port is free");
    Ok(())
}

/// Prints scans until `stop` is ready or the stream ends.
pub(crate) async fn run(sensor: Sensor, stop: impl Future<Output = ()>) -> Result<(), Error> {
    let mut stop = std::pin::pin!(stop);
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
    loop {
        tokio::select! {
            () = &mut stop => break,
            // Cancel-safe: no scan is lost if the other branch wins.
            scan = scans.next() => match scan {
                Some(Ok(scan)) => println!("scan {}", scan.sequence()),
                Some(Err(error)) => eprintln!("no scan: {}", ErrorChain(&error)),
                None => break,
            },
        }
    }
    let laser = sensor.laser_off().await;
    sensor.close().await; // the port is free when this returns
    laser
}

/// Returns a future that is ready on Ctrl-C, and on Unix on SIGTERM, which systemd sends.
#[cfg(unix)]
fn stop_signal() -> std::io::Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};

    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
    })
}

#[cfg(not(unix))]
fn stop_signal() -> std::io::Result<impl Future<Output = ()>> {
    Ok(async { drop(tokio::signal::ctrl_c().await) })
}
