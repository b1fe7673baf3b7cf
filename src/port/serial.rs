//! [`SerialPort`]: RS-232 and USB.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::sync::oneshot;
use tokio::task::{JoinHandle, spawn_blocking};
use tokio_serial::{ClearBuffer, DataBits, FlowControl, Parity, StopBits};
#[cfg(not(unix))]
use tokio_serial::{SerialPort as _, SerialStream as Tty};

#[cfg(unix)]
use super::tty::Tty;
use super::{Port, list, open_error};
use crate::{BaudRate, Error};

/// A serial port: raw, 8 data bits, no parity, 1 stop bit, no flow control
/// (C-42-3320-A p. 2), and nobody else's while it is open.
///
/// It is made for the driver, and differs from a plain serial port in this:
///
/// - `flush` and `shutdown` return at once. The system's way to wait for unsent
///   output blocks the thread, and with it the runtime.
/// - Dropping the port discards unsent output, since closing would wait for it,
///   for up to half a minute. What must arrive needs a reply.
/// - What the system had received before the port was opened is still there to
///   be read.
///
/// A port that was unplugged or hung up reads as ended, or fails with the
/// system's error; drop it then, so that the system can give the same name to
/// the sensor when it returns.
#[derive(Debug)]
pub struct SerialPort {
    inner: Tty,
    baud_rate: BaudRate,
    /// A USB sensor itself, where the baud_rate means nothing; not an RS-232
    /// adapter, where it does.
    is_usb_sensor: bool,
}

impl SerialPort {
    /// Opens a port by its path (Unix) or name (Windows), at 19,200 baud, the
    /// baud_rate of a sensor after power-up. Nothing is sent.
    ///
    /// Opening blocks and so runs on a thread of its own. Cancel-safe: if the
    /// future is dropped, the port is closed as soon as it is open; until then
    /// it is busy.
    ///
    /// # Errors
    ///
    /// - [`Error::NoSuchPort`]: nothing has this name, or it was unplugged
    ///   meanwhile.
    /// - [`Error::NotASerialPort`]: a file, a directory, or another device.
    /// - [`Error::PermissionDenied`], with the group that may open it.
    /// - [`Error::Busy`]: it is open elsewhere, in this program or another.
    /// - [`Error::Open`] with the cause, for everything else. That includes a
    ///   lack of permission on a device that appeared just now, because it gets
    ///   its group a moment after it appears, and a tokio runtime without I/O.
    ///
    /// # Panics
    ///
    /// Outside of a tokio runtime. A write to a line that takes no more may panic
    /// in one without a timer.
    pub async fn open(path: &str) -> Result<Self, Error> {
        Opener::default().open(path).await
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
        let port = Self { inner, baud_rate, is_usb_sensor: list::is_usb_sensor(path) };
        port.verify(baud_rate).map_err(|source| open_error(path, source))?;
        Ok(port)
    }

    /// Checks that the port runs at `baud_rate`. Some adapters accept what they
    /// cannot do and take the nearest baud_rate they can.
    fn verify(&self, baud_rate: BaudRate) -> io::Result<()> {
        let actual = self.inner.baud_rate()?;
        if is_close(baud_rate, actual) {
            Ok(())
        } else {
            Err(io::Error::other(format!("asked for {baud_rate} baud, the port took {actual}")))
        }
    }

    fn change_speed(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        self.inner.set_baud_rate(baud_rate.bits_per_second())?;
        self.verify(baud_rate)
    }
}

/// Whether a line at `actual` bits per second is one at `baud_rate`.
///
/// Adapters report what their divider makes of a baud_rate (a CP2104 has 115,384
/// for 115,200), and a receiver samples a byte correctly as long as both sides
/// together are off by less than half a bit in ten. 2 % leaves the sensor its
/// share; the nearest other baud_rate an adapter could take instead (256,000 for
/// 250,000) is farther away.
fn is_close(baud_rate: BaudRate, actual: u32) -> bool {
    let wanted = baud_rate.bits_per_second();
    u64::from(wanted.abs_diff(actual)) * 50 <= u64::from(wanted)
}

impl Port for SerialPort {
    /// The baud_rate in force; `None` for a sensor's own USB port (id 15d1:0000).
    fn baud_rate(&self) -> Option<BaudRate> {
        if self.is_usb_sensor { None } else { Some(self.baud_rate) }
    }

    /// Sets the baud_rate, and reads it back. After an error the baud_rate is what it
    /// was before, if the port can still be set at all.
    fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        match self.change_speed(baud_rate) {
            Ok(()) => {
                self.baud_rate = baud_rate;
                Ok(())
            }
            Err(error) => {
                let before = self.baud_rate;
                if let Err(error) = self.change_speed(before) {
                    tracing::debug!(%error, baud_rate = %before, "cannot go back to the baud rate");
                }
                Err(error)
            }
        }
    }

    #[cfg(unix)]
    fn try_read(&mut self, buffer: &mut [u8]) -> Option<io::Result<usize>> {
        Some(self.inner.try_read(buffer))
    }

    fn discard_output(&mut self) {
        // A port that is gone has no output to discard.
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
        // The system's is tcdrain(3), which blocks the runtime's thread until
        // the last byte is on the line, or for ever where nothing drains.
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

/// Opens ports on a thread that may block, one at a time.
#[derive(Debug, Default)]
pub(super) struct Opener {
    earlier: Option<JoinHandle<()>>,
}

impl Opener {
    /// As [`SerialPort::open`]. What an earlier call, whose future was dropped,
    /// still has open is waited for: it would make the port busy, and calls to
    /// a system that hangs would pile up threads.
    pub(super) async fn open(&mut self, path: &str) -> Result<SerialPort, Error> {
        if let Some(earlier) = &mut self.earlier {
            // How it ended was for that call to report.
            let _ = earlier.await;
            self.earlier = None;
        }
        let (result, opened) = oneshot::channel();
        let owned = path.to_owned();
        let task = self.earlier.insert(spawn_blocking(move || {
            // With nobody left to receive it the port comes back, and closes.
            drop(result.send(SerialPort::open_blocking(&owned)));
        }));
        match opened.await {
            Ok(result) => result,
            Err(_) => {
                let ended = task.await;
                self.earlier = None;
                let source = match ended {
                    Err(panicked_or_cancelled) => panicked_or_cancelled.into(),
                    Ok(()) => io::Error::other("opening was given up"),
                };
                Err(open_error(path, source))
            }
        }
    }
}

pub(super) fn open_error(port: &str, source: io::Error) -> Error {
    Error::Open { port: port.to_owned(), source: Arc::new(source) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn o12_a_speed_that_an_adapter_rounds_is_the_speed_and_another_is_not() {
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
    }
}
