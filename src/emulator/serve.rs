//! The emulated sensor on other streams: any `AsyncRead + AsyncWrite`, and TCP.

use std::io;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpListener;

use super::Emulator;
use super::link::{HostBaudRate, Link};
use crate::BaudRate;

impl Emulator {
    /// Serves the sensor on a stream, such as one end of
    /// [`tokio::io::duplex`], until the client leaves or the sensor is
    /// unplugged.
    ///
    /// The stream carries no baud rate, so that nothing is ever garbled; bytes
    /// still take their time. The client that is served replaces any other
    /// link to this sensor.
    ///
    /// Dropping the future ends it and drops the stream; the sensor stays as
    /// it is. Half a command that was read from the stream stays in the
    /// sensor's line buffer, part of a reply may be lost.
    ///
    /// # Errors
    ///
    /// The stream's.
    pub async fn serve<S: AsyncRead + AsyncWrite>(&self, stream: S) -> io::Result<()> {
        pump(stream, self.open(HostBaudRate::Follows)).await
    }

    /// Serves the sensor behind a bridge with a line of its own at a fixed
    /// speed, such as ser2net: as [`serve`](Self::serve), but garbled both ways
    /// while the sensor has another speed.
    ///
    /// # Errors
    ///
    /// The stream's.
    pub async fn serve_at<S: AsyncRead + AsyncWrite>(
        &self,
        stream: S,
        speed: BaudRate,
    ) -> io::Result<()> {
        pump(stream, self.bridge(speed)).await
    }

    /// Serves the sensor to one TCP client at a time. The next one is served
    /// when the one before has left; the sensor's state stays.
    ///
    /// Whoever can connect can use the sensor: bind the listener to
    /// `127.0.0.1` unless others shall. While the sensor is unplugged clients
    /// are hung up at once. A client that fails ends only its own connection.
    ///
    /// Runs until it is dropped, which hangs up the client.
    ///
    /// # Errors
    ///
    /// Those of accepting connections.
    pub async fn serve_tcp(&self, listener: TcpListener) -> io::Result<()> {
        loop {
            let (stream, address) = listener.accept().await?;
            // A reply of several pieces must not wait for acknowledgements.
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

/// Carries bytes between a client and the sensor until either hangs up.
pub(super) async fn pump<S: AsyncRead + AsyncWrite>(stream: S, link: Link) -> io::Result<()> {
    // A client that does not read must not keep the link from ending.
    let replaced = link.replaced();
    let (mut from_client, mut to_client) = tokio::io::split(stream);
    let (mut from_sensor, mut to_sensor) = tokio::io::split(link);
    // Not `copy_bidirectional`: it flushes, and flushing a terminal blocks; it
    // also goes on for as long as one side has not hung up.
    let commands = async {
        let mut buffer = [0; 256];
        loop {
            let count = from_client.read(&mut buffer).await?;
            let bytes = buffer.get(..count).unwrap_or_default();
            if bytes.is_empty() || to_sensor.write_all(bytes).await.is_err() {
                return Ok(());
            }
        }
    };
    let replies = async {
        let mut buffer = [0; 2048];
        loop {
            let count = from_sensor.read(&mut buffer).await?;
            let bytes = buffer.get(..count).unwrap_or_default();
            if bytes.is_empty() {
                return Ok(());
            }
            to_client.write_all(bytes).await?;
        }
    };
    tokio::select! {
        ended = commands => ended,
        ended = replies => ended,
        () = replaced => Ok(()),
    }
}
