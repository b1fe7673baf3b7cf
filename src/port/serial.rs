//! [`SerialPort`]: a serial port of this machine, RS-232 or USB, and the thread that
//! opens it.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::sync::oneshot;
use tokio::task::{JoinHandle, spawn_blocking};
use tokio_serial::{ClearBuffer, DataBits, FlowControl, Parity, StopBits};
#[cfg(not(unix))]
use tokio_serial::{SerialPort as _, SerialStream as Tty};

#[cfg(unix)]
use super::tty::Tty;
use super::{Port, PortHints, list, open_error};
use crate::{BaudRate, Error};

/// Serial port: raw, 8 data bits, no parity, 1 stop bit, no flow control (C-42-3320-A p.
/// 2), locked for other programs while it is open.
///
/// It differs from other serial ports in three points:
///
/// - `flush` and `shutdown` return at once. The system's call that waits for unsent output
///   would block the thread, and with it the runtime.
/// - Dropping the port discards unsent output. Closing would wait for it, for up to half a
///   minute. Only a reply proves that your command was sent.
/// - You can read bytes that the system had received before you opened the port.
///
/// After a port was unplugged or hung up, reads return the end of the stream or fail with
/// the system's error. Drop the port then, so that the system can assign the same name to
/// the sensor when you plug it in again.
#[derive(Debug)]
pub struct SerialPort {
    inner: Tty,
    baud_rate: BaudRate,
    /// True for the sensor's own USB port, where the baud rate has no effect; false for an
    /// RS-232 adapter.
    is_usb_sensor: bool,
}

impl SerialPort {
    /// Opens a port by its path (Unix) or name (Windows), at 19,200 baud, the baud rate of
    /// a sensor after power-up. Sends nothing.
    ///
    /// Opening blocks, so it runs on one of tokio's blocking threads. Cancel-safe: if you
    /// drop the future, the port is closed as soon as it is open, and is busy until then.
    ///
    /// # Errors
    ///
    /// Fails with
    ///
    /// - [`NoSuchPort`](crate::ErrorKind::NoSuchPort) if there is no such port, or it
    ///   was unplugged while it was opened;
    /// - [`NotASerialPort`](crate::ErrorKind::NotASerialPort) for a file, a directory,
    ///   or another device;
    /// - [`PermissionDenied`](crate::ErrorKind::PermissionDenied), with the group that
    ///   may open it;
    /// - [`Busy`](crate::ErrorKind::Busy) if it is open already, in this program or
    ///   another;
    /// - [`Open`](crate::ErrorKind::Open) with the cause, otherwise. That includes
    ///   missing permission on a device that appeared within the last seconds, because udev may not
    ///   have set its group yet, and a tokio runtime without I/O.
    ///
    /// # Panics
    ///
    /// Panics outside of a tokio runtime. In a runtime without a timer a write may
    /// panic if the line accepts no more bytes.
    pub async fn open(path: &str) -> Result<Self, Error> {
        SerialOpener::default().open(path).await
    }

    fn open_blocking(path: &str) -> Result<Self, Error> {
        open_error::check_before_opening(path)?;
        let baud_rate = BaudRate::B19200;
        let builder = tokio_serial::new(path, baud_rate.bits_per_second())
            .data_bits(DataBits::Eight)
            .parity(Parity::None)
            .stop_bits(StopBits::One)
            .flow_control(FlowControl::None);
        #[cfg(unix)]
        let builder = builder.exclusive(true);
        let inner = Tty::open(&builder).map_err(|error| open_error::explain(path, error))?;
        let actual = inner.baud_rate().map_err(io::Error::from);
        let checked = actual.and_then(|actual| check_baud_rate(baud_rate, actual));
        checked.map_err(|source| Error::open(path, source))?;
        Ok(Self { inner, baud_rate, is_usb_sensor: list::is_usb_sensor(path) })
    }

    fn apply_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        self.inner.set_baud_rate(baud_rate.bits_per_second())?;
        check_baud_rate(baud_rate, self.inner.baud_rate()?)
    }
}

/// Fails if a port that runs at `actual` bits per second does not run at `baud_rate`. Some
/// adapters accept a baud rate they do not have, and take the nearest one.
fn check_baud_rate(baud_rate: BaudRate, actual: u32) -> io::Result<()> {
    if is_close(baud_rate, actual) {
        Ok(())
    } else {
        Err(io::Error::other(format!("expected {baud_rate} baud, the port runs at {actual}")))
    }
}

/// Returns true if `actual` bits per second are within 2 % of `baud_rate`.
///
/// Adapters report the result of their divider (a CP2104 has 115,384 for 115,200). A
/// receiver samples a byte correctly if both sides together are off by less than half a
/// bit in ten, 5 %; 2 % leaves a share for the sensor. An adapter that takes the nearest
/// baud rate instead is at least 2.4 % off: 256,000 for 250,000.
fn is_close(baud_rate: BaudRate, actual: u32) -> bool {
    let wanted = baud_rate.bits_per_second();
    u64::from(wanted.abs_diff(actual)) * 50 <= u64::from(wanted)
}

