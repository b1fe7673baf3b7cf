//! A progress line on the terminal, which each new one overwrites.

use std::time::{Duration, Instant};

use crate::output::stderr;

/// The shortest time for which a line is shown, so that it can be read.
const REFRESH_INTERVAL: Duration = Duration::from_millis(200);

/// The line.
#[derive(Debug)]
pub(crate) struct Progress {
    next: Instant,
}

impl Progress {
    pub(crate) fn new() -> Self {
        Self { next: Instant::now() }
    }

    /// Shows a line, unless the last one is too recent.
    pub(crate) fn show(&mut self, line: impl FnOnce() -> String) {
        if Instant::now() >= self.next {
            self.next = Instant::now() + REFRESH_INTERVAL;
            stderr::show(line);
        }
    }
}
