//! A port around another one that reads without waiting and stops its wake-ups when it is
//! asked to, as a serial port of the system does.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, Waker};
use std::time::SystemTime;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio_scip::BaudRate;
use tokio_scip::port::{Port, PortHints};

pub(crate) struct ReadyPort<P> {
    port: P,
    /// Bytes that came while its wake-ups were stopped, and were not read yet.
    ahead: Vec<u8>,
    /// True if it does nothing but pass on.
    is_plain: bool,
}

impl<P> ReadyPort<P> {
    pub(crate) fn new(port: P) -> Self {
        Self { port, ahead: Vec::new(), is_plain: false }
    }

    /// Returns a port without either ability.
    pub(crate) fn plain(port: P) -> Self {
        Self { is_plain: true, ..Self::new(port) }
    }
}

impl<P: AsyncRead + Unpin> AsyncRead for ReadyPort<P> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if self.ahead.is_empty() {
            return Pin::new(&mut self.port).poll_read(cx, buffer);
        }
        let count = self.ahead.len().min(buffer.remaining());
        buffer.put_slice(&self.ahead[..count]);
        self.ahead.drain(..count);
        Poll::Ready(Ok(()))
    }
}

impl<P: AsyncWrite + Unpin> AsyncWrite for ReadyPort<P> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.port).poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.port).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.port).poll_shutdown(cx)
    }
}

impl<P: Port> Port for ReadyPort<P> {
    fn baud_rate(&self) -> Option<BaudRate> {
        self.port.baud_rate()
    }

    fn poll_set_baud_rate(
        &mut self,
        cx: &mut Context<'_>,
        baud_rate: BaudRate,
    ) -> Poll<io::Result<()>> {
        self.port.poll_set_baud_rate(cx, baud_rate)
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        Some(self)
    }
}

impl<P: Port> PortHints for ReadyPort<P> {
    fn try_read(&mut self, bytes: &mut [u8]) -> Option<io::Result<usize>> {
        if self.is_plain {
            return None;
        }
        let mut buffer = ReadBuf::new(bytes);
        let outcome =
            Pin::new(self).poll_read(&mut Context::from_waker(Waker::noop()), &mut buffer);
        Some(match outcome {
            Poll::Ready(outcome) => outcome.map(|()| buffer.filled().len()),
            Poll::Pending => Err(io::ErrorKind::WouldBlock.into()),
        })
    }

    fn suspend_wakeups(&mut self) -> bool {
        if self.is_plain {
            return false;
        }
        // Puts a waker that wakes nobody in the place of the driver's.
        let mut bytes = [0; 64];
        match self.try_read(&mut bytes) {
            Some(Ok(count @ 1..)) => {
                self.ahead.extend_from_slice(&bytes[..count]);
                false
            }
            Some(Err(error)) => error.kind() == io::ErrorKind::WouldBlock,
            // The end, which the next read finds again.
            _ => false,
        }
    }

    fn wall_clock(&mut self) -> Option<SystemTime> {
        self.port.hints().and_then(PortHints::wall_clock)
    }

    fn can_die_silently(&mut self) -> bool {
        self.port.hints().is_some_and(PortHints::can_die_silently)
    }

    fn is_over(&mut self) -> bool {
        self.port.hints().is_some_and(PortHints::is_over)
    }

    fn discard_output(&mut self) {
        if let Some(hints) = self.port.hints() {
            hints.discard_output();
        }
    }
}
