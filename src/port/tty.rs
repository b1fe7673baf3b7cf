//! [`Tty`]: reads and writes of a serial port on Unix, without needless wake-ups.

use std::future::Future;
use std::io::{self, Read as _, Write as _};
use std::os::fd::{AsRawFd as _, RawFd};
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use mio_serial::SerialStream;
use tokio::io::unix::AsyncFd;
use tokio::io::{Interest, ReadBuf};
use tokio::runtime::Handle;
use tokio::time::{Sleep, sleep};
use tokio_serial::{ClearBuffer, SerialPort as _, SerialPortBuilder};

/// Length of the longest read. The buffer is initialised before each read, and no reply is longer.
const MAX_READ_BYTES: usize = 2048;
/// True if a short read proves that the system's buffer is empty and that new bytes re-arm
/// readiness: terminals with edge-triggered epoll.
const SHORT_READ_IS_ALL: bool = cfg!(any(target_os = "linux", target_os = "android"));
/// Delay before retrying a write on a full port: about the time of one command on the slowest line.
const RETRY_INTERVAL: Duration = Duration::from_millis(5);

/// Serial port that is registered for reading only.
///
/// tokio-serial's stream is registered for writing, too. The system then reports room to write after
/// each write, and again when the line has sent it: two needless wake-ups per command. A port's buffer
/// practically always has room for a command; if not, a timer retries the write.
///
/// While wake-ups are suspended, the port is not registered at all: with edge-triggered
/// epoll each piece of a reply wakes the runtime, even if no task waits for it. That costs
/// two calls of `epoll_ctl`, less than one wake-up.
#[derive(Debug)]
pub(super) struct Tty {
    /// Registration with the runtime, or `None` while wake-ups are suspended. Declared
    /// before the port, so dropped while the file is still open.
    readiness: Option<AsyncFd<RawFd>>,
    port: SerialStream,
    /// Runtime that the port was opened in.
    runtime: Handle,
    /// Runs after a write that found the port's buffer full.
    retry: Option<Pin<Box<Sleep>>>,
}

impl Tty {
    pub(super) fn open(builder: &SerialPortBuilder) -> tokio_serial::Result<Self> {
        let port = SerialStream::open(builder)?;
        let mut tty = Self { readiness: None, port, runtime: Handle::current(), retry: None };
        tty.register()?;
        Ok(tty)
    }

    fn register(&mut self) -> io::Result<()> {
        let _context = self.runtime.enter();
        #[allow(deprecated, reason = "deprecated for types that may close their file early")]
        let readiness = AsyncFd::with_interest(self.port.as_raw_fd(), Interest::READABLE)?;
        self.readiness = Some(readiness);
        Ok(())
    }

    /// Stops waking the task for bytes that arrive, until the next [`poll_read`](Self::poll_read).
    pub(super) fn suspend_wakeups(&mut self) {
        self.readiness = None;
    }

    pub(super) fn baud_rate(&self) -> tokio_serial::Result<u32> {
        self.port.baud_rate()
    }

    pub(super) fn set_baud_rate(&mut self, baud_rate: u32) -> tokio_serial::Result<()> {
        self.port.set_baud_rate(baud_rate)
    }

    pub(super) fn clear(&self, buffer: ClearBuffer) -> tokio_serial::Result<()> {
        self.port.clear(buffer)
    }

    pub(super) fn bytes_to_write(&self) -> tokio_serial::Result<u32> {
        self.port.bytes_to_write()
    }

    /// Removes the lock by `TIOCEXCL`, which a pseudo-terminal keeps if the program ends first.
    pub(super) fn unlock(&mut self) {
        // Fails only if the port is gone.
        let _ = self.port.set_exclusive(false);
    }

    /// Reads the bytes that the system has, without the runtime's I/O driver.
    pub(super) fn try_read(&self, bytes: &mut [u8]) -> io::Result<usize> {
        (&self.port).read(bytes)
    }

    /// Reads like [`AsyncRead::poll_read`](tokio::io::AsyncRead::poll_read). If wake-ups are suspended,
    /// reads before it registers: registering first would report bytes that are read already.
    pub(super) fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let room = buffer.remaining().min(MAX_READ_BYTES);
        loop {
            let Self { readiness: Some(readiness), port, .. } = &*self else {
                let read = self.try_read(buffer.initialize_unfilled_to(room));
                let is_all = match &read {
                    Ok(read) => SHORT_READ_IS_ALL && (1..room).contains(read),
                    Err(error) => error.kind() == io::ErrorKind::WouldBlock,
                };
                if is_all {
                    self.register()?;
                }
                match read {
                    Ok(read) => buffer.advance(read),
                    Err(_) if is_all => continue,
                    Err(error) => return Poll::Ready(Err(error)),
                }
                return Poll::Ready(Ok(()));
            };
            let mut guard = ready!(readiness.poll_read_ready(cx))?;
            let mut port = port;
            match guard.try_io(|_| port.read(buffer.initialize_unfilled_to(room))) {
                Ok(Ok(read)) => {
                    buffer.advance(read);
                    if SHORT_READ_IS_ALL && (1..room).contains(&read) {
                        guard.clear_ready();
                    }
                    return Poll::Ready(Ok(()));
                }
                Ok(Err(error)) => return Poll::Ready(Err(error)),
                Err(_would_block) => {}
            }
        }
    }

    /// Writes like [`AsyncWrite::poll_write`](tokio::io::AsyncWrite::poll_write).
    pub(super) fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        loop {
            if let Some(retry) = &mut self.retry {
                ready!(retry.as_mut().poll(cx));
                self.retry = None;
            }
            match (&self.port).write(bytes) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    self.retry = Some(Box::pin(sleep(RETRY_INTERVAL)));
                }
                outcome => return Poll::Ready(outcome),
            }
        }
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_failed_read_during_suspension_is_returned() -> io::Result<()> {
        let (far, near) = serialport::TTYPort::pair()?;
        // The far end of a pseudo-terminal reports a closed near end as an error.
        let port = SerialStream::try_from(far)?;
        let mut tty = Tty { readiness: None, port, runtime: Handle::current(), retry: None };
        drop(near);
        let mut bytes = [0; 8];
        let mut buffer = ReadBuf::new(&mut bytes);
        let mut cx = Context::from_waker(std::task::Waker::noop());
        let read = Pin::new(&mut tty).poll_read(&mut cx, &mut buffer);
        assert!(matches!(read, Poll::Ready(Err(_))), "{read:?}");
        Ok(())
    }
}
