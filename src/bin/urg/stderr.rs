//! Standard error, written on a thread of its own: whoever does not read it, and
//! a terminal that is stopped, hold up nobody.

#[cfg(feature = "mcap")]
use std::io::IsTerminal;
use std::io::{self, Write};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How long the end of the program waits for what is not written yet.
const GRACE: Duration = Duration::from_secs(1);

/// How many bytes wait. A reader that is so far behind misses the rest.
const MOST: usize = 1 << 20;

/// Back to the line's beginning, and nothing on it.
const CLEAR: &[u8] = b"\r\x1b[K";

/// What is to be written.
struct Waiting {
    text: Vec<u8>,
    /// A line to be shown behind it, until something else is written.
    line: Option<String>,
    /// Whether something is being written.
    writing: bool,
    /// Whether there is a thread to do it.
    started: bool,
}

static WAITING: Mutex<Waiting> =
    Mutex::new(Waiting { text: Vec::new(), line: None, writing: false, started: false });
/// There is something to write, or it was written.
static CHANGED: Condvar = Condvar::new();

/// Writes whole lines.
pub(crate) fn write(text: &[u8]) {
    let mut waiting = lock();
    if waiting.text.len() + text.len() <= MOST {
        waiting.text.extend_from_slice(text);
        // It tells of the time before.
        waiting.line = None;
    }
    wake(waiting);
}

/// For those who want a writer; what they write at once stays together.
pub(crate) struct Writer;

impl Write for Writer {
    fn write(&mut self, text: &[u8]) -> io::Result<usize> {
        write(text);
        Ok(text.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Shows a line that is written over by whatever comes next, unless the terminal
/// has had no time yet for something else. Without a terminal it does nothing.
#[cfg(feature = "mcap")]
pub(crate) fn show(line: impl FnOnce() -> String) {
    if io::stderr().is_terminal() {
        let mut waiting = lock();
        waiting.line = Some(line());
        wake(waiting);
    }
}

/// Waits until all is written, or will not be.
pub(crate) fn finish() {
    let unwritten = |waiting: &mut Waiting| waiting.writing || !waiting.text.is_empty();
    drop(CHANGED.wait_timeout_while(lock(), GRACE, unwritten));
}

fn wake(mut waiting: MutexGuard<'_, Waiting>) {
    if !waiting.started {
        waiting.started = true;
        let thread = std::thread::Builder::new().name("stderr".to_owned());
        if thread.spawn(write_on).is_err() {
            // Then here.
            waiting.started = false;
            let _ = io::stderr().write_all(&std::mem::take(&mut waiting.text));
        }
    }
    CHANGED.notify_all();
}

/// Writes what comes, for ever.
fn write_on() {
    let mut shown = false;
    loop {
        let mut waiting = lock();
        waiting.writing = false;
        CHANGED.notify_all();
        let nothing = |waiting: &mut Waiting| waiting.text.is_empty() && waiting.line.is_none();
        let mut waiting =
            CHANGED.wait_while(waiting, nothing).unwrap_or_else(PoisonError::into_inner);
        waiting.writing = true;
        let (text, line) = (std::mem::take(&mut waiting.text), waiting.line.take());
        drop(waiting);
        let mut bytes = Vec::new();
        if shown && !text.is_empty() {
            bytes.extend_from_slice(CLEAR);
        }
        bytes.extend_from_slice(&text);
        shown = line.is_some() || (shown && text.is_empty());
        if let Some(line) = line {
            let width = crossterm::terminal::size().map_or(0, |(width, _)| width);
            // Where it ends, other text may begin.
            bytes.extend_from_slice(format!("\r{}\x1b[K\r", fitted(&line, width)).as_bytes());
        }
        // That nobody reads it is no reason to stop.
        let _ = io::stderr().write_all(&bytes);
    }
}

/// As much of it as a terminal of this width shows in one line; 0 is one that
/// does not know.
fn fitted(line: &str, width: u16) -> String {
    let width = if width == 0 { 80 } else { width };
    line.chars().take(usize::from(width) - 1).collect()
}

fn lock() -> MutexGuard<'static, Waiting> {
    // Nothing panics while it is held.
    WAITING.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_fits_the_terminal_also_one_that_tells_no_width() {
        let line = "x".repeat(200);
        for (width, length) in [(0, 79), (1, 0), (2, 1), (80, 79), (u16::MAX, 200)] {
            assert_eq!(fitted(&line, width).len(), length, "{width}");
        }
    }
}
