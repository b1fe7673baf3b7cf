//! What a driver talks through: [`Port`], how one is opened ([`Connect`]), and
//! the ways to name one ([`Endpoint`]).

mod attached;
mod connector;
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
/// Any `AsyncRead + AsyncWrite` can be one: [`StreamPort`] makes one of it, and
/// [`Sensor::attach`](crate::Sensor::attach) does so by itself. Implement this
/// trait where the stream has a baud rate that the driver should know of or
/// change.
///
/// The driver never calls `poll_flush`, so that what is written has to go out by
/// itself; it stops using a port after the first `Ok(0)` or error, and then drops
/// it. All methods are called in the driver's task and must not block.
pub trait Port: AsyncRead + AsyncWrite + Send + Unpin + 'static {
    /// The baud_rate of the serial line to the sensor, or `None` where none
    /// matters, as on USB. Deadlines are computed from it.
    fn baud_rate(&self) -> Option<BaudRate> {
        None
    }

    /// Sets this side's baud rate. The driver calls it when the sensor was
    /// told to change its own, and to find out which one the sensor has.
    ///
    /// # Errors
    ///
    /// Any, if the baud_rate is not in force afterwards; it must be in force after
    /// `Ok`. `ErrorKind::Unsupported` (the default) means that this port cannot
    /// change its baud_rate at all; the sensor's is then left alone, too.
    fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        let _ = baud_rate;
        Err(io::ErrorKind::Unsupported.into())
    }

    /// The wall clock when what is read now arrived, for
    /// [`Scan::stamp`](crate::Scan::stamp): the system's, unless the port plays
    /// what arrived at another time.
    fn wall_clock(&self) -> SystemTime {
        SystemTime::now()
    }

    /// Reads what the system has by now, whatever the runtime has been told of it,
    /// so that the driver needs no turn of the runtime to know that a line is
    /// quiet. `None` (the default): this port cannot.
    ///
    /// # Errors
    ///
    /// `ErrorKind::WouldBlock` if the system has nothing; otherwise as a read.
    fn try_read(&mut self, buffer: &mut [u8]) -> Option<io::Result<usize>> {
        let _ = buffer;
        None
    }

    /// Throws away what was written and is not on the line yet, so that closing
    /// the port does not wait for it. Called once, before the port is dropped.
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

    fn discard_output(&mut self) {
        (**self).discard_output();
    }
}

/// Opens ports: once at first, and again whenever the link was lost.
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
    /// What it opens.
    type Port: Port;

    /// Opens the port, with nothing sent yet.
    ///
    /// The future may be dropped at any await, and is when the driver ends or
    /// the open timeout has passed; it must be cancel-safe.
    ///
    /// # Errors
    ///
    /// The errors of opening, such as [`Error::NoSuchPort`] or
    /// [`Error::Open`]; [`Error::is_transient`] decides whether the driver
    /// waits for the port to appear where it was asked to.
    fn connect(&mut self) -> impl Future<Output = Result<Self::Port, Error>> + Send;

    /// After a port led to no sensor, or to another one: whether to
    /// [`connect`](Self::connect) again at once, which opens a further port or
    /// says that none is left. `false` (the default) means to back off first.
    fn has_more(&self) -> bool {
        false
    }

    /// Told when the port that was opened last leads to the right sensor: the
    /// next [`connect`](Self::connect), after the link was lost, starts over.
    fn found(&mut self) {}

    /// The serial number (`SERI:`) that the sensor must have, if any will not
    /// do.
    fn expected_serial_number(&self) -> Option<&str> {
        None
    }
}
