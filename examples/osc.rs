//! One UDP packet for each scan with the place of the nearest object, as OSC, for
//! TouchDesigner, Max or SuperCollider:
//!
//! ```sh
//! cargo run --example osc emulated 127.0.0.1:57120
//! ```
//!
//! OSC is simple enough to write by hand: strings padded to four bytes, numbers in
//! big-endian order.

mod port;

use tokio::net::UdpSocket;
use tokio_scip::{Rate, Sensor, Window};

/// Returns the packet `/urg/nearest` with two numbers.
pub(crate) fn packet(x: f32, y: f32) -> Vec<u8> {
    let mut packet = b"/urg/nearest\0\0\0\0,ff\0".to_vec();
    packet.extend(x.to_be_bytes());
    packet.extend(y.to_be_bytes());
    packet
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let target = std::env::args().nth(2).unwrap_or("127.0.0.1:57120".to_owned());
    let sensor = port::open(Sensor::builder(), &port::argument()).await?;
    let socket = UdpSocket::bind("127.0.0.1:0").await?;
    println!("sends the nearest point of each scan to {target}");
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
    while let Some(item) = scans.next().await {
        // The driver logs errors, and the stream continues.
        if let Some(point) = item.ok().and_then(|scan| scan.nearest()) {
            // No one may listen yet.
            let _ = socket.send_to(&packet(point.x, point.y), &target).await;
        }
    }
    Ok(())
}
