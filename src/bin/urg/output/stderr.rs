//! Standard error, written by a thread of its own: a reader that is slow, or a
//! terminal that is stopped, blocks nothing else.

use std::io::{self, IsTerminal, Write};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The end of the program waits so long for a reader that takes nothing.
const SHUTDOWN_GRACE: Duration = Duration::from_secs(1);

/// The queue holds no more than this; what does not fit is dropped. Only a
/// reader that takes nothing for long is so far behind.
const HIGH_WATER_BYTES: usize = 1 << 20;

/// Returns to the start of the line and erases it.
const CLEAR_LINE: &[u8] = b"\r\x1b[K";

static STDERR: BackgroundWriter<Stderr> = BackgroundWriter::new(Stderr);

/// Queues whole lines.
pub(crate) fn write(text: &[u8]) {
    STDERR.write(text);
}

/// Shows a line that the next output overwrites. Does nothing unless standard
/// error accepts escape codes.
#[cfg_attr(not(feature = "mcap"), expect(dead_code, reason = "only recording has progress"))]
pub(crate) fn show(line: impl FnOnce() -> String) {
    if accepts_escape_codes() {
        STDERR.show(line());
    }
}

/// Returns true if standard error is a terminal that interprets escape codes. A console
/// of Windows prints them as text until a program switches that on, which this does.
pub(crate) fn accepts_escape_codes() -> bool {
    #[cfg(windows)]
    let is_interpreted = crossterm::ansi_support::supports_ansi;
    #[cfg(not(windows))]
    let is_interpreted = || true;
    io::stderr().is_terminal() && is_interpreted()
}

/// Waits until the queue is written. Abandons only a reader that takes nothing
/// for a second: however busy the machine is, no message is lost.
pub(crate) fn finish() {
    STDERR.finish(SHUTDOWN_GRACE);
}

/// A writer for the log. What is written at once stays together.
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

/// A file that may block its writer.
trait Sink: Sync + 'static {
    /// Writes all of it, however long that takes. There is nobody to report an
    /// error to.
    fn write(&self, bytes: &[u8]);

    /// Returns whether a write of some bytes would not block now.
    fn is_writable(&self) -> bool;
}

/// Standard error, behind the standard library's lock.
struct Stderr;

impl Sink for Stderr {
    fn write(&self, bytes: &[u8]) {
        let _ = io::stderr().write_all(bytes);
    }

    #[cfg(unix)]
    fn is_writable(&self) -> bool {
        use rustix::event::{PollFd, PollFlags, Timespec, poll};

        let stderr = io::stderr();
        // A pipe without a reader counts too: writing to it fails at once.
        let mut fds = [PollFd::new(&stderr, PollFlags::OUT)];
        let now = Timespec { tv_sec: 0, tv_nsec: 0 };
        match poll(&mut fds, Some(&now)) {
            Ok(ready) => ready > 0,
            Err(error) => error == rustix::io::Errno::INTR,
        }
    }

    /// Windows does not report it.
    #[cfg(not(unix))]
    fn is_writable(&self) -> bool {
        false
    }
}

/// A queue of text, and the thread that writes it to a sink.
struct BackgroundWriter<S> {
    sink: S,
    queue: Mutex<Queue>,
    /// Notified when there is something to write, and when it was written.
    changed: Condvar,
}

struct Queue {
    text: Vec<u8>,
    /// A line to show behind the text, until other output overwrites it.
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
            // It describes an earlier state.
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
                // Out of threads: writes here.
                queue.started = false;
                self.sink.write(&std::mem::take(&mut queue.text));
            }
        }
        self.changed.notify_all();
    }

    /// Writes what is queued, for as long as the program runs.
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
                // Ends at the start of the line, where other output may begin.
                bytes.extend_from_slice(format!("\r{}\x1b[K\r", fitted(&line, width)).as_bytes());
            }
            self.sink.write(&bytes);
        }
    }

    /// Waits until the text is written, or until the sink takes nothing for
    /// `grace`. A sink that is writable only waits for the thread, which a busy
    /// machine may keep from running for any time.
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
        // Nothing panics while it is held.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Returns as much of `line` as one line of the terminal shows. A width of 0
/// is one that is not known.
fn fitted(line: &str, width: u16) -> String {
    let width = if width == 0 { 80 } else { width };
    line.chars().take(usize::from(width) - 1).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::mpsc;

    use super::*;

    /// A sink whose thread is let run only when `finish` has asked three times
    /// whether the sink is writable.
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

    /// A sink that blocks its writer for ever.
    struct Stopped;

    impl Sink for Stopped {
        fn write(&self, _: &[u8]) {
            loop {
                std::thread::park();
            }
        }

        fn is_writable(&self) -> bool {
            false
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
    fn a_reader_that_takes_nothing_does_not_keep_the_program_from_ending() {
        static WRITER: BackgroundWriter<Stopped> = BackgroundWriter::new(Stopped);
        WRITER.write(b"urg: cannot open the port\n");
        WRITER.finish(Duration::from_millis(1));
    }

    #[test]
    fn a_line_fits_the_terminal_also_one_of_unknown_width() {
        let line = "x".repeat(200);
        for (width, length) in [(0, 79), (1, 0), (2, 1), (80, 79), (u16::MAX, 200)] {
            assert_eq!(fitted(&line, width).len(), length, "{width}");
        }
    }
}
