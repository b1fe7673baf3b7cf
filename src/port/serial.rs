//! [`SerialPort`]: a serial port of this machine, RS-232 or USB. Threads open, set and close it.

use std::future::Future;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::sync::{Mutex, OwnedMutexGuard, oneshot};
use tokio_serial::ClearBuffer;
#[cfg(not(unix))]
use tokio_serial::{SerialPort as _, SerialStream as Tty};

#[cfg(unix)]
use super::tty::Tty;
use super::{Port, PortHints, list, open_error, thread};
use crate::{BaudRate, Error};

/// Serial port: raw, 8 data bits, no parity, 1 stop bit, no flow control (C-42-3320-A p.
/// 2), locked for other programs while it is open.
///
/// `flush` and `shutdown` return at once: the system's call that waits for unsent output would block
/// the thread, and with it the runtime.
#[derive(Debug)]
pub(super) struct SerialPort {
    /// `None` while a thread changes its baud rate.
    tty: Option<Tty>,
    change: Option<Change>,
    baud_rate: BaudRate,
    /// True for the sensor's own USB port, where the baud rate has no effect.
    is_usb_sensor: bool,
    /// Driver that misreports high baud rates.
    driver: Option<String>,
    /// Lock of its opener. Dropped after `tty`.
    lock: Option<OwnedMutexGuard<()>>,
}

/// Change of the baud rate, which takes seconds if an adapter hangs.
#[derive(Debug)]
struct Change {
    to: BaudRate,
    done: oneshot::Receiver<(Tty, io::Result<()>)>,
}

impl SerialPort {
    /// Opens a port at 19,200 baud, the baud rate of a sensor after power-up.
    fn open_blocking(path: &str, lock: OwnedMutexGuard<()>) -> Result<Self, Error> {
        open_error::check_before_opening(path)?;
        #[cfg(any(target_os = "linux", target_os = "android"))]
        respect_locks();
        let baud_rate = BaudRate::B19200;
        // By default with a lock and 8N1, without flow control.
        let builder = tokio_serial::new(path, baud_rate.bits_per_second());
        let mut tty = Tty::open(&builder).map_err(|error| open_error::explain(path, error))?;
        settle(&mut tty, baud_rate).map_err(|source| Error::open(path, source))?;
        let (is_usb_sensor, lock) = (list::is_usb_sensor(path), Some(lock));
        let driver = list::misreporting_driver(path);
        Ok(Self { tty: Some(tty), change: None, baud_rate, is_usb_sensor, driver, lock })
    }

    /// Returns the terminal, as soon as no thread has it.
    fn poll_tty(&mut self, cx: &mut Context<'_>) -> Poll<io::Result<&mut Tty>> {
        if self.change.is_some() {
            // Its result belonged to a call that was given up.
            let _ = ready!(self.poll_change(cx));
        }
        Poll::Ready(self.tty.as_mut().ok_or_else(|| io::ErrorKind::NotConnected.into()))
    }

    /// Waits for the change of the baud rate, if one is running.
    fn poll_change(&mut self, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let Some(Change { to, done }) = &mut self.change else { return Poll::Ready(Ok(())) };
        // Without a result the thread has panicked, and the terminal is gone.
        let done = ready!(Pin::new(done).poll(cx)).map_err(io::Error::other);
        let to = *to;
        self.change = None;
        let (tty, outcome) = done?;
        self.tty = Some(tty);
        if outcome.is_ok() {
            self.baud_rate = to;
        }
        Poll::Ready(outcome)
    }

    /// Does what remains before the port can be closed, and does not wait.
    fn release(&mut self) {
        self.discard_output();
        #[cfg(unix)]
        if let Some(tty) = &mut self.tty {
            tty.unlock();
        }
    }
}

/// Gives up this thread's privilege to open a terminal that another program has locked
/// (`TIOCEXCL`). Otherwise a program of root opens it, and unlocks it when it closes it.
#[cfg(any(target_os = "linux", target_os = "android"))]
fn respect_locks() {
    use rustix::thread::{CapabilitySet, capabilities, set_capabilities};

    // Fails only in a sandbox that forbids these calls.
    if let Ok(mut own) = capabilities(None) {
        own.effective.remove(CapabilitySet::SYS_ADMIN);
        let _ = set_capabilities(None, own);
    }
}

