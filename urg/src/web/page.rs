//! `/`: the page, a single document with its script and style sheet.

use std::collections::hash_map::RandomState;
use std::hash::BuildHasher;

use hyper::StatusCode;
use hyper::header::{CONTENT_SECURITY_POLICY, HeaderValue};
use serde_json::{Value, json};
use tokio_scip::Geometry;

use super::response::{Response, text, whole};
use crate::plot::colours::{COVERED, Colours, DISTANCES, INTENSITIES, SENSORS, WEAKEST, WIDTHS};
use crate::plot::missing::MissingKind;
use crate::plot::{self, HOLD, RADII};

const HTML: &str = include_str!("page.html");
const STYLE: &str = include_str!("page.css");
/// Parts of the page's script, in order.
const SCRIPTS: [&str; 4] = [
    include_str!("radar.js"),
    include_str!("sensor.js"),
    include_str!("deck.js"),
    include_str!("page.js"),
];

pub(super) fn page() -> Response {
    let nonce = nonce();
    // Only the page's own script and style sheet apply, and the page connects only to this
    // server. No site may put it in a frame.
    let policy = format!(
        "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; \
         connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; \
         frame-ancestors 'none'; require-trusted-types-for 'script'"
    );
    let script = format!(
        "\"use strict\";\nconst KINDS = {};\nconst GEOMETRY = {};\nconst REACH = {};\n\
         const RADII = {};\nconst HOLD = {};\nconst WIDTHS = {};\nconst COVERED = {COVERED};\n\
         const BANDS = {};\nconst WEAKEST = {WEAKEST};\n{}",
        kinds(),
        json!(Geometry::URG_04LX),
        plot::whole(&Geometry::URG_04LX),
        json!(RADII),
        HOLD.as_millis(),
        json!(WIDTHS),
        DISTANCES.len(),
        SCRIPTS.concat()
    );
    let style = STYLE
        .replace("{dark}", &colours(|colours| colours.on_dark))
        .replace("{light}", &colours(|colours| colours.on_light));
    let page =
        HTML.replace("{nonce}", &nonce).replace("{style}", &style).replace("{script}", &script);
    let mut response = whole(StatusCode::OK, "text/html; charset=utf-8", page);
    // The policy has only characters that a header allows.
    match HeaderValue::try_from(policy) {
        Ok(policy) => response.headers_mut().insert(CONTENT_SECURITY_POLICY, policy),
        Err(_) => return text(StatusCode::INTERNAL_SERVER_ERROR, "no policy for the page\n"),
    };
    response
}

fn kinds() -> Value {
    json!(MissingKind::ALL.map(|kind| [kind.name(), kind.meaning()]))
}

/// Colours of kinds, sensors and distances, as variables for the style sheet.
fn colours(of: impl Fn(Colours) -> &'static str) -> String {
    let kinds = MissingKind::ALL.map(|kind| (kind.name().to_owned(), kind.colours()));
    let numbered = |prefix, list: &[Colours]| -> Vec<_> {
        let name = |(number, colours): (_, &_)| (format!("{prefix}{number}"), *colours);
        list.iter().enumerate().map(name).collect()
    };
    let numbers = [numbered('s', &SENSORS), numbered('d', &DISTANCES), numbered('i', &INTENSITIES)];
    let all = kinds.into_iter().chain(numbers.into_iter().flatten());
    all.map(|(name, colours)| format!("--{name}: {}; ", of(colours))).collect()
}

/// Generates 128 unpredictable bits: the standard library seeds its hashers randomly.
fn nonce() -> String {
    let random = || RandomState::new().hash_one(());
    format!("{:016x}{:016x}", random(), random())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_missing_distance_has_word_and_colour() {
        for place in ["{dark}", "{light}"] {
            assert_eq!(STYLE.matches(place).count(), 1, "{place}");
        }
        assert_eq!(kinds()[1], json!(["weak", MissingKind::Weak.meaning()]));
        let dark = colours(|colours| colours.on_dark);
        assert!(dark.starts_with("--far: #6ea8ff; --weak: "), "{dark}");
        assert!(dark.contains("--s0: #6cc5ff; --s1: #ffb057; "), "{dark}");
        assert!(dark.contains("--d7: #adb5ff; --i0: #6b5dcf; "), "{dark}");
    }
}
