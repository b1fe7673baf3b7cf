//! `/scans`: streams scans and events as NDJSON or server-sent events.

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures_util::stream::{self, BoxStream, SelectAll, StreamExt};
use http_body_util::StreamBody;
use hyper::body::Frame;
use hyper::header::{self, HeaderMap, HeaderValue};
use hyper::{Request, StatusCode};
use tokio::sync::OwnedSemaphorePermit;

use super::line::ViewerLine;
use super::response::{Response, response, text};
use super::{MAX_STREAMS, Site};
use crate::interrupt::Interrupt;

/// A silent stream sends a keepalive after this time. Proxies then keep it open, and the
/// server notices when the client is gone.
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(15);

pub(super) fn scans<B>(site: &Site, request: &Request<B>) -> Response {
    let Some(query) = ScansQuery::parse(request.uri().query()) else {
        let reason = "invalid query: expected /scans?max=N, with a number of scans from 1\n";
        return text(StatusCode::BAD_REQUEST, reason);
    };
    let Ok(permit) = Arc::clone(&site.streams).try_acquire_owned() else {
        let reason = format!("{MAX_STREAMS} clients read scans already: try again later\n");
        return text(StatusCode::SERVICE_UNAVAILABLE, reason);
    };
    let format = ScansFormat::accepted(request.headers());
    let client = ScansClient {
        interrupt: site.interrupt.clone(),
        lines: stream::select_all(site.sources.iter().map(|source| source.lines(query.with_old))),
        scans_left: query.max,
        format,
        _permit: permit,
    };
    let bytes = stream::unfold(client, ScansClient::next);
    let body = StreamBody::new(bytes.map(|bytes| Ok(Frame::data(bytes))));
    let mut response = response(StatusCode::OK, format.content_type(), body);
    response.headers_mut().insert(header::VARY, HeaderValue::from_static("accept"));
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

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ScansFormat {
    Ndjson,
    Events,
}

impl ScansFormat {
    fn accepted(headers: &HeaderMap) -> Self {
        let events = headers
            .get_all(header::ACCEPT)
            .iter()
            .filter_map(|value| value.to_str().ok())
            .any(|value| value.contains("text/event-stream"));
        if events { Self::Events } else { Self::Ndjson }
    }

    fn content_type(self) -> &'static str {
        match self {
            Self::Ndjson => "application/x-ndjson",
            Self::Events => "text/event-stream",
        }
    }

    fn bytes(self, line: &ViewerLine) -> Bytes {
        match self {
            Self::Ndjson => line.ndjson(),
            Self::Events => line.event(),
        }
    }

    /// Bytes that a client ignores: a comment, or white space before the next object.
    fn keepalive(self) -> Bytes {
        Bytes::from_static(match self {
            Self::Ndjson => b" ",
            Self::Events => b":\n\n",
        })
    }
}

/// Client of a stream of scans. A slow client misses scans and gets the newest scan next.
struct ScansClient {
    interrupt: Interrupt,
    /// Lines of all sources, in turn.
    lines: SelectAll<BoxStream<'static, ViewerLine>>,
    scans_left: u64,
    format: ScansFormat,
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
                self.format.bytes(&line)
            }
            () = tokio::time::sleep(KEEPALIVE_INTERVAL) => self.format.keepalive(),
        };
        Some((bytes, self))
    }
}
