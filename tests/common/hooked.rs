//! A port around another one, with hooks that count its calls or change single ones. For
//! calls that fail, `FaultyLink` serves.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::SystemTime;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio_scip::BaudRate;
use tokio_scip::port::{Port, PortHints};

/// Actions of a test at the calls on a port; by default none.
pub(crate) trait Hooks: Send + Unpin + 'static {
    fn before_read(&mut self) {}

    /// Called with the number of bytes when a read is done, 0 at the end and on errors.
    fn after_read(&mut self, _count: usize) {}

    fn before_write(&mut self, _bytes: &[u8]) {}

    fn on_flush(&mut self) {}

    fn on_discard(&mut self) {}

    fn baud_rate(&self, of_port: Option<BaudRate>) -> Option<BaudRate> {
        of_port
    }

    fn can_die_silently(&self, port_can: bool) -> bool {
        port_can
    }

    fn delivers_intact(&self) -> bool {
        false
    }

    fn wall_clock(&self) -> Option<SystemTime> {
        None
    }
}

/// A port with hooks. It has no `try_read`, so that every read passes the hooks.
pub(crate) struct Hooked<P, H> {
    pub(crate) port: P,
    pub(crate) hooks: H,
}

impl<P: AsyncRead + Unpin, H: Hooks> AsyncRead for Hooked<P, H> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        self.hooks.before_read();
        let before = buffer.filled().len();
        let outcome = Pin::new(&mut self.port).poll_read(cx, buffer);
        if outcome.is_ready() {
            self.hooks.after_read(buffer.filled().len() - before);
        }
        outcome
    }
}

impl<P: AsyncWrite + Unpin, H: Hooks> AsyncWrite for Hooked<P, H> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        self.hooks.before_write(bytes);
        Pin::new(&mut self.port).poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.hooks.on_flush();
        Pin::new(&mut self.port).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.hooks.on_flush();
        Pin::new(&mut self.port).poll_shutdown(cx)
    }
}

impl<P: Port, H: Hooks> Port for Hooked<P, H> {
    fn baud_rate(&self) -> Option<BaudRate> {
        self.hooks.baud_rate(self.port.baud_rate())
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

impl<P: Port, H: Hooks> PortHints for Hooked<P, H> {
    fn can_die_silently(&mut self) -> bool {
        let port_can = self.port.hints().is_some_and(|hints| hints.can_die_silently());
        self.hooks.can_die_silently(port_can)
    }

    fn delivers_intact(&mut self) -> bool {
        self.hooks.delivers_intact()
    }

    fn is_over(&mut self) -> bool {
        self.port.hints().is_some_and(|hints| hints.is_over())
    }

    fn wall_clock(&mut self) -> Option<SystemTime> {
        let of_port = self.port.hints().and_then(|hints| hints.wall_clock());
        self.hooks.wall_clock().or(of_port)
    }

    fn discard_output(&mut self) {
        self.hooks.on_discard();
        if let Some(hints) = self.port.hints() {
            hints.discard_output();
        }
    }
}
