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
use tokio_scip::{Rate, Sensor, Stats, Window};

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

/// Names, descriptions and values of counters. [`Stats`] has more.
type Counter = (&'static str, &'static str, fn(&Stats) -> u64);
const COUNTERS: [Counter; 6] = [
    ("urg_polls_total", "Polls sent to the sensor", |stats| stats.polls),
    ("urg_scans_total", "Scans received from the sensor", |stats| stats.scans),
    ("urg_timeouts_total", "Commands not answered in time", |stats| stats.timeouts),
    ("urg_malformed_total", "Malformed replies", |stats| stats.malformed.total()),
    ("urg_refused_total", "Commands that the sensor refused", |stats| stats.refused),
    ("urg_disconnects_total", "Losses of the link", |stats| stats.disconnects),
];

/// Returns the counters as Prometheus reads them.
fn text(sensors: &[(String, Sensor)]) -> String {
    let mut text = String::new();
    // One copy of each sensor's counters, so that they agree.
    let stats: Vec<Stats> = sensors.iter().map(|(_, handle)| handle.stats()).collect();
    for (name, help, value) in COUNTERS {
        text += &format!("# HELP {name} {help}\n# TYPE {name} counter\n");
        for ((sensor, _), stats) in sensors.iter().zip(&stats) {
            // `{:?}` escapes what a label must not contain.
            text += &format!("{name}{{sensor={sensor:?}}} {}\n", value(stats));
        }
    }
    text
}