/// Sets the baud rate and reads it back. After an error it restores the former one, if it can.
fn set_baud_rate(tty: &mut Tty, from: BaudRate, to: BaudRate) -> io::Result<()> {
    let mut apply = |baud_rate: BaudRate| {
        tty.set_baud_rate(baud_rate.bits_per_second())?;
        settle(tty, baud_rate)
    };
    let outcome = apply(to);
    if outcome.is_err()
        && let Err(error) = apply(from)
    {
        tracing::debug!(%error, baud_rate = %from, "cannot restore the baud rate of the port");
    }
    outcome
}

/// Completes a setting of the baud rate. Fails if the port does not run at it: some adapters accept a
/// baud rate they do not have, and take the nearest one.
fn settle(tty: &mut Tty, baud_rate: BaudRate) -> io::Result<()> {
    // Windows lowers DTR, and mio-serial 5.0.7 forgets a builder's `dtr_on_open`. A device on USB may
    // then send nothing: Hokuyo's urg_library raises it for a UST.
    #[cfg(not(unix))]
    let _ = tty.write_data_terminal_ready(true);
    let actual = tty.baud_rate()?;
    let wrong = || format!("expected {baud_rate} baud, the port runs at {actual}");
    if is_close(baud_rate, actual) { Ok(()) } else { Err(io::Error::other(wrong())) }
}

/// Returns true if `actual` bits per second are within 2 % of `baud_rate`.
///
/// Adapters report the result of their divider (a CP2104 has 115,384 for 115,200). A receiver samples a
/// byte correctly if both sides together are off by less than half a bit in ten, 5 %; 2 % leaves a
/// share for the sensor. An adapter that takes the nearest baud rate instead is at least 2.4 % off:
/// 256,000 for 250,000.
fn is_close(baud_rate: BaudRate, actual: u32) -> bool {
    let wanted = baud_rate.bits_per_second();
    u64::from(wanted.abs_diff(actual)) * 50 <= u64::from(wanted)
}

impl Port for SerialPort {
    /// Baud rate in force, or `None` for the USB port of a sensor.
    fn baud_rate(&self) -> Option<BaudRate> {
        if self.is_usb_sensor { None } else { Some(self.baud_rate) }
    }

    /// [Sets](set_baud_rate) the baud rate on a thread.
    fn poll_set_baud_rate(
        &mut self,
        cx: &mut Context<'_>,
        baud_rate: BaudRate,
    ) -> Poll<io::Result<()>> {
        if let Some(driver) = self.driver.as_ref().filter(|_| baud_rate > BaudRate::B115200) {
            return Poll::Ready(Err(io::Error::other(format!(
                "above 115200 baud the kernel's driver {driver} sets another baud rate than it reports: use 115200 baud or less, or another adapter"
            ))));
        }
        loop {
            if let Some(Change { to, .. }) = self.change {
                let outcome = ready!(self.poll_change(cx));
                if to == baud_rate {
                    return Poll::Ready(outcome);
                }
            }
            let Some(mut tty) = self.tty.take() else {
                return Poll::Ready(Err(io::ErrorKind::NotConnected.into()));
            };
            let from = self.baud_rate;
            let done = thread::run_on(move || {
                let outcome = set_baud_rate(&mut tty, from, baud_rate);
                (tty, outcome)
            });
            self.change = Some(Change { to: baud_rate, done: done? });
        }
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        Some(self)
    }
}

impl PortHints for SerialPort {
    /// Returns true for RS-232, where a sensor without power is silent: a USB port disappears with it.
    fn can_die_silently(&mut self) -> bool {
        !self.is_usb_sensor
    }

    /// Returns true for the sensor's own USB port, whose packets have a checksum.
    fn delivers_intact(&mut self) -> bool {
        self.is_usb_sensor
    }

