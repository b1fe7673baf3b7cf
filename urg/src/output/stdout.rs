//! Standard output: data only. A slow reader does not block the driver.
//!
//! If a pipe has room, this thread writes to it directly: a trip to another thread and back
//! takes two wake-ups, more than the driver's work on a scan. Terminals and files may block
//! even when they report room, so they are written on one of tokio's blocking threads.

use std::io::{self, Write};

use tokio::task::spawn_blocking;

use crate::failure::Failure;

#[derive(Debug)]
pub(crate) struct Output {
    reports_room: bool,
}

impl Output {
    pub(crate) fn new() -> Self {
        Self { reports_room: room::is_reported() }
    }

    /// Writes `text`, and waits until the system has accepted it.
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
                // Otherwise an error would surface only at the next write.
                stdout.flush()
            })
            .await
            .unwrap_or_else(|panicked| Err(panicked.into()));
        }
        written.map_err(|error| failure(&error))
    }
}

/// Writes the complete output of a command.
pub(crate) async fn print(text: &str) -> Result<(), Failure> {
    Output::new().write(text).await
}

/// Maps an error of standard output to the program's outcome.
pub(crate) fn failure(error: &io::Error) -> Failure {
    match error.kind() {
        io::ErrorKind::BrokenPipe => Failure::PipeClosed,
        _ => Failure::new("cannot write to standard output", error),
    }
}

/// Checks whether standard output was closed, as by `>&-`. Rust has then opened the null device
/// in its place, for reading, too.
#[cfg(unix)]
pub(crate) fn is_closed() -> bool {
    use rustix::fs::{OFlags, fcntl_getfl, fstat, stat};

    let stdout = io::stdout();
    let is_null = fstat(&stdout)
        .is_ok_and(|stdout| stat("/dev/null").is_ok_and(|null| null.st_rdev == stdout.st_rdev));
    is_null && fcntl_getfl(&stdout).is_ok_and(|flags| flags & OFlags::RWMODE == OFlags::RDWR)
}

/// Windows has no such redirection.
#[cfg(not(unix))]
pub(crate) fn is_closed() -> bool {
    false
}

#[cfg(unix)]
mod room {
    use std::fs::File;
    use std::io::{self, IsTerminal};
    use std::os::fd::AsFd;
    use std::os::unix::fs::FileTypeExt;

    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    use rustix::io::Errno;

    /// Bytes that a pipe with room accepts without blocking (`PIPE_BUF`).
    const PIPE_BYTES: usize =
        if cfg!(any(target_os = "linux", target_os = "android")) { 4096 } else { 512 };

    /// Checks whether standard output reports room reliably: a pipe, or a device such as
    /// `/dev/null`. A file always reports room, and a terminal may have less than you write.
    pub(super) fn is_reported() -> bool {
        let stdout = io::stdout();
        let file = stdout.as_fd().try_clone_to_owned().map(File::from);
        let kind = file.and_then(|file| file.metadata()).map(|metadata| metadata.file_type());
        kind.is_ok_and(|kind| kind.is_fifo() || kind.is_char_device() && !stdout.is_terminal())
    }

    /// Writes as much as fits without blocking. `rest` keeps the remainder.
    pub(super) fn fill(rest: &mut &[u8]) -> io::Result<()> {
        let stdout = io::stdout();
        #[cfg(any(target_os = "linux", target_os = "android"))]
        loop {
            use rustix::io::{ReadWriteFlags, pwritev2};

            // One call. An offset of -1 stands for none, which a pipe does not have.
            let whole = [io::IoSlice::new(rest)];
            match pwritev2(&stdout, &whole, u64::MAX, ReadWriteFlags::NOWAIT) {
                Ok(written) => {
                    *rest = rest.get(written..).unwrap_or_default();
                    return Ok(());
                }
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => return Ok(()),
                // An older system, or a device that may block.
                Err(Errno::OPNOTSUPP | Errno::NOSYS) => break,
                Err(error) => return Err(error.into()),
            }
        }
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

/// Windows cannot tell how much room a pipe has.
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
