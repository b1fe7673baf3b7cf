//! `/playback`: commands that control the playback of a recording, which all viewers share.

use hyper::header::{self, HeaderMap};
use hyper::{Request, StatusCode};

use super::Site;
use super::response::{Response, text};
use crate::playback::PlaybackCommand;

/// Answers `POST /playback?COMMAND`. Sends the command to every recording.
pub(super) fn playback<B>(site: &Site, request: &Request<B>) -> Response {
    if !is_own_page(request.headers()) {
        return text(StatusCode::FORBIDDEN, "the page of another site may not do that\n");
    }
    let command: PlaybackCommand = match request.uri().query().unwrap_or_default().parse() {
        Ok(command) => command,
        Err(expected) => return text(StatusCode::BAD_REQUEST, format!("{expected}\n")),
    };
    let mut players = site.sources.iter().filter_map(|source| source.player());
    let Some(first) = players.next() else {
        return text(StatusCode::CONFLICT, "no recording is played here\n");
    };
    first.send(command);
    players.for_each(|player| player.send(command));
    text(StatusCode::NO_CONTENT, "")
}

/// Rejects browsers that show a page of another site. Programs send no `Origin`.
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
