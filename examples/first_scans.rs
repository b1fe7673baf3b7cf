//! The first program: prints each scan's number, its points, and the nearest of them.
//!
//! ```sh
//! cargo run --example first_scans emulated
//! ```

use tokio_scip::{Error, ErrorChain, Rate, Sensor, Window};
use urg_emulator::Emulator;

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Error> {
    let port = std::env::args().nth(1).unwrap_or("emulated".to_owned());
    let sensor = match port.as_str() {
        "emulated" => Sensor::builder().connect(Emulator::default()).await?,
        port => Sensor::open(port).await?,
    };
    println!("{}", sensor.version().await?.product);

    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
    while let Some(scan) = scans.next().await {
        match scan {
            Ok(scan) => {
                let nearest = scan.nearest().map_or(f32::NAN, |point| point.range);
                let (number, count) = (scan.sequence(), scan.points().count());
                println!("scan {number}: {count} points, the nearest at {nearest:.3} m");
            }
            Err(error) => eprintln!("no scan: {}", ErrorChain(&error)), // the stream continues
        }
    }
    Ok(())
}
