//! [`PortHints`]: what a port can tell the driver beyond its bytes. [`ConnectHints`]: what the search
//! for a serial number tells it.
//!
//! What only the ports and the connector of this crate can answer is hidden from the documentation.

use std::io;
use std::pin::Pin;
use std::time::SystemTime;

/// What a [`Port`](super::Port) can tell the driver beyond its bytes. Return it from
/// [`Port::hints`](super::Port::hints).
///
/// All methods are optional, and each default is safe. Override a method only if it is true of your
/// transport: its documentation says what breaks otherwise. Methods must not block the driver's task.
///
/// ```
/// use tokio_scip::port::PortHints;
///
/// /// A radio link, which falls silent when it is out of range. Its `Port::hints` returns `Some(self)`.
/// struct Radio(tokio::net::TcpStream);
///
/// impl PortHints for Radio {
///     fn can_die_silently(&mut self) -> bool {
///         true
///     }
/// }
/// ```
pub trait PortHints {
    /// Returns true if the link can be lost without a failing read or write, as a TCP
    /// connection or an RS-232 line can. The driver then probes the sensor while it is idle
    /// ([`SensorBuilder::idle_probe`](crate::SensorBuilder::idle_probe)). Default: `false`.
    ///
    /// If you wrongly return `false`, a lost link looks connected until the next request. If you
    /// wrongly return `true`, probes cost 26 bytes every 5 s, in SCIP 2 60.
    fn can_die_silently(&mut self) -> bool {
        false
    }

    /// Returns true if every byte arrives as the sensor sent it, as on the sensor's own USB port,
    /// whose packets have a checksum. The driver then reads the serial number of a new sensor once,
    /// otherwise twice, and computes stamps from the motor
    /// ([`StampQuality::Motor`](crate::scan::StampQuality::Motor)). Default: `false`.
    ///
    /// If you wrongly return `true`, the driver may expect a damaged serial number from then on, and
    /// stamps may follow delays of your transport. If you wrongly return `false`, the first scan
    /// comes one revolution later, and all stamps rest on arrivals.
    fn delivers_intact(&mut self) -> bool {
        false
    }

    /// Returns true if the link has ended permanently, for example at the end of a recording. The
    /// driver asks after a read or a write has failed or the stream has ended. If you return true,
    /// it stops instead of reconnecting: with `Ok` after the end of the stream, otherwise with the
    /// error of the read or write. Default: `false`.
    ///
    /// If you wrongly return `true`, the first lost link stops the driver. If you wrongly return
    /// `false`, the driver reconnects for ever.
    fn is_over(&mut self) -> bool {
        false
    }

    /// Wall clock for the [`stamp`](crate::scan::ScanTimes::stamp) of a scan. A port that replays a recording returns
    /// when the bytes that you read now were recorded. Default: `None`, the bytes arrive now.
    ///
    /// A wrong clock makes wrong stamps. Replayed bytes tell nothing about the sensor's motor, so their
    /// scans have [`StampQuality::Arrival`](crate::scan::StampQuality::Arrival). The driver polls a
    /// replay and never asks it for a stream. It schedules and times out by tokio's clock alone.
    fn wall_clock(&mut self) -> Option<SystemTime> {
        None
    }

    /// Reads the bytes that the system has now, without waiting for the runtime's I/O driver to
    /// report them, or fails with `ErrorKind::WouldBlock`. The driver calls it before each command to
    /// drop pending bytes. It yields to the runtime instead if this returns `None`, the default.
    #[doc(hidden)]
    fn try_read(&mut self, buffer: &mut [u8]) -> Option<io::Result<usize>> {
        let _ = buffer;
        None
    }

    /// Stops waking the driver for bytes that arrive, until the next `poll_read`. That `poll_read`
    /// must first read the bytes that the system has by then, and resume the wake-ups. Returns
    /// whether the port has done so, which is the default's `false`.
    ///
    /// The driver calls it after a `poll_read` that returned `Pending`, while the rest of a reply is
    /// some milliseconds away. A serial line delivers a scan in 20 to 100 pieces, each a wake-up.
    #[doc(hidden)]
    fn suspend_wakeups(&mut self) -> bool {
        false
    }

    /// Returns true while the device has not taken all bytes that were written. Default: `false`.
    ///
    /// The driver asks before it repeats a command that was not answered: a device that hangs would
    /// first answer the older ones once it works again.
    #[doc(hidden)]
    fn holds_output(&mut self) -> bool {
        false
    }

    /// Drops bytes that were written and are not on the line yet, so that closing the port does not
    /// wait for them. The driver calls it once, before it drops the port. Does nothing by default.
    #[doc(hidden)]
    fn discard_output(&mut self) {}
}

/// What a [`Connect`](super::Connect) that searches several ports can tell the driver.
#[doc(hidden)]
pub trait ConnectHints {
    /// Returns true if there is another candidate, after the last opened port turned out to have no
    /// sensor or the wrong one. If true, the driver calls [`connect`](super::Connect::connect)
    /// again at once; if false (the default), it backs off first.
    ///
    /// If you always return `true`, the driver backs off after 64 candidates.
    fn has_more(&mut self) -> bool {
        false
    }

    /// Accepts the last opened port: it has the right sensor. After a loss of the link, start the
    /// next [`connect`](super::Connect::connect) with the first candidate again.
    fn found(&mut self) {}

    /// Returns a future that ends when a port has appeared, or `None` (the default) if only
    /// [`connect`](super::Connect::connect) can tell. While the driver backs off, it awaits this
    /// future, too, and then calls `connect` at once.
    ///
    /// If the future ends again and again without a new port, the driver does not back off.
    fn port_appears(&mut self) -> Option<Pin<Box<dyn Future<Output = ()> + Send + '_>>> {
        None
    }

    /// Serial number (`SERI:`) that the sensor must have, or `None` (the default) to accept any
    /// sensor. The driver asks once, when you build it.
    fn expected_serial_number(&mut self) -> Option<&str> {
        None
    }
}
