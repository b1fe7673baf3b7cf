//! `/scans`: scans and events as they come, as NDJSON or server-sent events.

use std::sync::Arc;
use std::time::Duration;

use axum::Extension;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures_util::StreamExt;
use futures_util::stream::{self, BoxStream, SelectAll};

use super::app::App;
use super::line::ViewerLine;
use super::server::Connection;
use super::source::Source;
use super::viewers::Place;
use crate::failure::Failure;
use crate::interrupt::Interrupt;

/// A stream of events without data sends a comment after this time, so that
/// proxies keep it open.
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(15);

pub(super) async fn scans(
    State(app): State<App>,
    Extension(connection): Extension<Arc<Connection>>,
    headers: HeaderMap,
    uri: Uri,
) -> Response {
    let Some(left) = count(uri.query()) else {
        let text = "invalid query: expected /scans?max=N, with a number of scans from 1\n";
        return (StatusCode::BAD_REQUEST, text).into_response();
    };
    let Some(seat) = app.viewers.admit(&connection) else {
        let text = "too many viewers: try again when one has left\n";
        return (StatusCode::SERVICE_UNAVAILABLE, [(header::RETRY_AFTER, "5")], text)
            .into_response();
    };
    // A viewer that had to make room is dropped now, before the next request has its turn.
    tokio::task::yield_now().await;
    let place = Arc::clone(&seat.place);
    connection.become_viewer(seat);
    let format = ScansFormat::accepted(&headers);
    let lines = stream::select_all(app.sources.iter().map(Source::lines));
    let viewer = Viewer { interrupt: app.interrupt, lines, left, format, place };
    // A client that is slow is not polled for: the newest scan comes next.
    let lines = stream::unfold(viewer, async |mut viewer| {
        let text = viewer.next().await?;
        Some((text.map_err(|_| "cannot write JSON"), viewer))
    });
    let headers = [(header::CONTENT_TYPE, format.content_type()), (header::VARY, "accept")];
    (headers, Body::from_stream(lines)).into_response()
}

/// Returns the number of scans that the query asks for; `None` if it is invalid.
fn count(query: Option<&str>) -> Option<u64> {
    let parts = query.unwrap_or_default().split('&').filter(|part| !part.is_empty());
    parts.into_iter().try_fold(u64::MAX, |_, part| {
        part.strip_prefix("max=")?.parse().ok().filter(|count| *count > 0)
    })
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

    /// Returns the bytes of a line in this format.
    fn bytes(self, line: &ViewerLine) -> Bytes {
        match self {
            Self::Ndjson => line.ndjson(),
            Self::Events => line.event(),
        }
    }
}

/// A client that takes scans.
struct Viewer {
    interrupt: Interrupt,
    /// Those of all sources, in turn where several have one.
    lines: SelectAll<BoxStream<'static, Result<ViewerLine, Failure>>>,
    /// The number of scans that are still wanted.
    left: u64,
    format: ScansFormat,
    place: Arc<Place>,
}

impl Viewer {
    /// Returns the next bytes; `None` after the end.
    async fn next(&mut self) -> Option<Result<Bytes, Failure>> {
        let (interrupt, format) = (self.interrupt.clone(), self.format);
        self.place.waits();
        let bytes = tokio::select! {
            biased;
            _ = interrupt.requested() => None,
            line = self.line() => Some(line?.map(|line| format.bytes(&line))),
            () = tokio::time::sleep(KEEPALIVE_INTERVAL), if format == ScansFormat::Events => {
                Some(Ok(Bytes::from_static(b":\n\n")))
            }
        };
        self.place.handed();
        bytes
    }

    async fn line(&mut self) -> Option<Result<ViewerLine, Failure>> {
        if self.left == 0 {
            return None;
        }
        let line = self.lines.next().await?;
        self.left -= line.as_ref().map_or(0, |line| line.is_scan.into());
        Some(line)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_query_asks_for_a_number_of_scans_or_for_all() {
        assert_eq!(count(None), Some(u64::MAX));
        assert_eq!(count(Some("")), Some(u64::MAX));
        assert_eq!(count(Some("max=3")), Some(3));
        for query in ["max=0", "max=-1", "max=", "max=many", "maximum=3", "max=1&rate=2"] {
            assert_eq!(count(Some(query)), None, "{query}");
        }
    }
}