impl Port for SerialPort {
    /// Baud rate in force, or `None` for the USB port of a sensor (id 15d1:0000).
    fn baud_rate(&self) -> Option<BaudRate> {
        if self.is_usb_sensor { None } else { Some(self.baud_rate) }
    }

    /// Sets the baud rate and reads it back. After an error it restores the former baud
    /// rate, if the port can still be set at all.
    fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        match self.apply_baud_rate(baud_rate) {
            Ok(()) => {
                self.baud_rate = baud_rate;
                Ok(())
            }
            Err(error) => {
                let before = self.baud_rate;
                if let Err(error) = self.apply_baud_rate(before) {
                    tracing::debug!(%error, baud_rate = %before, "cannot restore the baud rate of the port");
                }
                Err(error)
            }
        }
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        Some(self)
    }
}

impl PortHints for SerialPort {
    /// Returns true for RS-232, where a sensor without power is silent. A sensor's own USB
    /// port disappears with it.
    fn can_die_silently(&mut self) -> bool {
        !self.is_usb_sensor
    }

    /// Returns true for the sensor's own USB port, whose packets have a checksum.
    fn delivers_intact(&mut self) -> bool {
        self.is_usb_sensor
    }

    #[cfg(unix)]
    fn try_read(&mut self, buffer: &mut [u8]) -> Option<io::Result<usize>> {
        Some(self.inner.try_read(buffer))
    }

    #[cfg(unix)]
    fn suspend_wakeups(&mut self) -> bool {
        self.inner.suspend_wakeups();
        true
    }

    fn discard_output(&mut self) {
        // Fails only if the port is gone, and with it its output.
        let _ = self.inner.clear(ClearBuffer::Output);
    }
}

impl Drop for SerialPort {
    fn drop(&mut self) {
        self.discard_output();
    }
}

impl AsyncRead for SerialPort {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_read(cx, buf)
    }
}

impl AsyncWrite for SerialPort {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.inner).poll_write(cx, buf)
    }

    fn poll_flush(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        // tcdrain(3) would block the runtime's thread until the last byte is on the
        // line, which never happens if the line is stuck.
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

/// Opens ports on a blocking thread, one at a time.
#[derive(Debug, Default)]
pub(super) struct SerialOpener {
    earlier: Option<JoinHandle<()>>,
}

impl SerialOpener {
    /// Returns true while an earlier call, whose future was dropped, is still running.
    pub(super) fn is_opening(&self) -> bool {
        self.earlier.as_ref().is_some_and(|earlier| !earlier.is_finished())
    }

    /// Opens a port as [`SerialPort::open`] does. Waits first for an earlier call whose
    /// future was dropped: its port would be busy, and calls that hang in the system would
    /// each keep a thread.
    pub(super) async fn open(&mut self, path: &str) -> Result<SerialPort, Error> {
        if let Some(earlier) = &mut self.earlier {
            // The result belonged to the earlier call.
            let _ = earlier.await;
            self.earlier = None;
        }
        let (result, opened) = oneshot::channel();
        let owned = path.to_owned();
        let task = self.earlier.insert(spawn_blocking(move || {
            // Without a receiver this drops the port, which closes it.
            drop(result.send(SerialPort::open_blocking(&owned)));
        }));
        match opened.await {
            Ok(result) => {
                self.earlier = None;
                result
            }
            Err(_) => {
                let ended = task.await;
                self.earlier = None;
                let source = match ended {
                    Err(panicked_or_cancelled) => panicked_or_cancelled.into(),
                    Ok(()) => {
                        io::Error::other("the thread that opened the port ended without a result")
                    }
                };
                Err(Error::open(path, source))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn o12_a_rounded_baud_rate_is_accepted() {
        for baud_rate in BaudRate::ALL {
            assert!(is_close(baud_rate, baud_rate.bits_per_second()));
            assert!(!is_close(baud_rate, 0));
            for other in BaudRate::ALL {
                assert_eq!(is_close(baud_rate, other.bits_per_second()), baud_rate == other);
            }
        }
        assert!(is_close(BaudRate::B115200, 115_384));
        assert!(!is_close(BaudRate::B250000, 256_000));
        assert!(!is_close(BaudRate::B250000, 230_400));
        assert!(!is_close(BaudRate::B750000, 921_600));
        assert!(check_baud_rate(BaudRate::B115200, 115_384).is_ok());
        let error = check_baud_rate(BaudRate::B250000, 256_000).map_err(|error| error.to_string());
        assert_eq!(error, Err("expected 250000 baud, the port runs at 256000".to_owned()));
    }
}
