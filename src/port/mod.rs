//! Ports, through which a driver reaches its sensor: the traits [`Port`] and
//! [`Connect`], which opens one, and [`Endpoint`], which names one.

mod any_connect;
mod attached;
mod connector;
mod dial;
mod endpoint;
#[cfg(feature = "serial")]
mod list;
#[cfg(feature = "serial")]
mod open_error;
#[cfg(feature = "serial")]
mod search;
#[cfg(feature = "serial")]
mod serial;
mod stream_port;
mod tcp;
#[cfg(all(feature = "serial", unix))]
mod tty;

use std::future::Future;
use std::io;
use std::time::SystemTime;

use tokio::io::{AsyncRead, AsyncWrite};

use crate::{BaudRate, Error};

pub(crate) use any_connect::AnyConnect;
pub(crate) use attached::Attached;
pub use connector::EndpointConnector;
pub use endpoint::Endpoint;
#[cfg(feature = "serial")]
pub use list::{PortInfo, UsbId, list};
#[cfg(feature = "serial")]
pub use serial::SerialPort;
pub use stream_port::StreamPort;
pub use tcp::TcpPort;

/// A byte stream to a sensor.
///
/// [`StreamPort`] turns any `AsyncRead + AsyncWrite` into one, and
/// [`Sensor::attach`](crate::Sensor::attach) does so for you. Implement this trait if
/// the stream has a baud rate that the driver should know or change.
///
/// The driver never calls `poll_flush`: a port has to send written bytes without it.
/// After the first `Ok(0)` or error of a read the driver drops the port. All methods
/// are called in the driver's task and must not block.
pub trait Port: AsyncRead + AsyncWrite + Send + Unpin + 'static {
    /// Returns the baud rate of the serial line to the sensor, or `None` if the line
    /// has none, as on USB. Deadlines are computed from it.
    fn baud_rate(&self) -> Option<BaudRate> {
        None
    }

    /// Sets this side's baud rate. The driver calls it when the sensor changes its
    /// own, and to search for the baud rate of the sensor.
    ///
    /// # Errors
    ///
    /// Must fail if the baud rate is not in force afterwards. `ErrorKind::Unsupported`
    /// (the default) means that this port cannot change its baud rate at all; the
    /// driver then leaves that of the sensor alone, too.
    fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        let _ = baud_rate;
        Err(io::ErrorKind::Unsupported.into())
    }

    /// Returns the wall clock at which the bytes that are read now arrived, for
    /// [`Scan::stamp`](crate::Scan::stamp): the system's, unless the port replays
    /// bytes of another time.
    fn wall_clock(&self) -> SystemTime {
        SystemTime::now()
    }

    /// Reads the bytes that the system has by now, without waiting for the runtime's
    /// I/O driver to report them. Before each command the driver uses it to drop
    /// pending bytes; without it, it has to yield to the runtime once. Returns `None`
    /// (the default) if the port cannot do this.
    ///
    /// # Errors
    ///
    /// Fails with `ErrorKind::WouldBlock` if the system has no bytes, and otherwise as
    /// a read does.
    fn try_read(&mut self, buffer: &mut [u8]) -> Option<io::Result<usize>> {
        let _ = buffer;
        None
    }

    /// Stops waking the driver for bytes that arrive, until the next `poll_read`. That
    /// one must first read what the system has by then, and wake the driver for later
    /// bytes again. Returns whether the port can do this; `false` is the default.
    ///
    /// The driver calls it, after a `poll_read` that returned `Pending`, while the rest
    /// of a reply still takes some milliseconds. A serial line delivers a scan in 20 to
    /// 100 pieces, each of which would wake the driver.
    fn suspend_wakeups(&mut self) -> bool {
        false
    }

    /// Returns true if the link can be lost without a failing read or write, as a TCP
    /// connection or an RS-232 line. The driver then probes the sensor while it is idle
    /// ([`SensorBuilder::idle_probe`](crate::SensorBuilder::idle_probe)). `false` is the
    /// default.
    fn can_die_silently(&self) -> bool {
        false
    }

    /// Returns true if the link has come to its end for good, as that of a recording
    /// behind its last scan. Called after a read or a write has failed or the stream has
    /// ended. The driver then ends instead of reconnecting: after `Ok(0)` without an
    /// error, otherwise with the error of the read or write. `false` is the default.
    fn is_over(&self) -> bool {
        false
    }

    /// Drops bytes that were written and are not on the line yet, so that closing the
    /// port does not wait for them. Called once, before the port is dropped.
    fn discard_output(&mut self) {}
}

