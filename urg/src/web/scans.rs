//! `/scans`: streams scans and events as NDJSON or server-sent events.

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures_util::stream::{self, BoxStream, SelectAll, StreamExt};
use http_body_util::StreamBody;
use hyper::body::Frame;
use hyper::header::{self, HeaderMap, HeaderName, HeaderValue};
use hyper::{Request, StatusCode};
use tokio::sync::OwnedSemaphorePermit;

use super::line::ViewerLine;
use super::response::{Response, response, text};
use super::{MAX_STREAMS, Site};
use crate::interrupt::Interrupt;

/// A silent stream sends a keepalive after this time. Proxies then keep it open, and the
/// server notices when the client is gone.
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(15);
/// Without it, nginx keeps what fills none of its buffers (4 KiB) until the next scan comes.
const UNBUFFERED: HeaderName = HeaderName::from_static("x-accel-buffering");
/// Media type of server-sent events.
const EVENTS: &str = "text/event-stream";

pub(super) fn scans<B>(site: &Site, request: &Request<B>) -> Response {
    let Some(query) = ScansQuery::parse(request.uri().query()) else {
        let reason = "invalid query: expected /scans?max=N, with a number of scans from 1\n";
        return text(StatusCode::BAD_REQUEST, reason);
    };
    let Ok(permit) = Arc::clone(&site.streams).try_acquire_owned() else {
        let reason = format!("{MAX_STREAMS} clients read scans already: try again later\n");
        return text(StatusCode::SERVICE_UNAVAILABLE, reason);
    };
    let has_events = wants_events(request.headers());
    let client = ScansClient {
        interrupt: site.interrupt.clone(),
        lines: stream::select_all(site.sources.iter().map(|source| source.lines(query.with_old))),
        scans_left: query.max,
        has_events,
        _permit: permit,
    };
    let bytes = stream::unfold(client, ScansClient::next);
    let body = StreamBody::new(bytes.map(|bytes| Ok(Frame::data(bytes))));
    let mut response =
        response(StatusCode::OK, if has_events { EVENTS } else { "application/x-ndjson" }, body);
    response.headers_mut().extend([
        (header::VARY, HeaderValue::from_static("accept")),
        (UNBUFFERED, HeaderValue::from_static("no")),
    ]);
    response
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct ScansQuery {
    max: u64,
    /// True if the client wants the latest scan first, even if it is old.
    with_old: bool,
}

impl ScansQuery {
    /// Parses a query such as `max=3&old`. Returns `None` if it is invalid.
    fn parse(query: Option<&str>) -> Option<Self> {
        let mut parts = query.unwrap_or_default().split('&').filter(|part| !part.is_empty());
        parts.try_fold(Self { max: u64::MAX, with_old: false }, |query, part| match part {
            "old" => Some(Self { with_old: true, ..query }),
            _ => {
                let max = part.strip_prefix("max=")?.parse().ok().filter(|max| *max > 0)?;
                Some(Self { max, ..query })
            }
        })
    }
}

/// Checks whether the client wants server-sent events, and not NDJSON.
fn wants_events(headers: &HeaderMap) -> bool {
    let accepted = headers.get_all(header::ACCEPT).iter();
    accepted.filter_map(|value| value.to_str().ok()).any(|value| value.contains(EVENTS))
}

/// Client of a stream of scans. A slow client misses scans and gets the newest scan next.
struct ScansClient {
    interrupt: Interrupt,
    /// Lines of all sources, in turn.
    lines: SelectAll<BoxStream<'static, ViewerLine>>,
    scans_left: u64,
    has_events: bool,
    _permit: OwnedSemaphorePermit,
}

impl ScansClient {
    /// Waits for the next bytes. Returns `None` after the end.
    async fn next(mut self) -> Option<(Bytes, Self)> {
        if self.scans_left == 0 {
            return None;
        }
        let interrupt = self.interrupt.clone();
        let bytes = tokio::select! {
            biased;
            _ = interrupt.requested() => return None,
            line = self.lines.next() => {
                let line = line?;
                self.scans_left -= u64::from(line.is_scan);
                if self.has_events { line.event() } else { line.ndjson() }
            }
            // A comment, or white space before the next object: a client ignores both.
            () = tokio::time::sleep(KEEPALIVE_INTERVAL) => {
                Bytes::from_static(if self.has_events { b":\n\n" } else { b" " })
            }
        };
        Some((bytes, self))
    }
}
