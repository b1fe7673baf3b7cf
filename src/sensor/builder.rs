//! [`SensorBuilder`]: the settings with which a sensor is opened and kept open.

use std::io;
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite};

use super::Sensor;
use crate::RawReply;
use crate::driver::{self, Config, Driver, IdleProbe};
use crate::port::{Connect, Endpoint, StreamPort};
use crate::protocol::{Protocol, Text};
use crate::{BaudRate, Error, ErrorKind, State};

/// Longest time that you can set, so that no instant overflows.
const LONGEST: Duration = Duration::from_secs(24 * 60 * 60);
/// A shorter wait would be a busy loop, and so would a shorter time limit in a search for the sensor.
const SHORTEST: Duration = Duration::from_millis(10);
/// A shorter interval would keep the line busy with probes.
const SHORTEST_PROBE: Duration = Duration::from_millis(100);

/// Builder of a [`Sensor`]. Every setting has a default, documented at its method.
///
/// ```no_run
/// use tokio_scip::{BaudRate, Sensor};
///
/// # async fn open() -> Result<(), tokio_scip::Error> {
/// // A service that may start before its sensor, and accepts only this sensor.
/// let sensor = Sensor::builder()
///     .wait_for_sensor(true)
///     .serial_number("H0713090")
///     .baud_rate(BaudRate::B115200) // no effect on USB
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
    /// Sets the name of the sensor in logs and errors. Default: the name of the
    /// [port](Connect::name), such as `/dev/ttyACM0`.
    ///
    /// The driver logs inside a span `sensor`, whose field `sensor` is this name. It is a child of the
    /// span that is current when you build the driver.
    pub fn name(mut self, name: impl Into<String>) -> Self {
        self.config.name = Some(name.into().into());
        self
    }

    /// Sets the baud rate to run at. The driver detects the sensor's current baud rate and changes
    /// it. By default the sensor keeps its own (usually 19,200 after power-up). No effect on USB.
    pub fn baud_rate(mut self, baud_rate: BaudRate) -> Self {
        self.config.baud_rate = Some(baud_rate);
        self
    }

    /// Sets the protocol to speak. By default the driver finds out which one the sensor speaks, and
    /// sends nothing of SCIP 2 to a sensor that answers in SCIP 1.1.
    ///
    /// - [`Protocol::Scip2`] asks a URG-04LX to speak SCIP 2, again after each power-up. It then
    ///   measures up to 5.6 m, and its replies have sums.
    /// - [`Protocol::Scip1`] accepts no sensor of SCIP 2.
    ///
    /// A sensor that does not speak this protocol is an
    /// [`ErrorKind::WrongProtocol`](crate::ErrorKind::WrongProtocol).
    pub fn protocol(mut self, protocol: Protocol) -> Self {
        self.config.wanted.protocol = Some(protocol);
        self
    }

    /// Sets whether scans have [intensities](crate::Scan::intensities), where the sensor has them: a
    /// UTM or UST. They double the length of a reply. ROS's hokuyo_node 1.7.8 asks a UTM-30LX for no more
    /// than 95° of them, because more crashed its firmware or spoiled the data. Default: `false`.
    ///
    /// ```
    /// # use tokio_scip::{Sensor, Window};
    /// # use urg_emulator::{Emulator, Model};
    /// # #[tokio::main(flavor = "current_thread", start_paused = true)]
    /// # async fn main() -> Result<(), tokio_scip::Error> {
    /// # let ust = Emulator::builder().model(Model::Ust10lx).build();
    /// // With a UST on Ethernet: .open("tcp://192.168.0.10").await?
    /// let sensor = Sensor::builder().intensities(true).connect(ust).await?;
    /// let scan = sensor.scan(Window::degrees(-45.0..=45.0)?).await?;
    /// assert_eq!(scan.intensities().map(<[u32]>::len), Some(scan.len()));
    /// # Ok(())
    /// # }
    /// ```
    pub fn intensities(mut self, intensities: bool) -> Self {
        self.config.wanted.intensities = intensities;
        self
    }

    /// Sets the time limit for opening a port, and again for finding a sensor on it. Default: 5 s,
    /// two passes over the six baud rates. At most a day.
    pub fn open_timeout(mut self, timeout: Duration) -> Self {
        self.config.open_timeout = timeout.min(LONGEST);
        self
    }

    /// Sets how long a request waits for a link before it fails. Default: 5 s. At most a day.
    ///
    /// The time starts when the link is lost, or when you make the request if that is later. While
    /// there is a link, a request waits for its turn without a time limit.
    pub fn request_timeout(mut self, timeout: Duration) -> Self {
        self.config.request_timeout = timeout.min(LONGEST);
        self
    }

    /// Sets whether your service can start before its sensor. Default: `false`, opening fails then.
    ///
    /// With `true`, opening returns at once, and the driver waits in the background, without a time
    /// limit, until the port exists and is free and the sensor answers. Streams begin with its first
    /// scan. Until then [`freshness`](Sensor::freshness) and [`watch_state`](Sensor::watch_state) have
    /// the reason, and requests fail with it after the [request timeout](Self::request_timeout). The
    /// driver logs each reason for waiting at level info: once, and again every ten minutes.
    ///
    /// An error that waiting cannot remedy, such as
    /// [`PermissionDenied`](crate::ErrorKind::PermissionDenied), ends the driver when it repeats, and
    /// fails every call from then on.
    pub fn wait_for_sensor(mut self, wait: bool) -> Self {
        self.config.wait_for_sensor = wait;
        self
    }

    /// Sets whether to reopen the port after the link was lost. Default: `true`. With `false` the
    /// driver ends with [`Disconnected`](crate::ErrorKind::Disconnected).
    pub fn reconnect(mut self, reconnect: bool) -> Self {
        self.config.reconnect = reconnect;
        self
    }

    /// Sets the shortest and the longest delay before another attempt to open a port. It doubles
    /// after each attempt, and up to 10 % jitter is added. Default: 0.1 s to 1 s. Both are clamped
    /// to 10 ms to 1 day, and the longest is at least the shortest. After a link that lasted longer
    /// than the next delay, the delay is the shortest again.
    pub fn backoff(mut self, range: RangeInclusive<Duration>) -> Self {
        let (shortest, longest) = range.into_inner();
        let shortest = shortest.clamp(SHORTEST, LONGEST);
        self.config.backoff = (shortest, longest.clamp(shortest, LONGEST));
        self
    }

    /// Sets the serial number that you expect, as in the sensor's `SERI:` line. The driver refuses
    /// any other sensor with [`AnotherSensor`](crate::ErrorKind::AnotherSensor). By default it
    /// accepts the first sensor that it finds, and after a reconnect expects the same one.
    ///
    /// Pass a string, or the [`serial_number`](crate::Version::serial_number) of a sensor. To
    /// search all ports for a sensor, open [`Endpoint::SerialNumber`] (`serial:H0713090`) instead.
    pub fn serial_number(mut self, serial_number: impl Into<Text>) -> Self {
        self.config.serial_number = Some(serial_number.into());
        self
    }

    /// Sets whether to accept any sensor after a reconnect, such as a spare in place of a broken
    /// one. The driver applies the same settings to it, and
    /// [`State::Connected`](crate::State::Connected) has its serial number. Default: `false`, the
    /// driver refuses it with [`AnotherSensor`](crate::ErrorKind::AnotherSensor). No
    /// effect if you set [`serial_number`](Self::serial_number).
    pub fn any_sensor(mut self, any: bool) -> Self {
        self.config.any_sensor = any;
        self
    }

    /// Sets the number of scans that streams keep for a slow consumer, at least 1. Default: 1, the
    /// newest scan. To set it for one stream, use
    /// [`StreamBuilder::depth`](crate::stream::StreamBuilder::depth). Set more if you need every
    /// scan, as in a recorder, or in a replay at full speed, which is faster than any consumer.
    pub fn depth(mut self, scans: usize) -> Self {
        self.config.depth = scans.max(1);
        self
    }

    /// Sets how long the sensor may take to answer, in addition to the time on the line. Default:
    /// 500 ms for a scan, 400 ms for a restart, and 1 s for the other commands. Clamped to 10 ms and a
    /// day. No effect on the search for the baud rate, which waits for 400 ms.
    pub fn reply_latency(mut self, latency: Duration) -> Self {
        self.config.reply_latency = Some(latency.clamp(SHORTEST, LONGEST));
        self
    }

    /// Sets how long the sensor may be silent before the driver probes it. Pass `None` to switch
    /// the probe off. Default: 5 s on links that can fail silently
    /// ([`PortHints::can_die_silently`](crate::port::PortHints::can_die_silently): TCP and RS-232),
    /// and off on other links.
    ///
    /// Without a probe, a link that died silently shows as
    /// [`State::Connected`](crate::State::Connected) until your next request or poll. A probe asks for
    /// one step. In SCIP 1.1 it is a [fence](crate::guide::trust): 10 bytes to the sensor and at most
    /// 16 back, which take 14 ms at 19,200 baud. Over TCP, at the default interval, an idle hour cost
    /// 110 kB in each direction, headers included, and 0.25 s of CPU. A request that arrives during a
    /// probe waits for its end. While a stream polls more often than the interval, there are no probes.
    /// The driver repeats an unanswered probe like any fence. At the default interval a silent link
    /// counts as lost after at most 10 s, and the driver reconnects. While the laser is switched off,
    /// the probe also finds a sensor that has restarted, and the driver switches its laser off again.
    ///
    /// Clamped to 100 ms to 1 day.
    pub fn idle_probe(mut self, interval: Option<Duration>) -> Self {
        self.config.idle_probe = match interval {
            Some(interval) => IdleProbe::Every(interval.clamp(SHORTEST_PROBE, LONGEST)),
            None => IdleProbe::Off,
        };
        self
    }

    /// Sets an observer of every reply, to record or log the bytes that the sensor sent.
    ///
    /// The driver calls your observer in its task, once for each frame, including fences and malformed
    /// replies, and before it delivers a scan. The observer must not block. You can set several; they
    /// are called in order. To observe a sensor that is already open, use [`Sensor::observe_replies`].
    ///
    /// ```
    /// # use tokio_scip::{Sensor, Window};
    /// # use urg_emulator::Emulator;
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
    /// let (_, version) = replies.recv().await.ok_or(tokio_scip::ErrorKind::Closed)?;
    /// assert!(version.starts_with(b"V\n0\nVEND:Hokuyo"));
    /// # Ok(())
    /// # }
    /// ```
    pub fn on_reply(mut self, observer: impl Fn(RawReply<'_>) + Send + Sync + 'static) -> Self {
        Arc::make_mut(&mut self.config.observers).add(observer);
        self
    }

    /// Opens `endpoint`, as [`Sensor::open`] does. Dropping this future closes the port.
    pub async fn open<E>(self, endpoint: E) -> Result<Sensor, Error>
    where
        E: TryInto<Endpoint>,
        E::Error: Into<Error>,
    {
        let endpoint = endpoint.try_into().map_err(Into::into)?;
        let waits = self.config.wait_for_sensor;
        opened(self.build_for(endpoint), waits).await
    }

    /// Opens the sensor behind an open byte stream: a socket, a pipe, an emulated sensor. The stream
    /// has no baud rate (its speed is measured), and is never reopened: when it ends, the driver ends.
    ///
    /// Fails and panics as [`Sensor::open`] does, but for the errors of opening a port.
    pub async fn attach<T>(mut self, stream: T) -> Result<Sensor, Error>
    where
        T: AsyncRead + AsyncWrite + Send + Unpin + 'static,
    {
        self.config.reconnect = false;
        self.config.wait_for_sensor = false;
        let mut stream = Some(stream);
        let open_once = move || {
            let gone = || ErrorKind::disconnected(Some(io::ErrorKind::BrokenPipe.into()));
            std::future::ready(stream.take().map(StreamPort::new).ok_or_else(|| gone().into()))
        };
        self.connect(open_once).await
    }

    /// Opens a sensor through your own [`Connect`], with the errors and the panic of [`Sensor::open`].
    /// Dropping this future closes the port.
    pub async fn connect(self, connect: impl Connect) -> Result<Sensor, Error> {
        let waits = self.config.wait_for_sensor;
        opened(self.build(connect), waits).await
    }

    /// Builds a handle and its driver. Spawn the driver: it opens the port when it first runs.
    pub fn build(self, connect: impl Connect) -> (Sensor, Driver) {
        let (client, driver) = driver::new(Box::new(connect), self.config);
        (Sensor { client }, driver)
    }

    /// Does the same for an endpoint. Not generic, so that its connector is compiled with this crate.
    fn build_for(self, endpoint: Endpoint) -> (Sensor, Driver) {
        self.build(endpoint.into_connector())
    }
}

/// Spawns the driver. Waits for the sensor's first answer, unless the driver waits for the sensor.
async fn opened((sensor, driver): (Sensor, Driver), waits: bool) -> Result<Sensor, Error> {
    tokio::spawn(driver);
    if !waits {
        let is_open =
            |state: &State| !matches!(state, State::Connecting { .. } | State::Closed { .. });
        sensor.watch_state().wait_for(is_open).await?;
    }
    Ok(sensor)
}
