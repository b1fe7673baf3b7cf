//! Standard output: data, and nothing else. A slow reader does not keep the driver from
//! the port.
//!
//! A pipe takes what it reports room for without blocking, so it is written to at once.
//! All other output goes through one of tokio's blocking threads: a stopped terminal or a
//! stalled disk may block. The way to that thread and back takes two wake-ups, more than
//! the driver's work on a scan.

use std::io::{self, Write};

use tokio::task::spawn_blocking;

use crate::failure::Failure;

/// Standard output.
#[derive(Debug)]
pub(crate) struct Output {
    reports_room: bool,
}

impl Output {
    pub(crate) fn new() -> Self {
        Self { reports_room: room::is_reported() }
    }

    /// Writes `text`, and waits until the system has taken it.
    pub(crate) async fn write(&mut self, text: &str) -> Result<(), Failure> {
        let mut rest = text.as_bytes();
        let mut written = Ok(());
        if self.reports_room {
            written = room::fill(&mut rest);
        }
        if written.is_ok() && !rest.is_empty() {
            let rest = rest.to_vec();
            written = spawn_blocking(move || {
                let mut stdout = io::stdout().lock();
                stdout.write_all(&rest)?;
                // Without it an error would show only with the next write.
                stdout.flush()
            })
            .await
            .unwrap_or_else(|panicked| Err(panicked.into()));
        }
        written.map_err(|error| failure(&error))
    }
}

/// Writes the whole output of a command at once.
pub(crate) async fn print(text: &str) -> Result<(), Failure> {
    Output::new().write(text).await
}

/// Maps an error of standard output to the way in which the program ends.
pub(crate) fn failure(error: &io::Error) -> Failure {
    match error.kind() {
        io::ErrorKind::BrokenPipe => Failure::PipeClosed,
        _ => Failure::of("cannot write to standard output", error),
    }
}

#[cfg(unix)]
mod room {
    use std::fs::File;
    use std::io::{self, IsTerminal};
    use std::os::fd::AsFd;
    use std::os::unix::fs::FileTypeExt;

    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    use rustix::io::Errno;

    /// The number of bytes that a pipe takes at once if it reports room (`PIPE_BUF`).
    const PIPE_BYTES: usize =
        if cfg!(any(target_os = "linux", target_os = "android")) { 4096 } else { 512 };

    /// Returns true if standard output is a pipe, or a device such as `/dev/null`. A file
    /// always reports room, and a terminal also if it has less than is written.
    pub(super) fn is_reported() -> bool {
        let stdout = io::stdout();
        let file = stdout.as_fd().try_clone_to_owned().map(File::from);
        let kind = file.and_then(|file| file.metadata()).map(|metadata| metadata.file_type());
        kind.is_ok_and(|kind| kind.is_fifo() || kind.is_char_device() && !stdout.is_terminal())
    }

    /// Writes as much as standard output has room for, and leaves the rest.
    pub(super) fn fill(rest: &mut &[u8]) -> io::Result<()> {
        let stdout = io::stdout();
        while !rest.is_empty() {
            let mut fds = [PollFd::new(&stdout, PollFlags::OUT)];
            let now = Timespec { tv_sec: 0, tv_nsec: 0 };
            if poll(&mut fds, Some(&now)) == Ok(0) {
                break;
            }
            let piece = rest.get(..PIPE_BYTES).unwrap_or(rest);
            match rustix::io::write(&stdout, piece) {
                Ok(written) => *rest = rest.get(written..).unwrap_or_default(),
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => break,
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }
}

/// Windows does not report it.
#[cfg(not(unix))]
mod room {
    use std::io;

    pub(super) fn is_reported() -> bool {
        false
    }

    pub(super) fn fill(_: &mut &[u8]) -> io::Result<()> {
        Ok(())
    }
}
