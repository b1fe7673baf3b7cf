//! Serves an emulated sensor on any `AsyncRead + AsyncWrite`, on TCP, and on a pseudo-terminal.

#[cfg(all(unix, feature = "pty"))]
mod pty;

use std::io;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpListener;

use super::handle::Emulator;
use super::link::{HostBaudRate, Link};

#[cfg(all(unix, feature = "pty"))]
pub use self::pty::Pty;

impl Emulator {
    /// Serves the sensor on a stream, such as one end of [`tokio::io::duplex`], until the
    /// client closes it or you unplug the sensor.
    ///
    /// The stream has no baud rate, so bytes are never garbled. They still take their
    /// time. The client replaces any other link to this sensor.
    ///
    /// Dropping the future drops the stream and leaves the sensor as it is. Half a
    /// command that was read from the stream stays in the sensor's line buffer; part of a
    /// reply may be lost.
    ///
    /// # Errors
    ///
    /// The errors of the stream.
    pub async fn serve<S: AsyncRead + AsyncWrite>(&self, stream: S) -> io::Result<()> {
        pump(stream, self.open(HostBaudRate::FollowsSensor)).await
    }

    /// Serves the sensor to one TCP client at a time, and to the next one when the
    /// connection closes. The sensor keeps its state.
    ///
    /// There is no access control: bind the listener to `127.0.0.1` unless other machines
    /// should use the sensor. While the sensor is unplugged, clients are disconnected at
    /// once. An error of one client ends only its own connection.
    ///
    /// Runs until you drop the future, which disconnects the client.
    ///
    /// # Errors
    ///
    /// The errors of accepting connections.
    pub async fn serve_tcp(&self, listener: TcpListener) -> io::Result<()> {
        loop {
            let (stream, address) = listener.accept().await?;
            // Without it the second piece of a reply waits for an acknowledgement.
            let served = match stream.set_nodelay(true) {
                Ok(()) => self.serve(stream).await,
                Err(error) => Err(error),
            };
            if let Err(error) = served {
                tracing::debug!(%address, %error, "a client of the emulated sensor failed");
            }
        }
    }
}

/// Copies bytes between a client and the sensor until either hangs up.
pub(super) async fn pump<S: AsyncRead + AsyncWrite>(stream: S, link: Link) -> io::Result<()> {
    // Also ends if the client does not read, when the copying below would wait for it.
    let replaced = link.replaced();
    let (from_client, to_client) = tokio::io::split(stream);
    let (from_sensor, to_sensor) = tokio::io::split(link);
    tokio::select! {
        ended = copy(from_client, to_sensor) => match ended {
            // The sensor has hung up.
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
            ended => ended,
        },
        ended = copy(from_sensor, to_client) => ended,
        () = replaced => Ok(()),
    }
}

/// Copies bytes until the end of `from`, any reply in one piece: clients exist that take a piece for
/// a reply. Unlike tokio's `copy` it does not flush, which blocks on a terminal.
async fn copy(mut from: impl AsyncRead + Unpin, mut to: impl AsyncWrite + Unpin) -> io::Result<()> {
    let mut buffer = vec![0; 8192];
    loop {
        let count = from.read(&mut buffer).await?;
        let bytes = buffer.get(..count).unwrap_or_default();
        if bytes.is_empty() {
            return Ok(());
        }
        to.write_all(bytes).await?;
    }
}
