//! One UDP packet for each scan with the place of the nearest object, as OSC, for
//! TouchDesigner, Max or SuperCollider:
//!
//! ```sh
//! cargo run --example osc emulated 127.0.0.1:57120
//! ```

mod port;

use rosc::{OscMessage, OscPacket};
use tokio::net::UdpSocket;
use tokio_scip::{Rate, Sensor, Window};

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let target = std::env::args().nth(2).unwrap_or("127.0.0.1:57120".to_owned());
    let sensor = port::open(Sensor::builder(), &port::argument()).await?;
    let socket = UdpSocket::bind("0.0.0.0:0").await?;
    println!("sends the nearest point of each scan to {target}");
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
    while let Some(item) = scans.next().await {
        // The driver logs errors, and the stream continues.
        if let Some(point) = item.ok().and_then(|scan| scan.nearest()) {
            let args = vec![point.x.into(), point.y.into()];
            let message = OscMessage { addr: "/urg/nearest".to_owned(), args };
            let packet = rosc::encoder::encode(&OscPacket::Message(message));
            // No one may listen yet.
            let _ = socket.send_to(&packet.map_err(|error| format!("{error:?}"))?, &target).await;
        }
    }
    Ok(())
}
