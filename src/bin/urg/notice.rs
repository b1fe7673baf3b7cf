//! What the user is told besides the data: lines on standard error.

use std::fmt;

use crate::stderr;

/// Writes one line to standard error, without waiting for it.
///
/// Control characters are escaped: it stays one line whatever is in it, and
/// does nothing to the terminal.
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
    stderr::write(line.as_bytes());
}
