//! The driver's counters for Prometheus:
//!
//! ```sh
//! cargo run --example metrics emulated 127.0.0.1:9100
//! curl http://127.0.0.1:9100/metrics
//! ```

mod port;

use axum::Router;
use axum::extract::State;
use axum::routing::get;
use tokio::net::TcpListener;
use tokio_scip::{Rate, Sensor, Window};

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let sensor = port::open_in_background(Sensor::builder(), &port::argument())?;
    // The driver polls while there is a stream, even if nothing reads it, as here.
    let _scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
    let address = std::env::args().nth(2).unwrap_or("127.0.0.1:9100".to_owned());
    let listener = TcpListener::bind(address).await?;
    println!("listening on http://{}/metrics", listener.local_addr()?);
    let service = Router::new().route("/metrics", get(metrics)).with_state(sensor.clone());
    Ok(axum::serve(listener, service).await?)
}

async fn metrics(State(sensor): State<Sensor>) -> String {
    text(&sensor)
}

/// Returns the figures as Prometheus reads them.
pub(crate) fn text(sensor: &Sensor) -> String {
    let mut text = String::new();
    let mut name = "";
    for metric in sensor.stats().metrics() {
        if name != metric.name {
            name = metric.name;
            let (kind, help) = (metric.kind, metric.help);
            text += &format!("# HELP {name} {help}\n# TYPE {name} {kind}\n");
        }
        let labels = metric.labels.iter().map(|(name, value)| format!("{name}=\"{value}\""));
        let (suffix, labels) = (metric.suffix, labels.collect::<Vec<_>>().join(","));
        text += &format!("{name}{suffix}{{{labels}}} {}\n", metric.value);
    }
    text
}
