//! `/state` and `/health`: state of each sensor and its stream, for the page and for a
//! supervisor.

use hyper::StatusCode;
use serde::Serialize;
use tokio_scip::scan::Pose;
use tokio_scip::{Stats, Version, Window};

use super::Site;
use super::hub::Hub;
use super::response::{Response, text, whole};
use super::source::SiteSource;
use crate::format::json_line;
use crate::playback::{PlaybackStatus, Player};
use crate::plot::pose;
use crate::port::open::line_baud_rate;
use crate::stream::jitter::Jitter;

#[derive(Debug, Serialize)]
struct StateReport<'a> {
    urg: &'static str,
    viewers: usize,
    sensors: Vec<SensorReport<'a>>,
}

#[derive(Debug, Serialize)]
struct SensorReport<'a> {
    name: Option<&'a str>,
    #[serde(serialize_with = "pose::serialize")]
    pose: Pose,
    port: String,
    /// One of connected, recovering, disconnected, waiting, closed, recording.
    link: &'static str,
    /// Reason why no scans arrive; null while they do.
    why: Option<String>,
    /// Null on USB, and on a port that ignores it.
    baud_rate: Option<tokio_scip::BaudRate>,
    window: Window,
    /// Requested rate in scans a second; null for the maximum.
    asked: Option<f64>,
    /// Rate over about the last three seconds, in scans a second.
    reached: Option<f64>,
    age: Option<f64>,
    latency: Option<LatencySeconds>,
    jitter: Option<Jitter>,
    sensor: Option<Version>,
    stats: Option<Stats>,
    playback: Option<PlaybackStatus>,
}

#[derive(Debug, Serialize)]
struct LatencySeconds {
    last: f64,
    mean: f64,
    max: f64,
}

impl<'a> SensorReport<'a> {
    fn from_source(source: &'a SiteSource) -> Self {
        let health = source.health();
        let (hub, player) = (source.hub(), source.player());
        let sensor = hub.and_then(Hub::sensor);
        let stats = hub.map(|_| sensor.map(|sensor| sensor.stats()).unwrap_or_default());
        let latency = stats.as_ref().map(|stats| stats.reply_latency);
        let schedule = stats.as_ref().and_then(|stats| stats.schedules.first());
        Self {
            name: source.name(),
            pose: source.picture.pose,
            port: source.picture.port.to_string(),
            link: health.link,
            why: health.why,
            baud_rate: sensor.and_then(line_baud_rate),
            window: source.picture.window,
            asked: hub
                .and_then(|_| source.picture.rate.period())
                .map(|one| 1.0 / one.as_secs_f64()),
            reached: schedule.and_then(|schedule| schedule.reached),
            age: sensor.and_then(|sensor| sensor.freshness().age()).map(|age| age.as_secs_f64()),
            latency: latency.filter(|latency| latency.count > 0).map(|latency| LatencySeconds {
                last: latency.last.as_secs_f64(),
                mean: latency.total.as_secs_f64() / latency.count.max(1) as f64,
                max: latency.max.as_secs_f64(),
            }),
            jitter: hub.and_then(Hub::jitter),
            sensor: source.version().cloned(),
            stats,
            playback: player.map(Player::status),
        }
    }
}

pub(super) fn state(site: &Site) -> Response {
    let report = StateReport {
        urg: env!("CARGO_PKG_VERSION"),
        viewers: site.viewers(),
        sensors: site.sources.iter().map(|source| SensorReport::from_source(source)).collect(),
    };
    respond(StatusCode::OK, &report)
}

#[derive(Debug, Serialize)]
struct HealthReport<'a> {
    status: &'static str,
    sensors: Vec<HealthEntry<'a>>,
}

#[derive(Debug, Serialize)]
struct HealthEntry<'a> {
    name: Option<&'a str>,
    status: &'static str,
    link: &'static str,
    why: Option<String>,
}

pub(super) fn health(site: &Site) -> Response {
    let status = |is_ok| if is_ok { "ok" } else { "failing" };
    let sensors: Vec<_> = site
        .sources
        .iter()
        .map(|source| {
            let health = source.health();
            let (name, status) = (source.name(), status(health.why.is_none()));
            HealthEntry { name, status, link: health.link, why: health.why }
        })
        .collect();
    let is_ok = sensors.iter().all(|sensor| sensor.why.is_none());
    let code = if is_ok { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    respond(code, &HealthReport { status: status(is_ok), sensors })
}

fn respond(status: StatusCode, data: &impl Serialize) -> Response {
    match json_line(data) {
        Ok(line) => whole(status, "application/json", line),
        Err(failure) => text(StatusCode::INTERNAL_SERVER_ERROR, failure.line().to_owned()),
    }
}
