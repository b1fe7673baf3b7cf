//! What the user is told besides the data: lines on standard error.

use std::fmt;
use std::io::{self, Write};

/// Writes one line to standard error.
///
/// Control characters are escaped: it stays one line whatever is in it, and
/// does nothing to the terminal. That nobody reads it is no reason to stop.
pub(crate) fn notice(text: impl fmt::Display) {
    let mut line = String::from("urg: ");
    for c in text.to_string().chars() {
        if c.is_control() {
            line.extend(c.escape_default());
        } else {
            line.push(c);
        }
    }
    line.push('\n');
    let _ = io::stderr().write_all(line.as_bytes());
}
