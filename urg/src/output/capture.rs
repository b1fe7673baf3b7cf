//! Captures the lines that a C library writes to standard error, so that the program can
//! filter them. The program's own output still reaches the original standard error.

use std::io;

/// Redirection of standard error into a pipe, undone on drop.
#[derive(Debug)]
pub(crate) struct Capture {
    #[cfg(unix)]
    thread: Option<std::thread::JoinHandle<()>>,
}

#[cfg(unix)]
impl Capture {
    /// Calls `take` with each line, on a separate thread. The only errors are the system's
    /// limits on files and threads.
    pub(crate) fn start(mut take: impl FnMut(&str) + Send + 'static) -> io::Result<Self> {
        use std::io::{BufRead, BufReader};

        super::stderr::keep()?;
        let (reader, writer) = io::pipe()?;
        let thread = std::thread::Builder::new().name("capture".to_owned()).spawn(move || {
            for line in BufReader::new(reader).split(b'\n').map_while(Result::ok) {
                take(&String::from_utf8_lossy(&line));
            }
        })?;
        rustix::stdio::dup2_stderr(&writer)?;
        Ok(Self { thread: Some(thread) })
    }
}

#[cfg(unix)]
impl Drop for Capture {
    /// Restores standard error, and waits until `take` has seen every line.
    fn drop(&mut self) {
        // Until standard error is restored, the pipe stays open and the thread never ends.
        let is_back = super::stderr::restore().is_ok();
        if let Some(thread) = self.thread.take().filter(|_| is_back) {
            // It panics only if `take` does.
            let _ = thread.join();
        }
    }
}

#[cfg(not(unix))]
impl Capture {
    /// Does nothing: on this system the library's lines mix with the program's.
    pub(crate) fn start(_take: impl FnMut(&str) + Send + 'static) -> io::Result<Self> {
        Ok(Self {})
    }
}
