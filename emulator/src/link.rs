//! [`Link`]: a line to an emulated sensor in memory. `serve` puts it on streams, TCP
//! connections and terminals.
//!
//! A link takes as much time as the real line. It garbles bytes while the baud rates of
//! its two ends differ.

use std::fmt;
use std::future::Future;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::SystemTime;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::Sleep;

use super::shared::Shared;
use super::timed_device::TimedDevice;
use tokio_scip::BaudRate;
use tokio_scip::port::{Port, PortHints};

/// Baud rate of the host's end of the line.
pub(super) enum HostBaudRate {
    /// Always the sensor's baud rate.
    FollowsSensor,
    /// Set by the host.
    Set(BaudRate),
    /// Not changeable, as behind a bridge.
    Fixed(BaudRate),
    /// Read from the terminal whenever needed, in bits per second.
    #[cfg_attr(not(all(unix, feature = "pty")), allow(dead_code))]
    Probed(Box<dyn Fn() -> Option<u32> + Send + Sync>),
}

impl HostBaudRate {
    pub(super) fn bits_per_second(&self) -> Option<u32> {
        match self {
            Self::FollowsSensor => None,
            Self::Set(baud_rate) | Self::Fixed(baud_rate) => Some((*baud_rate).into()),
            Self::Probed(probe) => probe(),
        }
    }
}

/// Host's end of a line to an emulated sensor, in memory.
///
/// Your bytes arrive at the sensor, and its replies become readable, after the time they
/// need on the line. All times are `tokio::time`'s, so you can pause the clock. A sensor
/// on RS-232 receives and sends garbage while this end has another baud rate. As a
/// [`Port`] the link starts at 19,200 baud.
///
/// The end of the stream (`Ok(0)`) means that the link was hung up: the sensor was
/// unplugged, a newer link was opened, or a fault hung it up. Writes then fail with
/// [`BrokenPipe`](io::ErrorKind::BrokenPipe). Flushing and shutting down have no effect.
///
/// Reads and writes are cancel-safe. Dropping the link leaves the sensor as it is. Half a
/// command stays in the sensor's line buffer. Bytes that the sensor still sends wait for
/// the next link, as in the buffer of an operating system.
pub struct Link {
    shared: Arc<Shared>,
    id: u64,
    baud_rate: HostBaudRate,
    timer: Option<Pin<Box<Sleep>>>,
}

impl fmt::Debug for Link {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Link").field("id", &self.id).finish_non_exhaustive()
    }
}

impl Link {
    pub(super) fn new(shared: Arc<Shared>, id: u64, baud_rate: HostBaudRate) -> Self {
        Self { shared, id, baud_rate, timer: None }
    }

    /// Sets this end's baud rate. No effect on USB.
    ///
    /// # Errors
    ///
    /// Fails as unsupported on a [`bridge`](super::Emulator::bridge).
    pub fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        match self.baud_rate {
            HostBaudRate::Set(_) => {
                let mut plugged = self.shared.lock();
                if plugged.link == Some(self.id) {
                    plugged.set_host(Some(baud_rate.into()));
                }
                drop(plugged);
                self.baud_rate = HostBaudRate::Set(baud_rate);
                Ok(())
            }
            HostBaudRate::FollowsSensor => Ok(()),
            HostBaudRate::Fixed(_) | HostBaudRate::Probed(_) => {
                Err(io::ErrorKind::Unsupported.into())
            }
        }
    }

    /// Waits until the link is hung up, without reading it.
    pub(super) fn replaced(&self) -> impl Future<Output = ()> + Send + 'static {
        let (shared, id) = (self.shared.clone(), self.id);
        async move { shared.wait_until(|plugged| plugged.link != Some(id)).await }
    }
}

impl AsyncRead for Link {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if buffer.remaining() == 0 {
            return Poll::Ready(Ok(()));
        }
        // Takes part in tokio's budget, so that a link that always has bytes lets other
        // tasks run.
        let budget = ready!(tokio::task::coop::poll_proceed(context));
        loop {
            let host = self.baud_rate.bits_per_second();
            let next = {
                let mut plugged = self.shared.lock();
                if plugged.link != Some(self.id) {
                    return Poll::Ready(Ok(()));
                }
                if plugged.sensor.transmitter.take_seen(buffer) {
                    budget.made_progress();
                    return Poll::Ready(Ok(()));
                }
                let now = plugged.set_host(host);
                if plugged.sensor.transmitter.take(now, buffer) {
                    budget.made_progress();
                    return Poll::Ready(Ok(()));
                }
                if plugged.sensor.is_hung_up {
                    budget.made_progress();
                    return Poll::Ready(end_of_stream(&plugged.sensor));
                }
                plugged.reader = Some(context.waker().clone());
                plugged.sensor.next_time()
            };
            let Some(next) = next else { return Poll::Pending };
            let timer = self.timer.get_or_insert_with(|| Box::pin(tokio::time::sleep_until(next)));
            timer.as_mut().reset(next);
            ready!(timer.as_mut().poll(context));
        }
    }
}

/// Result of reading from a link that the sensor has hung up.
fn end_of_stream(sensor: &TimedDevice) -> io::Result<()> {
    let ended = sensor.source.playback.as_ref().filter(|_| sensor.is_gone);
    ended.and_then(|playback| playback.script.failure()).map_or(Ok(()), Err)
}

impl AsyncWrite for Link {
    fn poll_write(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let budget = ready!(tokio::task::coop::poll_proceed(context));
        budget.made_progress();
        let host = self.baud_rate.bits_per_second();
        let mut plugged = self.shared.lock();
        if plugged.link != Some(self.id) || plugged.sensor.is_hung_up {
            return Poll::Ready(Err(io::ErrorKind::BrokenPipe.into()));
        }
        let now = plugged.set_host(host);
        plugged.sensor.receive(now, bytes, host);
        Shared::wake_reader(plugged);
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

impl Port for Link {
    /// Baud rate of this end, or `None` if the sensor is on USB.
    fn baud_rate(&self) -> Option<BaudRate> {
        match self.baud_rate {
            HostBaudRate::Set(baud_rate) | HostBaudRate::Fixed(baud_rate) => Some(baud_rate),
            HostBaudRate::FollowsSensor | HostBaudRate::Probed(_) => None,
        }
    }

    fn poll_set_baud_rate(
        &mut self,
        _: &mut Context<'_>,
        baud_rate: BaudRate,
    ) -> Poll<io::Result<()>> {
        Poll::Ready(self.set_baud_rate(baud_rate))
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        Some(self)
    }
}

impl PortHints for Link {
    /// Returns true if [`EmulatorBuilder::intact_usb`](super::EmulatorBuilder::intact_usb) says so.
    fn delivers_intact(&mut self) -> bool {
        matches!(self.baud_rate, HostBaudRate::FollowsSensor)
            && self.shared.lock().sensor.device.body.is_intact
    }

    /// Returns true after the last reply of a replayed recording.
    fn is_over(&mut self) -> bool {
        self.shared.lock().sensor.is_gone
    }

    /// Returns the time of the recording if one is replayed.
    fn wall_clock(&mut self) -> Option<SystemTime> {
        let plugged = self.shared.lock();
        plugged.sensor.source.playback.as_ref().map(|playback| playback.script.wall_clock())
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        let mut plugged = self.shared.lock();
        if plugged.link == Some(self.id) {
            plugged.link = None;
            plugged.reader = None;
        }
    }
}
