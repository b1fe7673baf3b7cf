//! The port of whatever tests make up for the far end of a link: a [`FarEnd`] says what a
//! read or a write does.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio_scip::BaudRate;
use tokio_scip::port::{Port, PortHints};

/// What a test has in place of a sensor and its line. Unless it says otherwise it accepts whatever is
/// written, and has neither a baud rate nor hints.
pub(crate) trait FarEnd: Send + Unpin + 'static {
    fn read(&mut self, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>>;

    fn write(&mut self, _: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Poll::Ready(Ok(bytes.len()))
    }

    fn baud_rate(&self) -> Option<BaudRate> {
        None
    }

    fn set_baud_rate(&mut self, _: BaudRate) -> io::Result<()> {
        Err(io::ErrorKind::Unsupported.into())
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        None
    }
}

/// Port to a far end.
#[derive(Debug, Default)]
pub(crate) struct TestPort<E>(pub(crate) E);

impl<E: FarEnd> AsyncRead for TestPort<E> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        self.0.read(cx, buffer)
    }
}

impl<E: FarEnd> AsyncWrite for TestPort<E> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        self.0.write(cx, bytes)
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        panic!("flushing a serial port blocks");
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        panic!("shutting a serial port down flushes it");
    }
}

impl<E: FarEnd> Port for TestPort<E> {
    fn baud_rate(&self) -> Option<BaudRate> {
        self.0.baud_rate()
    }

    fn poll_set_baud_rate(
        &mut self,
        _: &mut Context<'_>,
        baud_rate: BaudRate,
    ) -> Poll<io::Result<()>> {
        Poll::Ready(self.0.set_baud_rate(baud_rate))
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        self.0.hints()
    }
}
