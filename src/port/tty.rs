//! [`Tty`]: the bytes of a serial port on Unix, with no wake-up that does nothing.

use std::future::Future;
use std::io::{self, Read as _, Write as _};
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use mio_serial::SerialStream;
use tokio::io::unix::AsyncFd;
use tokio::io::{Interest, ReadBuf};
use tokio::time::{Sleep, sleep};
use tokio_serial::{ClearBuffer, SerialPort as _, SerialPortBuilder};

/// How much is read at once, at most. All of it is initialised first, and no
/// reply of a sensor is longer.
const MAX_READ: usize = 2048;
/// Whether a read that fills less than its room has taken all there was, and what
/// comes later is told of: so it is with ttys and epoll.
const SHORT_IS_ALL: bool = cfg!(any(target_os = "linux", target_os = "android"));
/// When a port that takes no more is tried again: about as long as the slowest
/// line takes for a command.
const RETRY: Duration = Duration::from_millis(5);

/// A serial port that wakes its reader when there is something to read, and
/// nobody else.
///
/// tokio-serial's stream also watches for room to write. The system tells of
/// that after each write, and again when the line has sent it: two wake-ups for
/// each command, in which nobody has anything to do. A port takes a command at
/// once but for the rarest case, which here is waited for by the clock.
#[derive(Debug)]
pub(super) struct Tty {
    fd: AsyncFd<SerialStream>,
    /// The port took no more; until then it is left alone.
    retry: Option<Pin<Box<Sleep>>>,
}

impl Tty {
    pub(super) fn open(builder: &SerialPortBuilder) -> tokio_serial::Result<Self> {
        let port = SerialStream::open(builder)?;
        #[allow(deprecated, reason = "deprecated for types that may close their file early")]
        let fd = AsyncFd::with_interest(port, Interest::READABLE)?;
        Ok(Self { fd, retry: None })
    }

    pub(super) fn baud_rate(&self) -> tokio_serial::Result<u32> {
        self.fd.get_ref().baud_rate()
    }

    pub(super) fn set_baud_rate(&mut self, baud_rate: u32) -> tokio_serial::Result<()> {
        self.fd.get_mut().set_baud_rate(baud_rate)
    }

    pub(super) fn clear(&self, buffer: ClearBuffer) -> tokio_serial::Result<()> {
        self.fd.get_ref().clear(buffer)
    }

    /// Reads what the system has by now, whatever the runtime has been told.
    pub(super) fn try_read(&self, bytes: &mut [u8]) -> io::Result<usize> {
        self.fd.get_ref().read(bytes)
    }

    /// As [`AsyncRead::poll_read`](tokio::io::AsyncRead::poll_read).
    pub(super) fn poll_read(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let room = buffer.remaining().min(MAX_READ);
        loop {
            let mut guard = ready!(self.fd.poll_read_ready(cx))?;
            let read = guard.try_io(|fd| fd.get_ref().read(buffer.initialize_unfilled_to(room)));
            match read {
                Ok(Ok(read)) => {
                    buffer.advance(read);
                    if SHORT_IS_ALL && (1..room).contains(&read) {
                        guard.clear_ready();
                    }
                    return Poll::Ready(Ok(()));
                }
                Ok(Err(error)) => return Poll::Ready(Err(error)),
                Err(_would_block) => {}
            }
        }
    }

    /// As [`AsyncWrite::poll_write`](tokio::io::AsyncWrite::poll_write).
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
            match self.fd.get_ref().write(bytes) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    self.retry = Some(Box::pin(sleep(RETRY)));
                }
                outcome => return Poll::Ready(outcome),
            }
        }
    }
}
