//! The driver's counters for Prometheus, with a label for each sensor:
//!
//! ```sh
//! cargo run --example metrics 127.0.0.1:9100 emulated serial:H0713090
//! curl http://127.0.0.1:9100/metrics
//! ```

mod port;

use std::sync::Arc;

use axum::Router;
use axum::extract::State;
use axum::routing::get;
use tokio::net::TcpListener;
use tokio_scip::{Rate, Sensor, Window};

type Sensors = Arc<[(String, Sensor)]>;

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let address = arguments.next().ok_or("expected HOST:PORT and ports of sensors")?;
    let (mut sensors, mut streams) = (Vec::new(), Vec::new());
    for port in arguments {
        let sensor = port::open(Sensor::builder().wait_for_sensor(true), &port).await?;
        // The driver polls while there is a stream, even if nothing reads it, as here.
        streams.push(sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?);
        sensors.push((port, sensor));
    }
    let listener = TcpListener::bind(address).await?;
    println!("listening on http://{}/metrics", listener.local_addr()?);
    let service = Router::new().route("/metrics", get(metrics)).with_state(sensors.into());
    Ok(axum::serve(listener, service).await?)
}

async fn metrics(State(sensors): State<Sensors>) -> String {
    text(&sensors)
}

/// Returns the figures as Prometheus reads them.
pub(crate) fn text(sensors: &[(String, Sensor)]) -> String {
    let figures = sensors
        .iter()
        .flat_map(|(name, sensor)| sensor.stats().metrics().map(move |metric| (name, metric)));
    let mut figures: Vec<_> = figures.collect();
    // The figures of a name follow each other, for all sensors.
    figures.sort_by_key(|(_, metric)| metric.name);
    let mut text = String::new();
    let mut family = "";
    for (sensor, metric) in figures {
        let (name, suffix, value) = (metric.name, metric.suffix, metric.value);
        if family != name {
            family = name;
            text += &format!("# HELP {name} {}\n# TYPE {name} {}\n", metric.help, metric.kind);
        }
        let labels = metric.labels.iter().map(|(name, value)| format!(",{name}=\"{value}\""));
        let labels: String = labels.collect();
        // `{:?}` escapes what a label must not contain.
        text += &format!("{name}{suffix}{{sensor={sensor:?}{labels}}} {value}\n");
    }
    text
}
