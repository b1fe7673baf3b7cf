//! Ports, through which a driver reaches its sensor. [`Connect`] opens one, and [`Endpoint`] names it.
//!
//! You need none of this for serial ports and TCP: pass their name to
//! [`Sensor::open`](crate::Sensor::open). For a transport of your own, open a stream in a closure:
//!
//! ```no_run
//! use tokio::net::TcpStream;
//! use tokio_scip::port::StreamPort;
//! use tokio_scip::{Error, Sensor};
//!
//! # async fn open() -> Result<(), Error> {
//! let sensor = Sensor::builder()
//!     .connect(|| async {
//!         let stream = TcpStream::connect("robot:2000").await;
//!         Ok(StreamPort::new(stream.map_err(|error| Error::open("robot", error))?))
//!     })
//!     .await?;
//! # Ok(())
//! # }
//! ```

mod any_connect;
mod connector;
#[cfg(feature = "tcp")]
mod dial;
mod endpoint;
mod hints;
#[cfg(feature = "serial")]
mod list;
#[cfg(feature = "tcp")]
mod lookup;
#[cfg(feature = "serial")]
mod open_error;
#[cfg(feature = "serial")]
mod search;
#[cfg(feature = "serial")]
mod serial;
mod stream_port;
#[cfg(feature = "tcp")]
mod tcp;
#[cfg(any(feature = "serial", feature = "tcp"))]
mod thread;
#[cfg(all(feature = "serial", unix))]
mod tty;

use std::future::Future;
use std::io;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite};

use crate::{BaudRate, Error};

pub(crate) use any_connect::AnyConnect;
#[doc(no_inline)]
pub use endpoint::Endpoint;
#[doc(hidden)]
pub use hints::ConnectHints;
pub use hints::PortHints;
#[cfg(feature = "serial")]
pub use list::{PortInfo, list};
pub use stream_port::StreamPort;

/// Byte stream to a sensor.
///
/// [`StreamPort`] turns any `AsyncRead + AsyncWrite` into one, and
/// [`attach`](crate::SensorBuilder::attach) does so for you. Implement this trait if
/// the stream has a baud rate that the driver should know or change. Everything else that
/// a port may tell the driver is optional: [`PortHints`].
///
/// The driver never calls `poll_flush`: send written bytes without it. After the first `Ok(0)` or error
/// of a read, the driver drops the port. It calls all methods in its task, so they must not block.
pub trait Port: AsyncRead + AsyncWrite + Send + Unpin + 'static {
    /// Baud rate of the serial line to the sensor, or `None` if the line has none, as on
    /// USB. The driver computes deadlines from it.
    fn baud_rate(&self) -> Option<BaudRate> {
        None
    }

    /// Sets this side's baud rate. The driver calls it when the sensor changes its own, and
    /// to search for the sensor's baud rate, again until it is ready.
    ///
    /// # Errors
    ///
    /// Fail if the baud rate is not in force afterwards. `ErrorKind::Unsupported` (the
    /// default) means that this port cannot change its baud rate at all; the driver then
    /// does not change the sensor's, either.
    fn poll_set_baud_rate(
        &mut self,
        cx: &mut Context<'_>,
        baud_rate: BaudRate,
    ) -> Poll<io::Result<()>> {
        let _ = (cx, baud_rate);
        Poll::Ready(Err(io::ErrorKind::Unsupported.into()))
    }

    /// What else the port can tell the driver, or `None` (the default) for a plain stream of bytes.
    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        None
    }
}

impl<P: Port + ?Sized> Port for Box<P> {
    fn baud_rate(&self) -> Option<BaudRate> {
        (**self).baud_rate()
    }

    fn poll_set_baud_rate(
        &mut self,
        cx: &mut Context<'_>,
        baud_rate: BaudRate,
    ) -> Poll<io::Result<()>> {
        (**self).poll_set_baud_rate(cx, baud_rate)
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        (**self).hints()
    }
}

/// Opens a port: at the start, and again after each loss of the link.
///
/// ```no_run
/// # #[cfg(unix)] {
/// use std::path::PathBuf;
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
///         let stream = UnixStream::connect(&self.0).await;
///         let path = self.0.display().to_string();
///         let stream = stream.map_err(|error| Error::open(path, error))?;
///         Ok(StreamPort::new(stream))
///     }
/// }
///
/// # async fn open() -> Result<(), Error> {
/// let sensor = Sensor::builder().connect(Socket("/run/sensor".into())).await?;
/// # Ok(())
/// # }
/// # }
/// ```
pub trait Connect: Send + 'static {
    /// Type of the port.
    type Port: Port;

    /// Opens the port. Must not send anything.
    ///
    /// The future must be cancel-safe: the driver drops it after the open timeout, or at its own end.
    ///
    /// # Errors
    ///
    /// Fails with an error of opening, such as [`NoSuchPort`](crate::ErrorKind::NoSuchPort) or
    /// [`Open`](crate::ErrorKind::Open). A driver that waits for its first sensor gives up if an error
    /// that is not [transient](Error::is_transient) repeats.
    fn connect(&mut self) -> impl Future<Output = Result<Self::Port, Error>> + Send;

    /// Name of the port for logs and error messages, if it has one.
    fn name(&self) -> Option<&str> {
        None
    }

    /// What else the connector knows, if it searches for a sensor on several ports. Default: `None`.
    #[doc(hidden)]
    fn hints(&mut self) -> Option<&mut dyn ConnectHints> {
        None
    }
}

/// Closure that opens a port, as in the example of [this module](self).
impl<F, T, P> Connect for F
where
    F: FnMut() -> T + Send + 'static,
    T: Future<Output = Result<P, Error>> + Send + 'static,
    P: Port,
{
    type Port = P;

    fn connect(&mut self) -> impl Future<Output = Result<P, Error>> + Send {
        self()
    }
}
