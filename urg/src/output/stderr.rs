//! Standard error, written by a separate thread, so that a slow reader or a stopped terminal
//! blocks nothing else.

use std::io::{self, IsTerminal, Write};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How long the program waits at exit for a reader that makes no progress.
const SHUTDOWN_GRACE: Duration = Duration::from_secs(1);

/// Capacity of the queue. Drops text that does not fit; only a stopped reader causes that.
const HIGH_WATER_BYTES: usize = 1 << 20;

/// Moves the cursor to the start of the line and erases the line.
const CLEAR_LINE: &[u8] = b"\r\x1b[K";

static STDERR: BackgroundWriter<Stderr> = BackgroundWriter::new(Stderr);

/// Queues complete lines.
pub(crate) fn write(text: &[u8]) {
    STDERR.write(text);
}

/// Shows a line that the next output overwrites, if standard error accepts escape codes.
pub(crate) fn show(line: impl FnOnce() -> String) {
    if accepts_escape_codes() {
        STDERR.show(line());
    }
}

/// Checks whether standard error is a terminal that interprets escape codes. Enables them on
/// a Windows console, which otherwise prints them as text.
pub(crate) fn accepts_escape_codes() -> bool {
    #[cfg(windows)]
    let is_interpreted = crossterm::ansi_support::supports_ansi;
    #[cfg(not(windows))]
    let is_interpreted = || true;
    io::stderr().is_terminal() && is_interpreted()
}

