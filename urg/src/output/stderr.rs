//! Standard error, written by a thread of its own: a slow reader or a stopped terminal blocks no other.

use std::io::{self, IsTerminal, Write};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, SyncSender, TrySendError};
use std::time::Duration;

/// How long the program waits at exit for a reader of standard error that has stopped.
const SHUTDOWN_GRACE: Duration = Duration::from_secs(2);

/// Capacity of the queue, in lines. Drops text that does not fit; only a stopped reader causes that.
const QUEUE_LINES: usize = 10_000;

/// Moves the cursor to the start of the line and erases the line.
const CLEAR_LINE: &[u8] = b"\r\x1b[K";

/// Output that the thread writes.
type Job = Box<dyn FnOnce() + Send>;

/// Queue of the thread, which starts with the first output.
static QUEUE: LazyLock<SyncSender<Job>> = LazyLock::new(|| {
    let (queue, jobs) = mpsc::sync_channel::<Job>(QUEUE_LINES);
    let run = move || jobs.into_iter().for_each(|job| job());
    // Without a thread, each sender writes its own text.
    let _ = std::thread::Builder::new().name("stderr".to_owned()).spawn(run);
    queue
});

/// True while the terminal shows a line that the next output overwrites.
static HAS_PROGRESS: AtomicBool = AtomicBool::new(false);

/// Queues complete lines.
pub(crate) fn write(text: &[u8]) {
    let text = text.to_owned();
    let write = move || {
        if HAS_PROGRESS.swap(false, Ordering::Relaxed) {
            write_now(CLEAR_LINE);
        }
        write_now(&text);
    };
    if let Err(TrySendError::Disconnected(write)) = QUEUE.try_send(Box::new(write)) {
        write();
    }
}

/// Shows a line that the next output overwrites, if standard error accepts escape codes.
pub(crate) fn show(line: impl FnOnce() -> String) {
    if accepts_escape_codes() {
        let line = line();
        let _ = QUEUE.try_send(Box::new(move || {
            HAS_PROGRESS.store(true, Ordering::Relaxed);
            let width =
                terminal_size::terminal_size_of(io::stderr()).map_or(0, |(width, _)| width.0);
            // Leaves the cursor at the start of the line, for other programs' output.
            write_now(format!("\r{}\x1b[K\r", fitted(&line, width)).as_bytes());
        }));
    }
}

/// Checks whether standard error is a terminal that interprets escape codes. Enables them on
/// a Windows console, which otherwise prints them as text.
pub(crate) fn accepts_escape_codes() -> bool {
    #[cfg(windows)]
    let is_interpreted = || anstyle_query::windows::enable_ansi_colors().unwrap_or(false);
    #[cfg(not(windows))]
    let is_interpreted = || std::env::var_os("TERM").is_none_or(|term| term != "dumb");
    io::stderr().is_terminal() && is_interpreted()
}

/// Waits until the queue is written, but not for a reader that has stopped.
pub(crate) fn finish() {
    let (end, written) = mpsc::channel::<()>();
    // The queue is full only if its reader has stopped.
    if QUEUE.try_send(Box::new(move || drop(end))).is_ok() {
        let _ = written.recv_timeout(SHUTDOWN_GRACE);
    }
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

/// Writes to the original standard error; may block. Ignores errors: they would go there.
fn write_now(bytes: &[u8]) {
    #[cfg(all(unix, feature = "dds"))]
    if let Some(mut kept) = KEPT.get() {
        let _ = kept.write_all(bytes);
        return;
    }
    let _ = io::stderr().write_all(bytes);
}

/// Cuts `line` to the terminal's width. A width of 0 means unknown.
fn fitted(line: &str, width: u16) -> String {
    let width = if width == 0 { 80 } else { width };
    line.chars().take(usize::from(width) - 1).collect()
}
