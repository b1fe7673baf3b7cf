//! Publishes scans over NATS as `sensor_msgs/LaserScan` in CDR, with the time of the first ray.
//!
//! Keeps at most one scan: while the server is away it waits, then continues with the newest.
//! Needs async-nats 0.51, tokio, tokio-scip and urg-recording.

use tokio_scip::{ErrorChain, Rate, Sensor, Window};
use urg_recording::ros;

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let port = std::env::args().nth(1).ok_or("expected a port, such as /dev/ttyACM0")?;
    let sensor = Sensor::builder().wait_for_sensor(true).open(port.as_str()).await?;
    let options = async_nats::ConnectOptions::new().retry_on_initial_connect().client_capacity(1);
    let bus = options.connect("localhost").await?;
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
    while let Some(scan) = scans.next().await {
        match scan {
            Ok(scan) => {
                let mut message = Vec::new();
                ros::write_scan(&mut message, &scan, scan.first_ray_stamp(), "laser");
                bus.publish("urg.front.scan", message.into()).await?;
            }
            Err(error) => eprintln!("{}", ErrorChain(&error)), // and the stream continues
        }
    }
    Ok(())
}