impl<P: Port + ?Sized> Port for Box<P> {
    fn baud_rate(&self) -> Option<BaudRate> {
        (**self).baud_rate()
    }

    fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        (**self).set_baud_rate(baud_rate)
    }

    fn wall_clock(&self) -> SystemTime {
        (**self).wall_clock()
    }

    fn try_read(&mut self, buffer: &mut [u8]) -> Option<io::Result<usize>> {
        (**self).try_read(buffer)
    }

    fn suspend_wakeups(&mut self) -> bool {
        (**self).suspend_wakeups()
    }

    fn can_die_silently(&self) -> bool {
        (**self).can_die_silently()
    }

    fn is_over(&self) -> bool {
        (**self).is_over()
    }

    fn discard_output(&mut self) {
        (**self).discard_output();
    }
}

/// A way to open a port: called once at first, and again after each loss of the
/// link.
///
/// ```
/// # #[cfg(all(unix, feature = "emulator"))] {
/// use std::path::PathBuf;
/// use std::sync::Arc;
/// use tokio::net::UnixStream;
/// use tokio_scip::port::{Connect, StreamPort};
/// use tokio_scip::{Error, Sensor};
///
/// /// A sensor behind a Unix socket.
/// struct Socket(PathBuf);
///
/// impl Connect for Socket {
///     type Port = StreamPort<UnixStream>;
///
///     async fn connect(&mut self) -> Result<StreamPort<UnixStream>, Error> {
///         let stream = UnixStream::connect(&self.0).await.map_err(|error| Error::Open {
///             port: self.0.display().to_string(),
///             source: Arc::new(error),
///         })?;
///         Ok(StreamPort::new(stream))
///     }
/// }
///
/// # #[tokio::main(flavor = "current_thread")]
/// # async fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let folder = std::env::temp_dir().join(format!("scip-socket-{}", std::process::id()));
/// # std::fs::create_dir_all(&folder)?;
/// # let path = folder.join("sensor");
/// # let listener = tokio::net::UnixListener::bind(&path)?;
/// # tokio::spawn(async move {
/// #     let emulator = tokio_scip::emulator::Emulator::default();
/// #     while let Ok((client, _)) = listener.accept().await {
/// #         let _ = emulator.serve(client).await;
/// #     }
/// # });
/// let sensor = Sensor::builder().connect(Socket(path)).await?;
/// # assert_eq!(sensor.version().await?.product, "SOKUIKI Sensor URG-04LX");
/// # std::fs::remove_dir_all(folder)?;
/// # Ok(())
/// # }
/// # main().unwrap();
/// # }
/// ```
pub trait Connect: Send + 'static {
    /// The type of the port.
    type Port: Port;

    /// Opens the port. Must not send anything.
    ///
    /// The future must be cancel-safe: it is dropped if the driver ends or the open
    /// timeout has passed.
    ///
    /// # Errors
    ///
    /// Fails with an error of opening, such as [`Error::NoSuchPort`] or
    /// [`Error::Open`]. If [`Error::is_transient`] is true for it, a driver that waits
    /// for its sensor tries again.
    fn connect(&mut self) -> impl Future<Output = Result<Self::Port, Error>> + Send;

    /// Returns the name of the port for logs and error messages, if it has one.
    fn name(&self) -> Option<&str> {
        None
    }

    /// Returns whether there is another candidate, after the port that was opened last
    /// turned out to have no sensor or another one. If true, the driver calls
    /// [`connect`](Self::connect) again at once; if false (the default), it backs off
    /// first.
    fn has_more(&self) -> bool {
        false
    }

    /// Accepts the port that was opened last: it has the right sensor. The next
    /// [`connect`](Self::connect), after a loss of the link, begins with the first
    /// candidate again.
    fn found(&mut self) {}

    /// Returns the serial number (`SERI:`) that the sensor must have, or `None` (the
    /// default) if any sensor is accepted.
    fn expected_serial_number(&self) -> Option<&str> {
        None
    }
}
