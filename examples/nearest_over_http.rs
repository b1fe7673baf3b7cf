//! The nearest obstacle over HTTP, with a health check:
//!
//! ```sh
//! cargo run --example nearest_over_http emulated 127.0.0.1:8081
//! curl http://127.0.0.1:8081/nearest
//! curl --fail http://127.0.0.1:8081/health
//! ```
//!
//! One stream serves all clients. Health is the age of the newest scan, not the state of the
//! link: a sensor may answer every poll with a malformed reply.

mod port;

use std::time::Duration;

use axum::Router;
use axum::extract::State;
use axum::http::StatusCode;
use axum::routing::get;
use tokio::net::TcpListener;
use tokio_scip::{ErrorChain, Point, Rate, ScanStream, Sensor, Window};

const LIMIT: Duration = Duration::from_secs(1);

type HttpRefusal = (StatusCode, String);

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Serves HTTP at once: until the sensor is there, /health has the reason.
    let sensor = port::open(Sensor::builder().wait_for_sensor(true), &port::argument()).await?;
    let scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
    let address = std::env::args().nth(2).unwrap_or("127.0.0.1:8081".to_owned());
    let listener = TcpListener::bind(address).await?;
    println!("listening on http://{}/nearest", listener.local_addr()?);
    Ok(axum::serve(listener, service(scans)).await?)
}

/// Asks the stream only for its newest scan, so no task has to read the stream.
pub(crate) fn service(scans: ScanStream) -> Router {
    Router::new().route("/nearest", get(nearest)).route("/health", get(health)).with_state(scans)
}

/// Answers null if no ray has a distance, which is no proof of free space.
async fn nearest(State(scans): State<ScanStream>) -> Result<String, HttpRefusal> {
    check(&scans)?;
    let nearest = scans.latest().and_then(|scan| scan.nearest());
    Ok(nearest.map_or("null\n".to_owned(), |Point { range, angle, .. }| {
        format!("{{\"range\":{range},\"angle\":{angle}}}\n") // metres, radians to the left
    }))
}

async fn health(State(scans): State<ScanStream>) -> Result<&'static str, HttpRefusal> {
    check(&scans)?;
    Ok("ok\n")
}

fn check(scans: &ScanStream) -> Result<(), HttpRefusal> {
    let fresh = scans.freshness().check(LIMIT);
    fresh.map_err(|stale| (StatusCode::SERVICE_UNAVAILABLE, format!("{}\n", ErrorChain(&stale))))
}
