//! `/state` and `/health`: the state of each sensor and its stream, for the page and
//! for a supervisor.

use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::FutureExt;
use serde::Serialize;
use tokio_scip::{Stats, Version, Window};

use super::app::App;
use super::hub::Hub;
use super::source::{Playback, Source, SourceKind};
use crate::format::json;
use crate::playback::PlaybackStatus;
use crate::plot::pose::Pose;
use crate::stream::jitter::Jitter;

/// The state of all that is shown.
#[derive(Debug, Serialize)]
struct StateReport<'a> {
    /// The program's version.
    urg: &'static str,
    viewers: usize,
    sensors: Vec<SensorReport<'a>>,
}

/// The state of a sensor and its stream, or of a recording.
#[derive(Debug, Serialize)]
struct SensorReport<'a> {
    name: Option<&'a str>,
    /// Its place in the common frame.
    pose: Pose,
    port: String,
    /// One of connected, recovering, disconnected, waiting, closed, recording.
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
    jitter: Option<Jitter>,
    sensor: Option<Version>,
    stats: Option<Stats>,
    playback: Option<PlaybackStatus>,
}

/// The time that replies took, in seconds.
#[derive(Debug, Serialize)]
struct LatencySeconds {
    last: f64,
    mean: f64,
    max: f64,
}

impl<'a> SensorReport<'a> {
    fn of(source: &'a Source) -> Self {
        let health = source.health();
        let report = Self {
            name: source.name.as_deref(),
            pose: source.pose,
            port: source.port().to_string(),
            link: health.link,
            why: health.why,
            baud_rate: None,
            window: source.window(),
            asked: None,
            reached: 0.0,
            age: None,
            latency: None,
            jitter: None,
            sensor: None,
            stats: None,
            playback: None,
        };
        match &source.kind {
            SourceKind::Sensor(hub) => report.with_sensor(hub),
            SourceKind::Recording(playback) => report.with_recording(playback),
        }
    }

    fn with_sensor(self, hub: &Hub) -> Self {
        let live = hub.live();
        let sensor = live.as_ref().map(|live| &live.sensor);
        let stats = sensor.map(|sensor| sensor.stats()).unwrap_or_default();
        let latency = Some(stats.reply_latency).filter(|latency| latency.count > 0);
        Self {
            baud_rate: sensor.and_then(|sensor| sensor.state().borrow().baud_rate()),
            asked: hub.rate().period().map(|period| 1.0 / period.as_secs_f64()),
            reached: stats.schedules.first().map_or(0.0, |schedule| schedule.reached),
            age: sensor.and_then(|sensor| sensor.freshness().age()).map(|age| age.as_secs_f64()),
            latency: latency.map(|latency| LatencySeconds {
                last: latency.last.as_secs_f64(),
                mean: latency.mean().as_secs_f64(),
                max: latency.max.as_secs_f64(),
            }),
            jitter: hub.jitter(),
            // Cached, or not available now.
            sensor: sensor.and_then(|sensor| sensor.version().now_or_never()).and_then(Result::ok),
            stats: Some(stats),
            ..self
        }
    }

    fn with_recording(self, playback: &Playback) -> Self {
        let sensor = Some(playback.version.clone());
        Self { sensor, playback: Some(playback.player.status()), ..self }
    }
}

/// Answers `/state`.
pub(super) async fn state(State(app): State<App>) -> Response {
    let report = StateReport {
        urg: env!("CARGO_PKG_VERSION"),
        viewers: app.viewers.len(),
        sensors: app.sources.iter().map(SensorReport::of).collect(),
    };
    respond(StatusCode::OK, &report)
}

/// The answer to `/health`.
#[derive(Debug, Serialize)]
struct HealthReport<'a> {
    status: &'static str,
    sensors: Vec<SensorHealth<'a>>,
}

#[derive(Debug, Serialize)]
struct SensorHealth<'a> {
    name: Option<&'a str>,
    status: &'static str,
    link: &'static str,
    why: Option<String>,
}

/// Answers `/health`.
pub(super) async fn health(State(app): State<App>) -> Response {
    let status = |is_ok| if is_ok { "ok" } else { "failing" };
    let sensors: Vec<_> = app
        .sources
        .iter()
        .map(|source| {
            let health = source.health();
            let (name, status) = (source.name.as_deref(), status(health.why.is_none()));
            SensorHealth { name, status, link: health.link, why: health.why }
        })
        .collect();
    let is_ok = sensors.iter().all(|sensor| sensor.why.is_none());
    let code = if is_ok { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    respond(code, &HealthReport { status: status(is_ok), sensors })
}

fn respond(status: StatusCode, data: &impl Serialize) -> Response {
    match json::line(data) {
        Ok(line) => (status, [(header::CONTENT_TYPE, "application/json")], line).into_response(),
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}
