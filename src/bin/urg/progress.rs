//! A line on the terminal that tells how far it is, written over and over.

use std::io::{self, IsTerminal, Write};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How long a line stands at least.
const STANDS: Duration = Duration::from_millis(200);

/// Back to the line's beginning, and nothing on it.
const CLEAR: &[u8] = b"\r\x1b[K";

/// The line. It is written on a thread of its own: a terminal that is stopped
/// holds up nobody. Dropping it clears it.
#[derive(Debug)]
pub(crate) struct Progress {
    /// Where standard error is a terminal.
    line: Option<(SyncSender<String>, JoinHandle<()>)>,
    next: Instant,
}

impl Progress {
    pub(crate) fn new() -> Self {
        let line = io::stderr().is_terminal().then(|| {
            let (sender, lines) = sync_channel::<String>(1);
            let write = move || {
                for line in lines {
                    let width = crossterm::terminal::size().map_or(80, |(width, _)| width);
                    let line: String = line.chars().take(usize::from(width) - 1).collect();
                    // Where it ends, a notice may begin.
                    let _ = io::stderr().write_all(format!("\r{line}\x1b[K\r").as_bytes());
                }
            };
            (sender, std::thread::spawn(write))
        });
        Self { line, next: Instant::now() }
    }

    /// Shows a line, unless the last one was shown just now.
    pub(crate) fn show(&mut self, line: impl FnOnce() -> String) {
        let Some((sender, _)) = &self.line else { return };
        if Instant::now() >= self.next {
            self.next = Instant::now() + STANDS;
            // One that the terminal has no time for is none to be missed.
            let _ = sender.try_send(line());
        }
    }

    /// Makes room for a notice; the next line is shown at once.
    pub(crate) fn clear(&mut self) {
        if self.line.is_some() {
            let _ = io::stderr().write_all(CLEAR);
            self.next = Instant::now();
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some((sender, thread)) = self.line.take() {
            drop(sender);
            // It does not panic.
            let _ = thread.join();
            let _ = io::stderr().write_all(CLEAR);
        }
    }
}
