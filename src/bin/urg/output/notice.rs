//! Notices: lines on standard error for the user, besides the data.

use std::fmt;

use super::stderr;

/// Queues one line for standard error, without waiting for it.
///
/// Control characters are escaped: whatever a sensor or a file name holds, it
/// stays one line and does nothing to the terminal.
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
