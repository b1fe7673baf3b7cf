//! Publishes scans over MQTT as JSON, in `Scan`'s serde form.
//!
//! Keeps at most one scan: while the server is away it waits, then continues with the newest.
//! Needs rumqttc 0.25, serde_json, tokio, and tokio-scip with the feature `serde`.

use rumqttc::{AsyncClient, MqttOptions, QoS};
use std::time::Duration;
use tokio_scip::{ErrorChain, Rate, Sensor, Window};

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let port = std::env::args().nth(1).ok_or("expected a port, such as /dev/ttyACM0")?;
    let sensor = Sensor::builder().wait_for_sensor(true).open(port.as_str()).await?;
    let mut options = MqttOptions::new("urg-front", "localhost", 1883);
    // Its default for what is sent, 10 KiB, is less than a scan of a UST.
    options.set_max_packet_size(10 * 1024, 1024 * 1024);
    // There is no queue: only the scan in `publish` waits.
    let (bus, mut connection) = AsyncClient::new(options, 0);
    tokio::spawn(async move {
        loop {
            // The next call connects again.
            if let Err(error) = connection.poll().await {
                eprintln!("{error}");
                tokio::time::sleep(Duration::from_secs(1)).await;
            }
        }
    });
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
    while let Some(scan) = scans.next().await {
        match scan {
            Ok(scan) => {
                let message = serde_json::to_vec(&scan)?;
                bus.publish("urg/front/scan", QoS::AtMostOnce, false, message).await?;
            }
            Err(error) => eprintln!("{}", ErrorChain(&error)), // and the stream continues
        }
    }
    Ok(())
}
