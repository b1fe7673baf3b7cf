//! A stream that somebody else opened, as a port.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use super::{Connect, Port};
use crate::Error;

/// Gives out its stream once.
#[derive(Debug)]
pub(crate) struct Attached<T>(Option<T>);

impl<T> Attached<T> {
    pub(crate) fn new(stream: T) -> Self {
        Self(Some(stream))
    }
}

impl<T> Connect for Attached<T>
where
    T: AsyncRead + AsyncWrite + Send + Unpin + 'static,
{
    type Port = AttachedPort<T>;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        let gone =
            || Error::Disconnected { source: Some(Arc::new(io::ErrorKind::BrokenPipe.into())) };
        self.0.take().map(AttachedPort).ok_or_else(gone)
    }
}

/// A stream of which nothing is known but that bytes go in and out.
#[derive(Debug)]
pub(crate) struct AttachedPort<T>(T);

impl<T: AsyncRead + AsyncWrite + Send + Unpin + 'static> Port for AttachedPort<T> {}

impl<T: AsyncRead + Unpin> AsyncRead for AttachedPort<T> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.0).poll_read(cx, buffer)
    }
}

impl<T: AsyncWrite + Unpin> AsyncWrite for AttachedPort<T> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.0).poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.0).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.0).poll_shutdown(cx)
    }
}
