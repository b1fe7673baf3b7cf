//! [`SensorBuilder`]: how a sensor is opened and kept.

use std::ops::RangeInclusive;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite};

use super::Sensor;
use crate::driver::{self, Config, Driver, IdleProbe};
use crate::observer::{RawReply, ReplyObserver};
use crate::port::{Attached, Connect, Endpoint};
use crate::protocol::Text;
use crate::{BaudRate, Error};

/// The longest time that can be set: long enough to mean for ever, and no
/// instant overflows.
const LONGEST: Duration = Duration::from_secs(24 * 60 * 60);
/// A shorter wait would be a busy loop.
const SHORTEST_BACKOFF: Duration = Duration::from_millis(10);

/// A shorter interval would keep the line busy with probes.
const SHORTEST_PROBE: Duration = Duration::from_millis(100);

/// Says how a [`Sensor`] is opened and kept. Nothing has to be said: each method
/// tells what holds unless it is called.
///
/// ```no_run
/// use tokio_scip::{BaudRate, Sensor};
///
/// # async fn open() -> Result<(), tokio_scip::Error> {
/// // A service that may start before its sensor, and wants this one and no other.
/// let sensor = Sensor::builder()
///     .wait_for_sensor()
///     .serial_number("H0713090")
///     .baud_rate(BaudRate::B115200) // without effect on USB
///     .open("/dev/ttyUSB0")
///     .await?;
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, Default)]
#[must_use = "a builder does nothing until it opens a sensor"]
pub struct SensorBuilder {
    config: Config,
}

impl SensorBuilder {
    /// The baud rate to run at. The sensor is found at whatever baud_rate it has,
    /// and moved to this one. Unless set, it is left at the one it has (19,200
    /// baud after power-up). Without effect on USB.
    pub fn baud_rate(mut self, baud_rate: BaudRate) -> Self {
        self.config.baud_rate = Some(baud_rate);
        self
    }

    /// How long to look for a sensor on a port, and how long a request waits
    /// for a link. 5 s unless set: two passes over the six baud rates.
    ///
    /// At most a day.
    pub fn open_timeout(mut self, timeout: Duration) -> Self {
        self.config.open_timeout = timeout.min(LONGEST);
        self
    }

    /// Opening waits for the sensor to appear, however long that takes: for the
    /// port to be there, to be free, and for a sensor to answer. Unless set,
    /// opening fails.
    pub fn wait_for_sensor(mut self) -> Self {
        self.config.wait_for_sensor = true;
        self
    }

    /// Whether a port that was lost is opened again. It is unless set to
    /// `false`; then the driver ends with [`Error::Disconnected`].
    pub fn reconnect(mut self, reconnect: bool) -> Self {
        self.config.reconnect = reconnect;
        self
    }

    /// How long to wait before a port is opened again: the start of the range at
    /// first, twice as long each time, up to its end, each lengthened at random
    /// by up to a tenth. 0.1 s to 1 s unless set; bounds are held within 10 ms
    /// to a day, and the end is at least the start. A link that lasted begins
    /// with the start again.
    pub fn backoff(mut self, range: RangeInclusive<Duration>) -> Self {
        let (shortest, longest) = range.into_inner();
        let shortest = shortest.clamp(SHORTEST_BACKOFF, LONGEST);
        self.config.backoff = (shortest, longest.clamp(shortest, LONGEST));
        self
    }

    /// Makes what is random repeatable, for simulations: the back-off, and the
    /// step of the first fence.
    pub fn jitter_seed(mut self, seed: u64) -> Self {
        self.config.jitter_seed = Some(seed);
        self
    }

    /// The serial number of the sensor, as in its `SERI:` line: any other one
    /// is [`Error::AnotherSensor`]. Unless set, the first sensor found is the
    /// one that is expected after a reconnect.
    ///
    /// Takes a text, or the [`serial_number`](crate::Version::serial_number) that
    /// a sensor gave. To look for a sensor on all ports, open
    /// [`Endpoint::SerialNumber`] instead, `serial:H0713090`.
    pub fn serial_number(mut self, serial_number: impl Into<Text>) -> Self {
        self.config.serial_number = Some(serial_number.into());
        self
    }

    /// Accepts any sensor after a reconnect, such as a spare in the place of one
    /// that failed: it is set like the one before, and its serial number is in
    /// [`State::Connected`](crate::State::Connected). Unless set, another sensor
    /// is refused with [`Error::AnotherSensor`]. Without effect where
    /// [`serial_number`](Self::serial_number) was set.
    pub fn any_sensor(mut self) -> Self {
        self.config.any_sensor = true;
        self
    }

    /// How many scans a stream keeps for a consumer that is slow, at least 1. 1
    /// unless set: the newest. Who wants every scan asks for more: a recorder, or
    /// a replay as fast as it goes, which is faster than any consumer.
    pub fn ring_depth(mut self, scans: usize) -> Self {
        self.config.ring_depth = scans.max(1);
        self
    }

