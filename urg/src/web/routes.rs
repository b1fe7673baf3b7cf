//! Routes, and the headers that protect the server and its page from other sites.

use std::sync::Arc;

use hyper::header::{self, HeaderName, HeaderValue};
use hyper::{Method, Request, StatusCode};

use super::response::{Response, text};
use super::{Site, metrics, page, playback, scans, state};

/// Headers of every response. The page adds a content security policy.
const HEADERS: [(HeaderName, HeaderValue); 6] = [
    // A proxy that compresses, such as HAProxy or Express, would hold scans.
    (header::CACHE_CONTROL, HeaderValue::from_static("no-store, no-transform")),
    (header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff")),
    (header::X_FRAME_OPTIONS, HeaderValue::from_static("DENY")),
    (header::REFERRER_POLICY, HeaderValue::from_static("no-referrer")),
    (
        HeaderName::from_static("cross-origin-resource-policy"),
        HeaderValue::from_static("same-origin"),
    ),
    (
        HeaderName::from_static("cross-origin-opener-policy"),
        HeaderValue::from_static("same-origin"),
    ),
];

pub(super) fn respond<B>(site: &Arc<Site>, request: &Request<B>) -> Response {
    let mut response = match refused(site, request) {
        Some(response) => response,
        None => match request.uri().path() {
            "/" => page::page(),
            "/scans" => scans::scans(site, request),
            "/state" => state::state(site),
            "/health" => state::health(site),
            "/metrics" => metrics::metrics(site),
            "/playback" => playback::playback(site, request),
            _ => text(StatusCode::NOT_FOUND, "no such page\n"),
        },
    };
    response.headers_mut().extend(HEADERS);
    response
}

/// Refuses requests for another host, or with a wrong method.
fn refused<B>(site: &Site, request: &Request<B>) -> Option<Response> {
    let host = request.headers().get(header::HOST);
    // Browsers always send `Host`, so a request without it is harmless.
    if host.is_some_and(|host| !host.to_str().is_ok_and(|host| site.hosts.accept(host))) {
        let reason = "this is not a name of this server: use its address, or start it with \
                      --host NAME\n";
        return Some(text(StatusCode::MISDIRECTED_REQUEST, reason));
    }
    let (is_allowed, allowed) = match request.uri().path() {
        "/playback" => (request.method() == Method::POST, "POST"),
        _ => ([Method::GET, Method::HEAD].contains(request.method()), "GET,HEAD"),
    };
    (!is_allowed).then(|| {
        let mut response = text(StatusCode::METHOD_NOT_ALLOWED, format!("expected {allowed}\n"));
        response.headers_mut().insert(header::ALLOW, HeaderValue::from_static(allowed));
        response
    })
}
