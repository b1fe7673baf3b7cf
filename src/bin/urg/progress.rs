//! A line on the terminal that tells how far it is, written over and over.

use std::time::{Duration, Instant};

use crate::stderr;

/// How long a line stands at least.
const STANDS: Duration = Duration::from_millis(200);

/// The line.
#[derive(Debug)]
pub(crate) struct Progress {
    next: Instant,
}

impl Progress {
    pub(crate) fn new() -> Self {
        Self { next: Instant::now() }
    }

    /// Shows a line, unless the last one was shown just now.
    pub(crate) fn show(&mut self, line: impl FnOnce() -> String) {
        if Instant::now() >= self.next {
            self.next = Instant::now() + STANDS;
            stderr::show(line);
        }
    }
}
