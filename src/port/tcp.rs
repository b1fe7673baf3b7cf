//! [`TcpPort`]: a sensor behind a server that passes bytes unchanged.

use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use socket2::{SockRef, TcpKeepalive};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;

use super::dial::connect_first;
use super::lookup::Lookup;
use super::{Port, PortHints};
use crate::BaudRate;

/// TCP connection to a sensor on Ethernet, or to a server that passes bytes to and from a serial line,
/// such as `ser2net` in raw mode or `urg emulate --tcp`. It cannot change the baud rate of that line.
///
/// The system notices a server that has disappeared silently by its [probes](keepalive), six packets of
/// 66 bytes a minute in each direction. The driver's own probe
/// ([`SensorBuilder::idle_probe`](crate::SensorBuilder::idle_probe)) also notices a live server whose
/// sensor does not answer.
#[derive(Debug)]
pub(super) struct TcpPort {
    stream: TcpStream,
    /// `None` for a sensor on Ethernet.
    baud_rate: Option<BaudRate>,
}

impl TcpPort {
    /// Connects to `host` (a name or an address) and `port`, by the first of its addresses that
    /// [accepts](connect_first). `baud_rate` is the serial line's, if there is one.
    ///
    /// Only the system limits the time, to about two minutes on Linux; a
    /// [`Sensor`](crate::Sensor) has its open timeout.
    pub(super) async fn connect(
        lookup: &mut Lookup,
        host: &str,
        port: u16,
        baud_rate: Option<BaudRate>,
    ) -> io::Result<Self> {
        let addresses = lookup.addresses(host, port).await?;
        let stream = connect_first(addresses, connect_to).await?;
        Ok(Self { stream, baud_rate })
    }
}

async fn connect_to(address: SocketAddr) -> io::Result<TcpStream> {
    let stream = TcpStream::connect(address).await?;
    keep_alive(&SockRef::from(&stream), &keepalive());
    // Without it, a command, one small segment, may wait for the acknowledgement of the
    // previous one.
    stream.set_nodelay(true)?;
    Ok(stream)
}

/// Makes the system probe an idle connection. Ignores failures: Windows before version
/// 1703 of Windows 10 refuses the number of probes, and its default is better than no
/// sensor.
fn keep_alive(socket: &SockRef<'_>, settings: &TcpKeepalive) {
    if let Err(error) = socket.set_tcp_keepalive(settings) {
        tracing::debug!(%error, "the system refuses a setting of TCP keepalive");
    }
}

/// Probes a connection after 10 s without traffic, and resets it after three probes without an
/// answer, 5 s apart. Some systems choose the number and the interval of the probes themselves.
fn keepalive() -> TcpKeepalive {
    let settings = TcpKeepalive::new().with_time(Duration::from_secs(10));
    #[cfg(any(
        target_os = "android",
        target_os = "freebsd",
        target_os = "linux",
        target_os = "macos",
        windows
    ))]
    let settings = settings.with_interval(Duration::from_secs(5)).with_retries(3);
    settings
}

impl Port for TcpPort {
    /// Baud rate in the endpoint's address, unless it leads to a sensor on Ethernet.
    fn baud_rate(&self) -> Option<BaudRate> {
        self.baud_rate
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        Some(self)
    }
}

impl PortHints for TcpPort {
    fn can_die_silently(&mut self) -> bool {
        true
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
    #[cfg(target_os = "linux")]
    use tokio::net::TcpSocket;

    use super::*;

    #[tokio::test]
    async fn o22_a_connection_sends_at_once_and_is_kept_alive() -> io::Result<()> {
        let server = tokio::net::TcpListener::bind(("127.0.0.1", 0)).await?;
        let port = server.local_addr()?.port();
        let lookup = &mut Lookup::default();
        let TcpPort { stream, .. } = TcpPort::connect(lookup, "127.0.0.1", port, None).await?;
        assert!(stream.nodelay()?);
        let socket = SockRef::from(&stream);
        assert!(socket.keepalive()?);
        #[cfg(target_os = "linux")]
        assert_eq!(
            (socket.tcp_keepalive_time()?, socket.tcp_keepalive_interval()?),
            (Duration::from_secs(10), Duration::from_secs(5))
        );
        Ok(())
    }

    #[cfg(target_os = "linux")]
    #[tokio::test]
    async fn o27_a_keepalive_setting_that_the_system_refuses_costs_no_connection() -> io::Result<()>
    {
        let socket = TcpSocket::new_v4()?;
        let socket = SockRef::from(&socket);
        let refused = keepalive().with_retries(u32::MAX);
        assert!(socket.set_tcp_keepalive(&refused).is_err());
        socket.set_keepalive(false)?;
        keep_alive(&socket, &refused);
        assert!(socket.keepalive()?, "what the system accepts is in force");
        Ok(())
    }

    /// A server with a full queue of connections does not take part in the handshake,
    /// just like a black-holed address. Linux drops the SYN; other systems refuse.
    #[cfg(target_os = "linux")]
    #[tokio::test]
    async fn o24_a_host_is_reached_though_its_first_address_never_answers() -> io::Result<()> {
        let full = TcpSocket::new_v4()?;
        full.bind(([127, 0, 0, 1], 0).into())?;
        let full = full.listen(0)?;
        let hangs = full.local_addr()?;
        let mut queued = Vec::new();
        while let Ok(connection) =
            tokio::time::timeout(Duration::from_millis(200), TcpStream::connect(hangs)).await
        {
            queued.push(connection?);
        }
        let server = tokio::net::TcpListener::bind(("127.0.0.1", 0)).await?;
        let stream = connect_first(vec![hangs, server.local_addr()?], connect_to).await?;
        assert_eq!(stream.peer_addr()?, server.local_addr()?);
        Ok(())
    }
}
