//! [`TcpPort`]: a sensor behind a server that passes bytes unchanged.

use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpSocket, TcpStream, lookup_host};

use super::{Endpoint, Port};
use crate::{BaudRate, Error};

/// A TCP connection to a server that passes bytes to and from a sensor, such
/// as `ser2net` in raw mode or `urg emulate --tcp`.
///
/// Telnet servers are not such: they double the byte 0xFF and send commands of
/// their own. The speed of the line behind the server is the server's affair,
/// so [`set_baud_rate`](Port::set_baud_rate) is refused with
/// [`io::ErrorKind::Unsupported`].
///
/// What is written goes out at once (`TCP_NODELAY`), and the system probes an
/// idle connection (`SO_KEEPALIVE`, at the system's intervals, often hours; a
/// server that is gone shows in a missed deadline long before). An end or a
/// reset of the connection is what a read or write returns. Dropping the port
/// closes the connection without waiting.
#[derive(Debug)]
pub struct TcpPort {
    stream: TcpStream,
    baud_rate: BaudRate,
}

impl TcpPort {
    /// Connects to `host` (a name or an address) and `port`, behind which is a
    /// line at `baud_rate`. A name's addresses are tried one after the other.
    ///
    /// There is no time limit but the system's. Cancel-safe: dropping the
    /// future closes what it has opened.
    ///
    /// # Errors
    ///
    /// [`Error::Open`], which is transient, with the last address's failure as
    /// its source: refused, unreachable, no such host.
    pub async fn connect(host: &str, port: u16, baud_rate: BaudRate) -> Result<Self, Error> {
        match connect(host, port).await {
            Ok(stream) => Ok(Self { stream, baud_rate }),
            Err(source) => {
                let endpoint = Endpoint::Tcp { host: host.to_owned(), port, baud_rate };
                Err(Error::Open { port: endpoint.to_string(), source: Arc::new(source) })
            }
        }
    }
}

async fn connect(host: &str, port: u16) -> io::Result<TcpStream> {
    let mut failure = None;
    for address in lookup_host((host, port)).await? {
        match connect_to(address).await {
            Ok(stream) => return Ok(stream),
            Err(error) => failure = Some(error),
        }
    }
    Err(failure
        .unwrap_or_else(|| io::Error::new(io::ErrorKind::NotFound, "the host has no address")))
}

async fn connect_to(address: SocketAddr) -> io::Result<TcpStream> {
    // Not TcpStream::connect: only a TcpSocket can be told to keep alive.
    let socket = match address {
        SocketAddr::V4(_) => TcpSocket::new_v4()?,
        SocketAddr::V6(_) => TcpSocket::new_v6()?,
    };
    socket.set_keepalive(true)?;
    let stream = socket.connect(address).await?;
    // A command is one small segment and nothing follows it: it must not wait
    // for an acknowledgement.
    stream.set_nodelay(true)?;
    Ok(stream)
}

impl Port for TcpPort {
    /// What the address says.
    fn baud_rate(&self) -> Option<BaudRate> {
        Some(self.baud_rate)
    }
}

impl AsyncRead for TcpPort {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(cx, buf)
    }
}

impl AsyncWrite for TcpPort {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(cx, buf)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn o22_a_connection_sends_at_once_and_is_kept_alive() -> io::Result<()> {
        let server = tokio::net::TcpListener::bind(("127.0.0.1", 0)).await?;
        let stream = connect("127.0.0.1", server.local_addr()?.port()).await?;
        assert!(stream.nodelay()?);
        assert!(TcpSocket::from_std_stream(stream.into_std()?).keepalive()?);
        Ok(())
    }
}