    #[cfg(unix)]
    fn try_read(&mut self, buffer: &mut [u8]) -> Option<io::Result<usize>> {
        self.tty.as_mut().map(|tty| tty.try_read(buffer))
    }

    #[cfg(unix)]
    fn suspend_wakeups(&mut self) -> bool {
        self.tty.as_mut().map(Tty::suspend_wakeups).is_some()
    }

    fn holds_output(&mut self) -> bool {
        self.tty.as_ref().is_some_and(|tty| tty.bytes_to_write().is_ok_and(|bytes| bytes > 0))
    }

    fn discard_output(&mut self) {
        if let Some(tty) = &self.tty {
            // Fails only if the port is gone, and with it its output.
            let _ = tty.clear(ClearBuffer::Output);
        }
    }
}

impl Drop for SerialPort {
    fn drop(&mut self) {
        self.release();
        // A thread that changes the baud rate closes the port itself.
        if let Some(tty) = self.tty.take() {
            thread::drop_on((tty, self.lock.take()));
        }
    }
}

impl AsyncRead for SerialPort {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(ready!(self.poll_tty(cx))?).poll_read(cx, buf)
    }
}

impl AsyncWrite for SerialPort {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(ready!(self.poll_tty(cx))?).poll_write(cx, buf)
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

/// Opens ports on a thread, one at a time.
#[derive(Debug, Clone, Default)]
pub(super) struct SerialOpener {
    /// Locked by a call until its port is closed, even if its future was dropped.
    pub(super) lock: Arc<Mutex<()>>,
}

impl SerialOpener {
    /// Returns true while an earlier call, whose future was dropped, is running or its port is open.
    pub(super) fn is_busy(&self) -> bool {
        self.lock.try_lock().is_err()
    }

    /// Opens a port by its path (Unix) or name (Windows), on a thread of its own. If you drop the
    /// future, the port is closed as soon as it is open, and is busy until then. Waits first until the
    /// port of an earlier call is closed: it would be busy, and each call that hangs keep a thread.
    pub(super) async fn open(&self, path: &str) -> Result<SerialPort, Error> {
        let lock = Arc::clone(&self.lock).lock_owned().await;
        let owned = path.to_owned();
        let opened = thread::run_on(move || SerialPort::open_blocking(&owned, lock));
        let outcome = opened.map_err(|source| Error::open(path, source))?.await;
        let panicked = || io::Error::other("the thread that opens the port has panicked");
        outcome.unwrap_or_else(|_| Err(Error::open(path, panicked())))
    }
}

#[cfg(test)]
mod tests {
    use futures::FutureExt;

    use super::*;

    #[tokio::test]
    async fn an_opener_waits_for_its_hanging_call() {
        let opener = SerialOpener::default();
        let hang = Arc::clone(&opener.lock).lock_owned().await;
        assert!(opener.open("/dev/gone").now_or_never().is_none());
        assert!(opener.is_busy());
        drop(hang);
        assert!(opener.open("/dev/gone").await.is_err());
        assert!(!opener.is_busy());
    }

    /// On a thread of its own, which gives up the privilege to pass the lock.
    #[cfg(any(target_os = "linux", target_os = "android"))]
    fn is_locked(path: &str) -> bool {
        let path = path.to_owned();
        let open = move || {
            respect_locks();
            std::fs::File::open(path).is_err()
        };
        std::thread::spawn(open).join().unwrap()
    }

    #[cfg(any(target_os = "linux", target_os = "android"))]
    #[tokio::test]
    async fn a_port_that_waits_to_be_closed_is_not_locked() {
        let (_far, near) = serialport::TTYPort::pair().unwrap();
        let path = tokio_serial::SerialPort::name(&near).unwrap();
        // It is locked by its maker, and would stay so.
        drop(near);
        let opener = SerialOpener::default();
        let mut port = opener.open(&path).await.unwrap();
        assert!(is_locked(&path));
        port.release();
        assert!(!is_locked(&path) && opener.is_busy());
        drop(port);
        drop(opener.lock.lock().await);
    }

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
    }
}