/// Waits until the queue is written, or until the reader has made no progress for a second.
/// A busy machine alone loses no message.
pub(crate) fn finish() {
    STDERR.finish(SHUTDOWN_GRACE);
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

/// File that may block its writer.
trait Sink: Sync + 'static {
    /// Writes all bytes; may block. Ignores errors: standard error is where they would go.
    fn write(&self, bytes: &[u8]);

    /// Checks whether a short write would succeed without blocking.
    fn is_writable(&self) -> bool;
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

/// Original standard error.
struct Stderr;

impl Sink for Stderr {
    fn write(&self, bytes: &[u8]) {
        #[cfg(all(unix, feature = "dds"))]
        if let Some(mut kept) = KEPT.get() {
            let _ = kept.write_all(bytes);
            return;
        }
        let _ = io::stderr().write_all(bytes);
    }

    #[cfg(unix)]
    fn is_writable(&self) -> bool {
        use rustix::event::{PollFd, PollFlags, Timespec, poll};

        let stderr = io::stderr();
        // A pipe without a reader counts as writable too: writing to it does not block.
        let mut fds = [PollFd::new(&stderr, PollFlags::OUT)];
        let now = Timespec { tv_sec: 0, tv_nsec: 0 };
        match poll(&mut fds, Some(&now)) {
            Ok(ready) => ready > 0,
            Err(error) => error == rustix::io::Errno::INTR,
        }
    }

    /// Windows cannot tell.
    #[cfg(not(unix))]
    fn is_writable(&self) -> bool {
        false
    }
}

/// Queue of text, written to a sink by a thread.
struct BackgroundWriter<S> {
    sink: S,
    queue: Mutex<Queue>,
    /// Notified when text is queued, and when it has been written.
    changed: Condvar,
}

struct Queue {
    text: Vec<u8>,
    /// Progress line to show after the text.
    line: Option<String>,
    /// Set while the thread writes.
    writing: bool,
    /// Set once the thread runs.
    started: bool,
}

impl<S: Sink> BackgroundWriter<S> {
    const fn new(sink: S) -> Self {
        let queue = Queue { text: Vec::new(), line: None, writing: false, started: false };
        Self { sink, queue: Mutex::new(queue), changed: Condvar::new() }
    }

    fn write(&'static self, text: &[u8]) {
        let mut queue = self.lock();
        if queue.text.len() + text.len() <= HIGH_WATER_BYTES {
            queue.text.extend_from_slice(text);
            // The line is older than the text.
            queue.line = None;
        }
        self.wake(queue);
    }

    fn show(&'static self, line: String) {
        let mut queue = self.lock();
        queue.line = Some(line);
        self.wake(queue);
    }

    fn wake(&'static self, mut queue: MutexGuard<'_, Queue>) {
        if !queue.started {
            queue.started = true;
            let thread = std::thread::Builder::new().name("stderr".to_owned());
            if thread.spawn(|| self.run()).is_err() {
                // No thread available: write on this one.
                queue.started = false;
                self.sink.write(&std::mem::take(&mut queue.text));
            }
        }
        self.changed.notify_all();
    }

    /// Writes queued text until the program exits.
    fn run(&self) {
        let mut shown = false;
        loop {
            let mut queue = self.lock();
            queue.writing = false;
            self.changed.notify_all();
            let is_empty = |queue: &mut Queue| queue.text.is_empty() && queue.line.is_none();
            let mut queue =
                self.changed.wait_while(queue, is_empty).unwrap_or_else(PoisonError::into_inner);
            queue.writing = true;
            let (text, line) = (std::mem::take(&mut queue.text), queue.line.take());
            drop(queue);
            let mut bytes = Vec::new();
            if shown && !text.is_empty() {
                bytes.extend_from_slice(CLEAR_LINE);
            }
            bytes.extend_from_slice(&text);
            shown = line.is_some() || (shown && text.is_empty());
            if let Some(line) = line {
                let width = crossterm::terminal::size().map_or(0, |(width, _)| width);
                // Leaves the cursor at the start of the line, for other programs' output.
                bytes.extend_from_slice(format!("\r{}\x1b[K\r", fitted(&line, width)).as_bytes());
            }
            self.sink.write(&bytes);
        }
    }

    /// Waits until the text is written, or until the sink has blocked for `grace`. If the sink
    /// is writable, the machine is only busy, so it keeps waiting.
    fn finish(&self, grace: Duration) {
        let unwritten = |queue: &mut Queue| queue.writing || !queue.text.is_empty();
        loop {
            let (queue, waited) = self
                .changed
                .wait_timeout_while(self.lock(), grace, unwritten)
                .unwrap_or_else(PoisonError::into_inner);
            drop(queue);
            if !waited.timed_out() || !self.sink.is_writable() {
                return;
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        // No code panics while holding it.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Cuts `line` to the terminal's width. A width of 0 means unknown.
fn fitted(line: &str, width: u16) -> String {
    let width = if width == 0 { 80 } else { width };
    line.chars().take(usize::from(width) - 1).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::mpsc;

    use super::*;

    /// Sink that blocks until `finish` has asked three times whether it is writable.
    struct Starved {
        asked: Mutex<(usize, mpsc::Sender<()>)>,
        run: Mutex<mpsc::Receiver<()>>,
        written: AtomicBool,
    }

    impl Starved {
        fn leaked() -> &'static BackgroundWriter<Self> {
            let (sender, receiver) = mpsc::channel();
            Box::leak(Box::new(BackgroundWriter::new(Self {
                asked: Mutex::new((0, sender)),
                run: Mutex::new(receiver),
                written: AtomicBool::new(false),
            })))
        }
    }

    impl Sink for Starved {
        fn write(&self, _: &[u8]) {
            self.run.lock().unwrap().recv().unwrap();
            self.written.store(true, Ordering::SeqCst);
        }

        fn is_writable(&self) -> bool {
            let (asked, run) = &mut *self.asked.lock().unwrap();
            *asked += 1;
            if *asked == 3 {
                run.send(()).unwrap();
            }
            true
        }
    }

    #[test]
    fn a_message_is_written_even_if_the_machine_does_not_run_the_thread_for_long() {
        let writer = Starved::leaked();
        writer.write(b"urg: cannot open the port\n");
        writer.finish(Duration::from_millis(1));
        assert!(writer.sink.written.load(Ordering::SeqCst));
    }

    #[test]
    fn a_line_fits_the_terminal_also_one_of_unknown_width() {
        let line = "x".repeat(200);
        for (width, length) in [(0, 79), (1, 0), (2, 1), (80, 79), (u16::MAX, 200)] {
            assert_eq!(fitted(&line, width).len(), length, "{width}");
        }
    }
}
