//! [`SensorBuilder`]: the settings with which a sensor is opened and kept open.

use std::ops::RangeInclusive;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite};

use super::Sensor;
use crate::driver::{self, Config, Driver, IdleProbe};
use crate::observer::{RawReply, ReplyObserver};
use crate::port::{Attached, Connect, Endpoint};
use crate::protocol::Text;
use crate::{BaudRate, Error};

/// The longest time that can be set: no instant overflows.
const LONGEST: Duration = Duration::from_secs(24 * 60 * 60);
/// A shorter wait would be a busy loop.
const SHORTEST_BACKOFF: Duration = Duration::from_millis(10);

/// A shorter interval would keep the line busy with probes.
const SHORTEST_PROBE: Duration = Duration::from_millis(100);

/// A builder of a [`Sensor`]. Every setting has a default, which its method documents.
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
    /// Sets the name of the sensor in logs and errors. Unless set, it is that of the
    /// [port](Connect::name), such as `/dev/ttyACM0`.
    ///
    /// The driver logs inside of a span `sensor` with this `name`, whose parent is the
    /// span in which the driver is built.
    pub fn name(mut self, name: impl Into<String>) -> Self {
        self.config.name = Some(name.into().into());
        self
    }

    /// Sets the baud rate to run at. The sensor's current one is detected and changed to
    /// this. Unless set, the sensor keeps its own (19,200 baud after power-up). Without
    /// effect on USB.
    pub fn baud_rate(mut self, baud_rate: BaudRate) -> Self {
        self.config.baud_rate = Some(baud_rate);
        self
    }

    /// Sets the time to search for a sensor on a port, which is also the time that a
    /// request waits for a link. 5 s unless set: two passes over the six baud rates. At
    /// most a day.
    pub fn open_timeout(mut self, timeout: Duration) -> Self {
        self.config.open_timeout = timeout.min(LONGEST);
        self
    }

    /// Makes opening wait until the sensor appears, without a limit: until the port is
    /// there, is free, and a sensor answers. Unless set, opening fails. The driver logs
    /// at level info that it waits: once for each reason, and again every ten minutes.
    pub fn wait_for_sensor(mut self) -> Self {
        self.config.wait_for_sensor = true;
        self
    }

    /// Sets whether a port is opened again after the link was lost. It is unless set to
    /// `false`; then the driver ends with [`Error::Disconnected`].
    pub fn reconnect(mut self, reconnect: bool) -> Self {
        self.config.reconnect = reconnect;
        self
    }

    /// Sets the wait before a port is opened again: the start of the range at first,
    /// twice as long each time, up to its end, each lengthened at random by up to a
    /// tenth. 0.1 s to 1 s unless set; bounds are held within 10 ms to a day, and the end
    /// is at least the start. After a link that lasted the wait is the start again.
    pub fn backoff(mut self, range: RangeInclusive<Duration>) -> Self {
        let (shortest, longest) = range.into_inner();
        let shortest = shortest.clamp(SHORTEST_BACKOFF, LONGEST);
        self.config.backoff = (shortest, longest.clamp(shortest, LONGEST));
        self
    }

    /// Sets the seed of everything random, for repeatable simulations: the back-off, and
    /// the step of the first fence.
    pub fn jitter_seed(mut self, seed: u64) -> Self {
        self.config.jitter_seed = Some(seed);
        self
    }

    /// Sets the serial number of the sensor, as in its `SERI:` line: a sensor with
    /// another one is [`Error::AnotherSensor`]. Unless set, the first sensor that is
    /// found is the one that is expected after a reconnect.
    ///
    /// Takes a text, or the [`serial_number`](crate::Version::serial_number) of a sensor.
    /// To search for a sensor on all ports, open [`Endpoint::SerialNumber`] instead,
    /// `serial:H0713090`.
    pub fn serial_number(mut self, serial_number: impl Into<Text>) -> Self {
        self.config.serial_number = Some(serial_number.into());
        self
    }

    /// Accepts any sensor after a reconnect, such as a spare in the place of one that
    /// failed: the driver applies the same settings, and
    /// [`State::Connected`](crate::State::Connected) has its serial number. Unless set, another sensor
    /// is refused with [`Error::AnotherSensor`]. Without effect where
    /// [`serial_number`](Self::serial_number) was set.
    pub fn any_sensor(mut self) -> Self {
        self.config.any_sensor = true;
        self
    }

    /// Sets the number of scans that streams keep for a slow consumer, at least 1. 1
    /// unless set: the newest. [`StreamBuilder::depth`](crate::StreamBuilder::depth) sets
    /// it for one stream. A consumer that needs every scan needs more: a recorder, or a
    /// replay at full speed, which is faster than any consumer.
    pub fn ring_depth(mut self, scans: usize) -> Self {
        self.config.ring_depth = scans.max(1);
        self
    }

    /// Sets the time that the sensor may take to answer, the time on the line not
    /// counted, at most a day. Unless set, 500 ms for `G` and 1 s for the other commands.
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
    /// baud 14 ms of the line. Over TCP, with the default interval, an idle hour was
    /// measured to cost 110 kB in each direction, headers included, and 0.25 s of CPU. A
    /// request that comes meanwhile waits for its end. Streams that poll more often are
    /// not probed. A probe without an answer is repeated as any fence. After 10 s in all
    /// at most, with the default interval, the link counts as lost, and the driver
    /// reconnects. With the laser
    /// switched off it also finds a sensor that has restarted, and switches its laser off
    /// again.
    ///
    /// From 100 ms to a day.
    pub fn idle_probe(mut self, interval: Option<Duration>) -> Self {
        self.config.idle_probe = match interval {
            Some(interval) => IdleProbe::Every(interval.clamp(SHORTEST_PROBE, LONGEST)),
            None => IdleProbe::Off,
        };
        self
    }

    /// Sets an observer of every reply, in the bytes that the sensor sent: to record it,
    /// or to log it.
    ///
    /// The observer is called in the driver's task, once for each frame, fences and
    /// malformed replies included, and before a scan is delivered: it must not block.
    /// There is one observer: a second one replaces the first.
    ///
    /// ```
    /// # use tokio_scip::{Sensor, Window, emulator::Emulator};
    /// # #[tokio::main(flavor = "current_thread", start_paused = true)]
    /// # async fn main() -> Result<(), tokio_scip::Error> {
    /// let (sender, mut replies) = tokio::sync::mpsc::unbounded_channel();
    /// let builder = Sensor::builder().on_reply(move |reply| {
    ///     // The receiver may be gone.
    ///     let _ = sender.send((reply.command, reply.bytes.to_vec()));
    /// });
    /// let sensor = builder.connect(Emulator::default()).await?;
    /// // A sensor is opened with a fence, and then `V`.
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
        start(self.build_for(endpoint)).await
    }

    /// Opens the sensor behind a byte stream that is open already, see
    /// [`Sensor::attach`].
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
        start(self.build(connect)).await
    }

    /// Returns a handle, and the driver for it, which the caller spawns. Nothing is
    /// opened before the driver runs; requests wait for it.
    pub fn build(self, connect: impl Connect) -> (Sensor, Driver) {
        let (client, driver) = driver::new(Box::new(connect), self.config);
        (Sensor { client }, driver)
    }

    /// Does the same for an endpoint. Not generic, so that its connector is compiled with
    /// this crate, and not in each program that uses it.
    fn build_for(self, endpoint: Endpoint) -> (Sensor, Driver) {
        self.build(endpoint.into_connector())
    }
}

/// Spawns the driver, and waits until the sensor is open.
async fn start((sensor, driver): (Sensor, Driver)) -> Result<Sensor, Error> {
    tokio::spawn(driver);
    sensor.opened().await?;
    Ok(sensor)
}
