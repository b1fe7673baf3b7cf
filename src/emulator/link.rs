//! A link to the emulated sensor in memory: a stream of bytes that takes as
//! long as the real line, and garbles where the speeds differ.

use std::fmt;
use std::future::Future;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::SystemTime;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Sleep};

use super::Shared;
use super::script::Performance;
use super::sensor::Sensor;
use crate::{BaudRate, Port};

/// The speed of the host's end of the line.
pub(super) enum HostBaudRate {
    /// Always that of the sensor.
    Follows,
    /// One that the host sets.
    Set(BaudRate),
    /// One that nobody here can change, as behind a bridge.
    Fixed(BaudRate),
    /// Asked for again each time, in bits a second.
    #[cfg_attr(not(all(unix, feature = "serial")), allow(dead_code))]
    Probed(Box<dyn Fn() -> Option<u32> + Send + Sync>),
}

impl HostBaudRate {
    pub(super) fn bits_per_second(&self) -> Option<u32> {
        match self {
            Self::Follows => None,
            Self::Set(speed) | Self::Fixed(speed) => Some(speed.bits_per_second()),
            Self::Probed(probe) => probe(),
        }
    }
}

/// The host's end of a line to an emulated sensor, in memory.
///
/// Bytes written arrive at the sensor, and its replies can be read, after the
/// time that they take on the line. All of it is timed with `tokio::time`, so
/// that a paused clock works. A sensor on RS-232 hears and says garbage while
/// this end has another speed; as a [`Port`] the link starts at 19,200 baud.
///
/// The end of the stream (`Ok(0)`) means that the link was hung up: the sensor
/// was unplugged, a newer link was opened, or a fault says so. Writing then
/// fails with [`BrokenPipe`](io::ErrorKind::BrokenPipe). Flushing and shutting
/// down do nothing.
///
/// Reads and writes are cancel-safe. Dropping the link leaves the sensor as it
/// is; half a command stays in the sensor's line buffer, and what the sensor
/// still sends waits for the next link, as in an operating system's buffer.
pub struct Link {
    shared: Arc<Shared>,
    id: u64,
    speed: HostBaudRate,
    timer: Option<Pin<Box<Sleep>>>,
}

impl fmt::Debug for Link {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Link").field("id", &self.id).finish_non_exhaustive()
    }
}

impl Link {
    pub(super) fn new(shared: Arc<Shared>, id: u64, speed: HostBaudRate) -> Self {
        Self { shared, id, speed, timer: None }
    }

    /// Waits until the link is no longer the sensor's, without reading it.
    pub(super) fn replaced(&self) -> impl Future<Output = ()> + Send + 'static {
        let (shared, id) = (self.shared.clone(), self.id);
        async move { shared.until(|state| state.link != Some(id)).await }
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
        // A link that always has bytes must let other tasks run, too.
        let budget = ready!(tokio::task::coop::poll_proceed(context));
        loop {
            let now = Instant::now();
            let host = self.speed.bits_per_second();
            let next = {
                let mut state = self.shared.lock();
                if state.link != Some(self.id) {
                    return Poll::Ready(Ok(()));
                }
                state.host = host;
                state.sensor.advance(now, host);
                if state.sensor.transmitter.take(now, buffer) > 0 {
                    budget.made_progress();
                    return Poll::Ready(Ok(()));
                }
                if state.sensor.hung_up {
                    budget.made_progress();
                    return Poll::Ready(end(&state.sensor));
                }
                state.reader = Some(context.waker().clone());
                state.sensor.next_time()
            };
            let Some(next) = next else { return Poll::Pending };
            let timer = self.timer.get_or_insert_with(|| Box::pin(tokio::time::sleep_until(next)));
            timer.as_mut().reset(next);
            ready!(timer.as_mut().poll(context));
        }
    }
}

/// How reading from a link ends that the sensor has hung up.
fn end(sensor: &Sensor) -> io::Result<()> {
    let over = sensor.performance.as_ref().filter(|_| sensor.gone);
    over.map_or(Ok(()), Performance::end)
}

impl AsyncWrite for Link {
    fn poll_write(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let budget = ready!(tokio::task::coop::poll_proceed(context));
        budget.made_progress();
        let now = Instant::now();
        let host = self.speed.bits_per_second();
        let mut state = self.shared.lock();
        if state.link != Some(self.id) || state.sensor.hung_up {
            return Poll::Ready(Err(io::ErrorKind::BrokenPipe.into()));
        }
        state.host = host;
        state.sensor.advance(now, host);
        state.sensor.receive(now, bytes, host);
        // The reader may have nothing to wait for yet.
        let reader = state.reader.take();
        drop(state);
        if let Some(reader) = reader {
            reader.wake();
        }
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
    /// This end's speed; `None` where the sensor is on USB.
    fn baud_rate(&self) -> Option<BaudRate> {
        match self.speed {
            HostBaudRate::Set(speed) | HostBaudRate::Fixed(speed) => Some(speed),
            HostBaudRate::Follows | HostBaudRate::Probed(_) => None,
        }
    }

    /// Sets this end's speed. On USB it does nothing; on a
    /// [`bridge`](super::Emulator::bridge) it is unsupported.
    fn set_baud_rate(&mut self, speed: BaudRate) -> io::Result<()> {
        match self.speed {
            HostBaudRate::Set(_) => {
                let mut state = self.shared.lock();
                if state.link == Some(self.id) {
                    // What has arrived until now arrived at the old speed.
                    let before = state.host;
                    state.sensor.advance(Instant::now(), before);
                    state.host = Some(speed.bits_per_second());
                }
                drop(state);
                self.speed = HostBaudRate::Set(speed);
                Ok(())
            }
            HostBaudRate::Follows => Ok(()),
            HostBaudRate::Fixed(_) | HostBaudRate::Probed(_) => {
                Err(io::ErrorKind::Unsupported.into())
            }
        }
    }

    /// That of the recording, where one is replayed.
    fn wall_clock(&self) -> SystemTime {
        let state = self.shared.lock();
        state.sensor.performance.as_ref().map_or_else(SystemTime::now, Performance::wall_clock)
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        let mut state = self.shared.lock();
        if state.link == Some(self.id) {
            state.link = None;
            state.reader = None;
        }
    }
}
