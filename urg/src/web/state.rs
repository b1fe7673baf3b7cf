//! `/state` and `/health`: state of each sensor and its stream, for the page and for a supervisor.

use std::sync::Arc;

use hyper::StatusCode;
use serde_json::{Value, json};
use tokio_scip::protocol::Protocol;
use tokio_scip::{Scan, Sensor};

use super::Site;
use super::hub::Hub;
use super::response::{Response, whole};
use super::source::SiteSource;
use crate::playback::Player;
use crate::plot::{self, pose};
use crate::port::open::line_baud_rate;
use crate::stream::health::SensorHealth;

pub(super) fn state(site: &Site) -> Response {
    let report = json!({
        "urg": env!("CARGO_PKG_VERSION"),
        "viewers": site.viewers(),
        "sensors": site.sources.iter().map(|source| sensor(source)).collect::<Value>(),
    });
    respond(StatusCode::OK, &report)
}

/// Describes a sensor. Times are in seconds, rates in scans a second; what is not known is null.
fn sensor(source: &SiteSource) -> Value {
    let health = source.health();
    let (hub, player, pose) = (source.hub(), source.player(), source.picture.pose);
    let sensor = hub.and_then(Hub::sensor);
    let jitter = hub.and_then(Hub::jitter);
    let stats = hub.map(|_| sensor.map(Sensor::stats).unwrap_or_default());
    let schedule = stats.as_ref().and_then(|stats| stats.schedules.first());
    let reached = schedule.and_then(|schedule| schedule.reached);
    let latest = source.latest();
    let geometry = latest.as_ref().map(Scan::geometry);
    let is_polled = geometry.is_some_and(|geometry| geometry.protocol() == Protocol::Scip1);
    let latency = stats.as_ref().map(|stats| stats.reply_latency).filter(|_| is_polled);
    json!({
        "name": source.name(),
        "pose": {
            "x": pose.x, "y": pose.y, "yaw": pose::yaw(pose), "upside_down": pose.upside_down
        },
        "port": source.picture.port.to_string(),
        // One of connected, recovering, disconnected, waiting, closed, recording.
        "link": health.link,
        // Reason why no scans arrive; null while they do.
        "why": health.why,
        // Null on USB, and on a port that ignores it.
        "baud_rate": sensor.and_then(line_baud_rate),
        "window": hub.and(latest.as_ref()).map_or(source.picture.window, Scan::window),
        // What the sensor measures, its values that are no distance, and the largest radius of its
        // picture in metres; null before the first scan.
        "geometry": geometry,
        "codes": geometry.map(|geometry| source.codes.of(geometry)),
        "reach": geometry.map(plot::whole),
        // Null for the maximum.
        "asked": hub.and_then(|_| source.picture.rate.period()).map(|one| 1.0 / one.as_secs_f64()),
        "reached": reached.or_else(|| jitter.map(|jitter| 1.0 / jitter.mean)),
        "age": sensor.and_then(|sensor| sensor.freshness().age()).map(|age| age.as_secs_f64()),
        // From a poll to the end of its reply; null in SCIP 2, whose scans are not polled.
        "latency": latency.filter(|latency| latency.count > 0).map(|latency| json!({
            "last": latency.last.as_secs_f64(),
            "mean": latency.total.as_secs_f64() / latency.count.max(1) as f64,
            "max": latency.max.as_secs_f64(),
        })),
        "jitter": jitter,
        "sensor": source.version(),
        "stats": stats,
        "playback": player.map(Player::status),
    })
}

pub(super) fn health(site: &Site) -> Response {
    let status = |is_ok| if is_ok { "ok" } else { "failing" };
    let mut all_ok = true;
    let mut sensor = |source: &Arc<SiteSource>| {
        let SensorHealth { link, why } = source.health();
        all_ok &= why.is_none();
        json!({ "name": source.name(), "status": status(why.is_none()), "link": link, "why": why })
    };
    let sensors: Value = site.sources.iter().map(&mut sensor).collect();
    let code = if all_ok { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    respond(code, &json!({ "status": status(all_ok), "sensors": sensors }))
}

fn respond(status: StatusCode, data: &Value) -> Response {
    whole(status, "application/json", format!("{data}\n"))
}
