//! Routes, and the headers that protect the server and its page from other sites.

use std::net::IpAddr;
use std::sync::Arc;

use hyper::header::{self, HeaderName, HeaderValue};
use hyper::{Method, Request, StatusCode};

use super::response::{Response, text};
use super::{Site, metrics, page, playback, scans, state};

/// Headers of every response. The page adds a content security policy.
const HEADERS: [(HeaderName, HeaderValue); 6] = [
    (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
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

/// Refuses requests with a wrong method. On a loopback address, also refuses requests with
/// a foreign `Host`.
///
/// Otherwise, another site could make its name resolve to this machine and read the page
/// (DNS rebinding). On other addresses, any client may connect under any name.
fn refused<B>(site: &Site, request: &Request<B>) -> Option<Response> {
    let host = request.headers().get(header::HOST);
    // Browsers always send `Host`, so a request without it is harmless.
    let stranger = host.is_some_and(|host| !host.to_str().is_ok_and(is_this_machine));
    if site.is_loopback && stranger {
        let reason = "this page is for the machine that serves it: ask there for localhost or \
                      127.0.0.1\n";
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

/// Checks whether a `Host` header names this machine. Any port passes, because a tunnel may
/// use another port.
fn is_this_machine(host: &str) -> bool {
    let name = match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((address, _)) => address,
        None => host.split_once(':').map_or(host, |(name, _)| name),
    };
    name.eq_ignore_ascii_case("localhost")
        || name.parse().is_ok_and(|address: IpAddr| address.is_loopback())
}
