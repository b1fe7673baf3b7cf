//! `/`: the page, one document that brings all it needs.

use std::collections::hash_map::RandomState;
use std::hash::BuildHasher;

use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde_json::json;
use tokio_scip::ErrorCode;

const HTML: &str = include_str!("page.html");
const STYLE: &str = include_str!("page.css");
/// Put together into one script.
const SCRIPTS: [&str; 2] = [include_str!("radar.js"), include_str!("page.js")];

pub(super) async fn page() -> Response {
    let nonce = nonce();
    // Nothing may be brought in from anywhere, nor run or styled but by what is
    // in the page; it may ask its own server, and be framed by nobody.
    let policy = format!(
        "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; \
         connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; \
         frame-ancestors 'none'; require-trusted-types-for 'script'"
    );
    let script = format!("\"use strict\";\nconst CODES = {};\n{}", codes(), SCRIPTS.concat());
    let page =
        HTML.replace("{nonce}", &nonce).replace("{style}", STYLE).replace("{script}", &script);
    let headers = [
        (header::CONTENT_TYPE, "text/html; charset=utf-8".to_owned()),
        (header::CONTENT_SECURITY_POLICY, policy),
    ];
    (headers, page).into_response()
}

/// Returns the meaning and the kind of each error code.
fn codes() -> serde_json::Value {
    let codes = ErrorCode::all().map(|code| {
        let kind = match code {
            _ if code.is_beyond_range() => "far",
            _ if code.is_low_intensity() => "weak",
            _ => "none",
        };
        json!({ "kind": kind, "meaning": code.meaning() })
    });
    codes.collect()
}

/// Returns 128 bits that nobody can guess: the keys of the standard library's hashes
/// are random.
fn nonce() -> String {
    let random = || RandomState::new().hash_one(());
    format!("{:016x}{:016x}", random(), random())
}
