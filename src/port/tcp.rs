//! Connects to a sensor by TCP, and keeps the connection alive.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use socket2::{SockRef, TcpKeepalive};
use tokio::net::TcpStream;

use super::dial::connect_first;
use super::lookup::Lookup;

/// Connects to a sensor on Ethernet, or to a server that passes bytes to and from a serial line,
/// such as `ser2net` in raw mode or `urg emulate --tcp`. Takes the first address of `host`, a name or
/// an address, that [accepts](connect_first).
///
/// The system notices a server that has disappeared silently by its [probes](keepalive), six packets of
/// 66 bytes a minute in each direction. The driver's own probe
/// ([`SensorBuilder::idle_probe`](crate::SensorBuilder::idle_probe)) also notices a live server whose
/// sensor does not answer.
///
/// Only the system limits the time, to about two minutes on Linux; a
/// [`Sensor`](crate::Sensor) has its open timeout.
pub(super) async fn connect(lookup: &mut Lookup, host: &str, port: u16) -> io::Result<TcpStream> {
    connect_first(lookup.addresses(host, port).await?, connect_to).await
}

async fn connect_to(address: SocketAddr) -> io::Result<TcpStream> {
    let stream = TcpStream::connect(address).await?;
    keep_alive(&SockRef::from(&stream), &keepalive());
    // Without it, a command, one small segment, may wait for the acknowledgement of the previous one.
    stream.set_nodelay(true)?;
    Ok(stream)
}

/// Makes the system probe an idle connection. Ignores failures: Windows before version 1703 of
/// Windows 10 refuses the number of probes, and its default is better than no sensor.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn o22_a_connection_sends_at_once_and_is_kept_alive() -> io::Result<()> {
        let server = tokio::net::TcpListener::bind(("127.0.0.1", 0)).await?;
        let port = server.local_addr()?.port();
        let stream = connect(&mut Lookup::default(), "127.0.0.1", port).await?;
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
        let socket = tokio::net::TcpSocket::new_v4()?;
        let socket = SockRef::from(&socket);
        let refused = keepalive().with_retries(u32::MAX);
        assert!(socket.set_tcp_keepalive(&refused).is_err());
        socket.set_keepalive(false)?;
        keep_alive(&socket, &refused);
        assert!(socket.keepalive()?, "what the system accepts is in force");
        Ok(())
    }
}
