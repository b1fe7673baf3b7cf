//! Progress line of `urg record` on the terminal.

use std::time::{Duration, Instant};

use crate::output::stderr;

/// Minimum time between updates, so that you can read the line.
const REFRESH_INTERVAL: Duration = Duration::from_millis(200);

/// Rate-limited progress line.
#[derive(Debug)]
pub(crate) struct RecordingProgress {
    next: Instant,
}

impl RecordingProgress {
    pub(crate) fn new() -> Self {
        Self { next: Instant::now() }
    }

    /// Shows a line, unless the last update is too recent.
    pub(crate) fn show(&mut self, line: impl FnOnce() -> String) {
        if Instant::now() >= self.next {
            self.next = Instant::now() + REFRESH_INTERVAL;
            stderr::show(line);
        }
    }
}
