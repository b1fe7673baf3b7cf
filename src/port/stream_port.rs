//! [`StreamPort`]: any stream as a port.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use super::{Port, PortHints};
use crate::BaudRate;

/// Any stream of bytes as a [`Port`] without a baud rate.
///
/// Use it in your own [`Connect`](super::Connect), which has an example. Dropping it drops the stream.
#[derive(Debug)]
pub struct StreamPort<T> {
    pub(super) stream: T,
    pub(super) baud_rate: Option<BaudRate>,
    pub(super) can_die_silently: bool,
}

impl<T> StreamPort<T> {
    /// Creates a port from an open stream. The driver does not probe it while it is idle: if it can fail
    /// silently, as TCP can, set an [idle probe](crate::SensorBuilder::idle_probe).
    pub fn new(stream: T) -> Self {
        Self { stream, baud_rate: None, can_die_silently: false }
    }
}

impl<T: AsyncRead + AsyncWrite + Send + Unpin + 'static> Port for StreamPort<T> {
    fn baud_rate(&self) -> Option<BaudRate> {
        self.baud_rate
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        Some(self)
    }
}

impl<T> PortHints for StreamPort<T> {
    fn can_die_silently(&mut self) -> bool {
        self.can_die_silently
    }
}

impl<T: AsyncRead + Unpin> AsyncRead for StreamPort<T> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(cx, buffer)
    }
}

impl<T: AsyncWrite + Unpin> AsyncWrite for StreamPort<T> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}