    /// How long the sensor may take to answer, the time on the line not
    /// counted, at most a day. Unless set, 500 ms for `G` and 1 s for the other
    /// commands.
    pub fn reply_latency(mut self, latency: Duration) -> Self {
        self.config.reply_latency = Some(latency.min(LONGEST));
        self
    }

    /// Sets the time without an exchange after which the driver probes the sensor, or
    /// switches the probe off with `None`. Unless set, 5 s on links that can be lost
    /// without a word ([`Port::can_die_silently`](crate::Port::can_die_silently): TCP and
    /// RS-232), and off on others.
    ///
    /// Without a probe, a link that died silently shows as
    /// [`State::Connected`](crate::State::Connected) until the next request or poll. A
    /// probe is a fence: 10 bytes to the sensor and at most 16 back, on RS-232 at 19,200
    /// baud 14 ms of the line. A request that comes
    /// meanwhile waits for its end. Streams that poll more often are not probed. A probe
    /// without an answer is repeated as any fence. After 10 s in all, with the default
    /// interval, the link counts as lost, and the driver reconnects. With the laser switched off it also finds a sensor that has
    /// restarted, and switches its laser off again.
    ///
    /// From 100 ms to a day.
    pub fn idle_probe(mut self, interval: Option<Duration>) -> Self {
        self.config.idle_probe = match interval {
            Some(interval) => IdleProbe::Every(interval.clamp(SHORTEST_PROBE, LONGEST)),
            None => IdleProbe::Off,
        };
        self
    }

    /// Hands every reply to `observer`, its bytes as the sensor sent them: to record
    /// it, or to log it. Unless set, nobody keeps them, and nothing is paid.
    ///
    /// It is called in the driver's task, once for each frame, fences and damaged
    /// replies included, and before a scan is delivered: it must not block. There
    /// is one observer: a second one takes the place of the first.
    ///
    /// ```
    /// # use tokio_scip::{Sensor, Window, emulator::Emulator};
    /// # #[tokio::main(flavor = "current_thread", start_paused = true)]
    /// # async fn main() -> Result<(), tokio_scip::Error> {
    /// let (sender, mut replies) = tokio::sync::mpsc::unbounded_channel();
    /// let builder = Sensor::builder().on_reply(move |heard| {
    ///     // Nobody listens any more: that is fine.
    ///     let _ = sender.send((heard.command, heard.bytes.to_vec()));
    /// });
    /// let sensor = builder.connect(Emulator::default()).await?;
    /// // Whatever a sensor is opened with: a fence, and then `V`.
    /// assert!(matches!(replies.recv().await, Some((None, _))));
    /// let (_, version) = replies.recv().await.ok_or(tokio_scip::Error::Closed)?;
    /// assert!(version.starts_with(b"V\n0\nVEND:Hokuyo"));
    /// # Ok(())
    /// # }
    /// ```
    pub fn on_reply(mut self, observer: impl Fn(RawReply<'_>) + Send + Sync + 'static) -> Self {
        self.config.observer = ReplyObserver::new(observer);
        self
    }

    /// Opens `endpoint`, see [`Sensor::open`].
    ///
    /// # Errors
    ///
    /// See [`Sensor::open`]. If this future is dropped the port is closed.
    ///
    /// # Panics
    ///
    /// Outside of a tokio runtime, as `tokio::spawn` does.
    pub async fn open<E>(self, endpoint: E) -> Result<Sensor, Error>
    where
        E: TryInto<Endpoint>,
        E::Error: Into<Error>,
    {
        let endpoint = endpoint.try_into().map_err(Into::into)?;
        self.connect(endpoint.into_connector()).await
    }

    /// Uses a stream that is open already, see [`Sensor::attach`].
    ///
    /// # Errors
    ///
    /// See [`Sensor::attach`].
    ///
    /// # Panics
    ///
    /// Outside of a tokio runtime, as `tokio::spawn` does.
    pub async fn attach<T>(mut self, stream: T) -> Result<Sensor, Error>
    where
        T: AsyncRead + AsyncWrite + Send + Unpin + 'static,
    {
        self.config.reconnect = false;
        self.config.wait_for_sensor = false;
        self.connect(Attached::new(stream)).await
    }

    /// Opens a sensor through one's own [`Connect`], on a driver that is spawned
    /// on the current tokio runtime.
    ///
    /// # Errors
    ///
    /// See [`Sensor::open`]. If this future is dropped the port is closed.
    ///
    /// # Panics
    ///
    /// Outside of a tokio runtime, as `tokio::spawn` does.
    pub async fn connect(self, connect: impl Connect) -> Result<Sensor, Error> {
        let (sensor, driver) = self.build(connect);
        tokio::spawn(driver);
        sensor.opened().await?;
        Ok(sensor)
    }

    /// A handle, and the driver for it, to be spawned as one likes. Nothing is
    /// opened before the driver runs; requests wait for it.
    pub fn build(self, connect: impl Connect) -> (Sensor, Driver) {
        let (client, driver) = driver::new(connect, self.config);
        (Sensor { client }, driver)
    }
}
