//! `/playback`: commands to the playback of a recording, which all viewers share.

use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};

use super::app::App;
use super::source::SourceKind;
use crate::playback::PlaybackCommand;

/// Answers `POST /playback?COMMAND`. With several recordings it goes to all of them.
pub(super) async fn playback(State(app): State<App>, headers: HeaderMap, uri: Uri) -> Response {
    if !is_own_page(&headers) {
        return (StatusCode::FORBIDDEN, "the page of another site may not do that\n")
            .into_response();
    }
    let command: PlaybackCommand = match uri.query().unwrap_or_default().parse() {
        Ok(command) => command,
        Err(expected) => {
            return (StatusCode::BAD_REQUEST, format!("{expected}\n")).into_response();
        }
    };
    let mut players = app.sources.iter().filter_map(|source| match &source.kind {
        SourceKind::Recording(playback) => Some(&playback.player),
        SourceKind::Sensor(_) => None,
    });
    let Some(first) = players.next() else {
        return (StatusCode::CONFLICT, "no recording is played here\n").into_response();
    };
    first.send(command);
    players.for_each(|player| player.send(command));
    StatusCode::NO_CONTENT.into_response()
}

/// Returns false for a browser that shows the page of another site. A program sends
/// no `Origin`.
fn is_own_page(headers: &HeaderMap) -> bool {
    let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
    match (headers.get(header::ORIGIN), text(header::ORIGIN), text(header::HOST)) {
        (None, ..) => true,
        (_, Some(origin), Some(host)) => {
            origin.split_once("://").is_some_and(|(_, origin)| origin == host)
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    #[test]
    fn only_programs_and_the_own_page_may_command() {
        let headers = |origin: Option<&'static str>| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, HeaderValue::from_static("127.0.0.1:8080"));
            if let Some(origin) = origin {
                headers.insert(header::ORIGIN, HeaderValue::from_static(origin));
            }
            headers
        };
        for origin in [None, Some("http://127.0.0.1:8080")] {
            assert!(is_own_page(&headers(origin)), "{origin:?}");
        }
        for origin in ["null", "", "http://evil.example", "http://127.0.0.1:80"] {
            assert!(!is_own_page(&headers(Some(origin))), "{origin}");
        }
    }
}
