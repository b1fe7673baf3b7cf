//! Standard error, written by a separate thread, so that a slow reader or a stopped terminal
//! blocks nothing else.

use std::io::{self, IsTerminal, Write};
use std::sync::LazyLock;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, SyncSender};
use std::time::Duration;

/// How long the program waits at exit for a reader that makes no progress.
const SHUTDOWN_GRACE: Duration = Duration::from_secs(1);

/// Capacity of the queue, in lines. Drops text that does not fit; only a stopped reader causes
/// that.
const QUEUE_LINES: usize = 10_000;

/// Moves the cursor to the start of the line and erases the line.
const CLEAR_LINE: &[u8] = b"\r\x1b[K";

/// Queue of the thread, which starts with the first output.
static QUEUE: LazyLock<SyncSender<Queued>> = LazyLock::new(|| {
    let (queue, outputs) = mpsc::sync_channel(QUEUE_LINES);
    // Without a thread, each sender writes its own text.
    let _ = std::thread::Builder::new().name("stderr".to_owned()).spawn(|| run(outputs));
    queue
});

enum Queued {
    Text(Vec<u8>),
    /// Line that the next output overwrites.
    Progress(String),
    /// Dropped after all earlier output is written.
    End(Sender<()>),
}

/// Queues complete lines.
pub(crate) fn write(text: &[u8]) {
    if let Err(mpsc::TrySendError::Disconnected(_)) = QUEUE.try_send(Queued::Text(text.to_owned()))
    {
        write_now(text);
    }
}

/// Shows a line that the next output overwrites, if standard error accepts escape codes.
pub(crate) fn show(line: impl FnOnce() -> String) {
    if accepts_escape_codes() {
        let _ = QUEUE.try_send(Queued::Progress(line()));
    }
}

/// Checks whether standard error is a terminal that interprets escape codes. Enables them on
/// a Windows console, which otherwise prints them as text.
pub(crate) fn accepts_escape_codes() -> bool {
    #[cfg(windows)]
    let is_interpreted = crossterm::ansi_support::supports_ansi;
    #[cfg(not(windows))]
    let is_interpreted = || std::env::var_os("TERM").is_none_or(|term| term != "dumb");
    io::stderr().is_terminal() && is_interpreted()
}

/// Waits until the queue is written, or until the reader has made no progress for a second.
/// A busy machine alone loses no message.
pub(crate) fn finish() {
    let (end, written) = mpsc::channel();
    // The queue is full only if its reader has stopped.
    if QUEUE.try_send(Queued::End(end)).is_ok() {
        wait(&written, SHUTDOWN_GRACE, is_writable);
    }
}

/// Waits until the other end of `written` is dropped. Gives up if that takes longer than `grace`
/// and standard error is not writable.
fn wait(written: &Receiver<()>, grace: Duration, mut is_writable: impl FnMut() -> bool) {
    while written.recv_timeout(grace) == Err(RecvTimeoutError::Timeout) && is_writable() {}
}

/// Writer for the log. Each `write` stays in one piece.
pub(crate) struct LogWriter;

impl Write for LogWriter {
    fn write(&mut self, text: &[u8]) -> io::Result<usize> {
        write(text);
        Ok(text.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Writes queued output until the program exits.
fn run(outputs: Receiver<Queued>) {
    let mut has_progress = false;
    for output in outputs {
        match output {
            Queued::Text(text) if std::mem::take(&mut has_progress) => {
                write_now(&[CLEAR_LINE, &text].concat());
            }
            Queued::Text(text) => write_now(&text),
            Queued::Progress(line) => {
                has_progress = true;
                let width = crossterm::terminal::size().map_or(0, |(width, _)| width);
                // Leaves the cursor at the start of the line, for other programs' output.
                write_now(format!("\r{}\x1b[K\r", fitted(&line, width)).as_bytes());
            }
            Queued::End(end) => drop(end),
        }
    }
}

/// Original standard error while [`super::capture`] redirects it.
#[cfg(all(unix, feature = "dds"))]
static KEPT: std::sync::OnceLock<std::fs::File> = std::sync::OnceLock::new();

/// Saves the current standard error for the program's own output.
#[cfg(all(unix, feature = "dds"))]
pub(super) fn keep() -> io::Result<()> {
    use std::os::fd::AsFd;

    if KEPT.get().is_none() {
        let kept = io::stderr().as_fd().try_clone_to_owned()?;
        // Another thread may have set it meanwhile.
        let _ = KEPT.set(kept.into());
    }
    Ok(())
}

/// Gives libraries the original standard error again.
#[cfg(all(unix, feature = "dds"))]
pub(super) fn restore() -> io::Result<()> {
    KEPT.get().map_or(Ok(()), |kept| Ok(rustix::stdio::dup2_stderr(kept)?))
}

/// Writes to the original standard error; may block. Ignores errors: standard error is where
/// they would go.
fn write_now(bytes: &[u8]) {
    #[cfg(all(unix, feature = "dds"))]
    if let Some(mut kept) = KEPT.get() {
        let _ = kept.write_all(bytes);
        return;
    }
    let _ = io::stderr().write_all(bytes);
}

/// Checks whether a short write to standard error would succeed without blocking.
#[cfg(unix)]
fn is_writable() -> bool {
    use rustix::event::{PollFd, PollFlags, Timespec, poll};

    let stderr = io::stderr();
    // A pipe without a reader counts as writable too: writing to it does not block.
    let mut fds = [PollFd::new(&stderr, PollFlags::OUT)];
    let now = Timespec { tv_sec: 0, tv_nsec: 0 };
    poll(&mut fds, Some(&now))
        .map_or_else(|error| error == rustix::io::Errno::INTR, |ready| ready > 0)
}

/// Windows cannot tell.
#[cfg(not(unix))]
fn is_writable() -> bool {
    false
}

/// Cuts `line` to the terminal's width. A width of 0 means unknown.
fn fitted(line: &str, width: u16) -> String {
    let width = if width == 0 { 80 } else { width };
    line.chars().take(usize::from(width) - 1).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_busy_machine_loses_no_message() {
        let (end, written) = mpsc::channel();
        let (mut end, mut checks) = (Some(end), 0);
        wait(&written, Duration::from_millis(1), || {
            checks += 1;
            if checks == 3 {
                end = None;
            }
            true
        });
        assert_eq!(checks, 3);
    }

    #[test]
    fn a_line_fits_the_terminal() {
        let line = "x".repeat(200);
        for (width, length) in [(0, 79), (1, 0), (2, 1), (80, 79), (u16::MAX, 200)] {
            assert_eq!(fitted(&line, width).len(), length, "{width}");
        }
    }
}
