//! Notices: lines for the user on standard error.

use std::fmt;

use super::stderr;

/// Queues one line for standard error. Does not block.
///
/// Escapes control characters, so that text from a sensor or a file name stays on one line
/// and cannot control the terminal.
pub(crate) fn notice(text: impl fmt::Display) {
    stderr::write(format!("urg: {}\n", escaped(&text.to_string())).as_bytes());
}

pub(crate) fn escaped(text: &str) -> String {
    let escaped = |c: char| match c.is_control() {
        true => c.escape_default().collect(),
        false => String::from(c),
    };
    text.chars().map(escaped).collect()
}
