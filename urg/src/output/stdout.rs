//! Standard output: data only. A slow reader does not block the driver.

use std::io::{self, Write};

use tokio::task::spawn_blocking;

use crate::failure::Failure;

/// Writes `text`, and waits until the system has accepted it.
///
/// What a pipe has room for, this thread writes itself: a trip to another thread and back takes two
/// wake-ups, more than the driver's work on a scan. One of tokio's blocking threads writes the rest.
pub(crate) async fn print(text: impl Into<String>) -> Result<(), Failure> {
    let text = text.into();
    let mut rest = text.as_bytes();
    let mut written = fill(&mut rest);
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

/// Writes as much as fits without blocking, in one call. `rest` keeps the remainder.
#[cfg(any(target_os = "linux", target_os = "android"))]
fn fill(rest: &mut &[u8]) -> io::Result<()> {
    use rustix::io::{Errno, ReadWriteFlags, pwritev2};

    loop {
        // An offset of -1 stands for none, which a pipe does not have.
        let whole = [io::IoSlice::new(rest)];
        match pwritev2(io::stdout(), &whole, u64::MAX, ReadWriteFlags::NOWAIT) {
            Ok(written) => *rest = rest.get(written..).unwrap_or_default(),
            Err(Errno::INTR) => continue,
            // Full, or a terminal or an older system, which cannot tell.
            Err(Errno::AGAIN | Errno::OPNOTSUPP | Errno::NOSYS) => {}
            Err(error) => return Err(error.into()),
        }
        return Ok(());
    }
}

/// Only Linux can tell how much fits.
#[cfg(not(any(target_os = "linux", target_os = "android")))]
fn fill(_: &mut &[u8]) -> io::Result<()> {
    Ok(())
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
        .is_ok_and(|out| stat("/dev/null").is_ok_and(|null| null.st_rdev == out.st_rdev));
    is_null && fcntl_getfl(&stdout).is_ok_and(|flags| flags & OFlags::RWMODE == OFlags::RDWR)
}

/// Windows has no such redirection.
#[cfg(not(unix))]
pub(crate) fn is_closed() -> bool {
    false
}
