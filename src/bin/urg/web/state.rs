//! `/state` and `/health`: the state of sensor and stream, for the page and for a
//! supervisor.

use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures::FutureExt;
use serde::Serialize;
use serde_json::json;
use tokio_scip::{Stats, Version, Window};

use super::app::App;
use crate::format::json;

/// The state of sensor and stream.
#[derive(Debug, Serialize)]
struct StateReport {
    /// The program's version.
    urg: &'static str,
    port: String,
    /// One of connected, recovering, disconnected, waiting, closed.
    link: &'static str,
    /// The reason why no scans flow; null while they do.
    why: Option<String>,
    baud_rate: Option<tokio_scip::BaudRate>,
    window: Window,
    /// The rate asked for, in scans a second; null for as many as possible.
    asked: Option<f64>,
    /// The rate over the last three seconds or so, in scans a second.
    reached: f64,
    /// The age of the latest scan in seconds.
    age: Option<f64>,
    latency: Option<LatencySeconds>,
    viewers: usize,
    sensor: Option<Version>,
    stats: Stats,
}

/// The time that replies took, in seconds.
#[derive(Debug, Serialize)]
struct LatencySeconds {
    last: f64,
    mean: f64,
    max: f64,
}

/// Answers `/state`.
pub(super) async fn state(State(app): State<App>) -> Response {
    let hub = &app.hub;
    let health = hub.health();
    let live = hub.live();
    let sensor = live.as_ref().map(|live| &live.sensor);
    let stats = sensor.map(|sensor| sensor.stats()).unwrap_or_default();
    let baud_rate = sensor.and_then(|sensor| sensor.state().borrow().baud_rate());
    let latency = Some(stats.reply_latency).filter(|latency| latency.count > 0);
    respond(
        StatusCode::OK,
        &StateReport {
            urg: env!("CARGO_PKG_VERSION"),
            port: hub.port().to_string(),
            link: health.link,
            why: health.why,
            baud_rate,
            window: hub.window(),
            asked: hub.rate().period().map(|period| 1.0 / period.as_secs_f64()),
            reached: stats.schedules.first().map_or(0.0, |schedule| schedule.reached),
            age: sensor.and_then(|sensor| sensor.freshness().age()).map(|age| age.as_secs_f64()),
            latency: latency.map(|latency| LatencySeconds {
                last: latency.last.as_secs_f64(),
                mean: latency.mean().as_secs_f64(),
                max: latency.max.as_secs_f64(),
            }),
            viewers: app.viewers.len(),
            // Cached, or not available now.
            sensor: sensor.and_then(|sensor| sensor.version().now_or_never()).and_then(Result::ok),
            stats,
        },
    )
}

/// Answers `/health`.
pub(super) async fn health(State(app): State<App>) -> Response {
    let health = app.hub.health();
    match health.why {
        None => respond(StatusCode::OK, &json!({ "status": "ok" })),
        Some(why) => {
            let body = json!({ "status": "failing", "link": health.link, "why": why });
            respond(StatusCode::SERVICE_UNAVAILABLE, &body)
        }
    }
}

fn respond(status: StatusCode, data: &impl Serialize) -> Response {
    match json::line(data) {
        Ok(line) => (status, [(header::CONTENT_TYPE, "application/json")], line).into_response(),
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}
