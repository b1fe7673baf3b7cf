//! [`Sensor`], the handle that a service holds, and its builder.

use std::ops::RangeInclusive;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::watch;

use crate::driver::{self, Client, Config, Driver, Request};
use crate::port::{Attached, Connect, Endpoint};
use crate::protocol::Version;
use crate::state::{State, Stats};
use crate::tap::{Heard, Tap};
use crate::{BaudRate, Error, Rate, Scan, ScanStream, Window};

/// A URG sensor.
///
/// A handle to the task that owns the port: cheap to clone, all methods take
/// `&self`, and all clones share one driver. Requests are served one at a time,
/// first come, first served, and in turn with the polls of streams.
///
/// The driver ends, and the port is closed, when the last handle and the last
/// stream are gone, or on [`close`](Self::close). Dropping a handle never
/// blocks, never spawns, and is fine outside of a runtime.
///
/// # Cancel safety
///
/// Dropping any future of this type at any await loses nothing and disturbs
/// nothing: a request that was not written yet is skipped; one that was written
/// is carried out, its reply is read to the end and dropped.
///
/// # Errors
///
/// While there is no link a request waits for one, at most for the
/// [open timeout](SensorBuilder::open_timeout), and then fails with
/// [`Error::Disconnected`]. A reply that does not come, or comes damaged, is
/// asked for once more where that is harmless, and then is
/// [`Error::Timeout`] or [`Error::Malformed`]; a status other than success is
/// [`Error::Refused`]. Once the driver has ended every call fails with the
/// cause, or [`Error::Closed`].
#[derive(Debug, Clone)]
pub struct Sensor {
    client: Client,
}

impl Sensor {
    /// Opens the sensor behind `endpoint` with the builder's defaults, on a
    /// driver that is spawned on the current tokio runtime.
    ///
    /// Takes an [`Endpoint`] or a text that names one, such as
    /// `/dev/ttyACM0`, `COM3`, `tcp://host:port?baud=115200` or
    /// `serial:H0713090`.
    ///
    /// # Errors
    ///
    /// What cannot get better by itself is told at once, each with a kind of
    /// its own: no such port, not a serial port, no permission, in use, SCIP 2,
    /// a loopback. [`Error::NoAnswer`] comes after the open timeout (5 s).
    ///
    /// # Panics
    ///
    /// Outside of a tokio runtime, as `tokio::spawn` does.
    pub async fn open<E>(endpoint: E) -> Result<Self, Error>
    where
        E: TryInto<Endpoint>,
        E::Error: Into<Error>,
    {
        Self::builder().open(endpoint).await
    }

    /// Uses a stream that is open already: a socket, a pipe, an emulated
    /// sensor. It is taken to have no line speed, and is never reopened: when
    /// it ends, the driver ends.
    ///
    /// # Errors
    ///
    /// As [`open`](Self::open), but for those of opening a port.
    ///
    /// # Panics
    ///
    /// Outside of a tokio runtime, as `tokio::spawn` does.
    pub async fn attach<T>(stream: T) -> Result<Self, Error>
    where
        T: AsyncRead + AsyncWrite + Send + Unpin + 'static,
    {
        Self::builder().attach(stream).await
    }

    /// A builder, for all that [`open`](Self::open) takes for granted.
    pub fn builder() -> SensorBuilder {
        SensorBuilder::default()
    }

    /// Who the sensor is (`V`, C-42-3320-A p. 4).
    ///
    /// The sensor was asked when it was opened; the answer is kept until the
    /// link is lost.
    pub async fn version(&self) -> Result<Version, Error> {
        match self.client.telemetry().version() {
            Some(version) => Ok(version),
            None => self.client.ask(Request::Version).await,
        }
    }

    /// Switches the laser on (`L1`, p. 4), and makes sure that it is. No error
    /// if it is on already.
    ///
    /// The driver remembers it, also if this call fails or is dropped after it
    /// was written, and restores it whenever the sensor was away.
    pub async fn laser_on(&self) -> Result<(), Error> {
        self.client.ask(|promise| Request::Laser { on: true, promise }).await
    }

    /// Switches the laser off (`L0`, p. 4), and makes sure that it is: the
    /// sensor refuses to measure. No error if it is off already.
    ///
    /// Streams rest until [`laser_on`](Self::laser_on). The driver remembers
    /// it, also if this call fails or is dropped after it was written, and
    /// restores it whenever the sensor was away. A sensor that resets itself
    /// switches its laser on; on USB, and while nothing is asked of it, that
    /// shows only if bytes come that nobody asked for.
    pub async fn laser_off(&self) -> Result<(), Error> {
        self.client.ask(|promise| Request::Laser { on: false, promise }).await
    }

    /// Moves sensor and port to another line speed (`S`, p. 5), and makes sure
    /// that they meet there; about half a second. The driver restores it
    /// whenever the sensor was away. A sensor on USB accepts it without effect.
    ///
    /// # Errors
    ///
    /// [`Error::UnsupportedSpeed`] before the sensor is told anything, if the
    /// port cannot be set to this speed or, as a TCP connection, to any.
    /// [`Error::NotConfirmed`] if the sensor accepted and stayed where it was.
    pub async fn set_baud_rate(&self, speed: BaudRate) -> Result<(), Error> {
        self.client.ask(|promise| Request::BaudRate { speed, promise }).await
    }

    /// A single scan of `window`, asked for now (`G`, p. 5).
    ///
    /// # Errors
    ///
    /// [`Error::LaserOff`] after [`laser_off`](Self::laser_off).
    pub async fn scan(&self, window: Window) -> Result<Scan, Error> {
        self.client.ask(|promise| Request::Scan { window, promise }).await
    }

    /// A stream of scans of `window` at `rate`, beginning with the next one.
    ///
    /// Polls lie on a fixed grid, without drift. One that falls due while the
    /// line is busy is sent as soon as it is free; further ones are dropped,
    /// never made up. Streams of the same window and rate share their polls. A
    /// rate that the line cannot carry is no error: log and
    /// [`stats`](Self::stats) tell what is reached, and
    /// [`Window::wire_time`] tells beforehand.
    pub async fn scans(&self, window: Window, rate: Rate) -> Result<ScanStream, Error> {
        let subscribe = |promise| Request::Subscribe { window, rate, promise };
        let cursor = self.client.ask(subscribe).await?;
        Ok(ScanStream::new(cursor, window, rate, self.client.clone()))
    }

    /// What happened since the driver began.
    pub fn stats(&self) -> Stats {
        self.client.telemetry().stats().clone()
    }

    /// A watch of what the driver is about.
    ///
    /// What the receiver's `borrow`, `borrow_and_update` and `wait_for` give is a
    /// lock: while it is held the driver cannot go on to another state. Clone the
    /// [`State`] out of it, and hold no borrow across an await.
    ///
    /// ```
    /// # use tokio_scip::emulator::Emulator;
    /// use tokio_scip::{Sensor, State};
    ///
    /// # #[tokio::main(flavor = "current_thread", start_paused = true)]
    /// # async fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # let sensor = Sensor::builder().connect(Emulator::default()).await?;
    /// let mut state = sensor.state();
    /// let connected = |state: &State| matches!(state, State::Connected { .. });
    /// let now = state.wait_for(connected).await?.clone(); // the borrow ends here
    /// println!("{now:?}");
    /// # assert!(connected(&now));
    /// # Ok(())
    /// # }
    /// ```
    pub fn state(&self) -> watch::Receiver<State> {
        self.client.telemetry().watch()
    }

    /// Ends the driver and closes the port. Requests that were made before are
    /// answered first, if there is a link; later ones fail with
    /// [`Error::Closed`], and streams end. No error if it has ended already.
    pub async fn close(&self) {
        // The only answer is that the driver has ended, one way or the other.
        let _ = self.client.ask(Request::Close).await;
    }
}

/// The longest time that can be set: long enough to mean for ever, and no
/// instant overflows.
const LONGEST: Duration = Duration::from_secs(24 * 60 * 60);
/// A shorter wait would be a busy loop.
const SHORTEST_BACKOFF: Duration = Duration::from_millis(10);

/// Says how a [`Sensor`] is opened and kept.
#[derive(Debug, Clone, Default)]
#[must_use = "a builder does nothing until it opens a sensor"]
pub struct SensorBuilder {
    config: Config,
}

impl SensorBuilder {
    /// The line speed to run at. The sensor is found at whatever speed it has,
    /// and moved to this one. Unless set, it is left at the one it has (19,200
    /// baud after power-up). Without effect on USB.
    pub fn baud_rate(mut self, speed: BaudRate) -> Self {
        self.config.baud_rate = Some(speed);
        self
    }

    /// How long to look for a sensor on a port, and how long a request waits
    /// for a link. 5 s unless set: two passes over the six line speeds.
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
    pub fn serial_number(mut self, serial_number: impl AsRef<str>) -> Self {
        self.config.serial_number = Some(serial_number.as_ref().into());
        self
    }

    /// How many scans a stream keeps for a consumer that is slow. 1 unless set:
    /// the newest. A recorder wants more.
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

    /// Hands every reply to `tap`, its bytes as the sensor sent them: to record
    /// it, or to log it. Unless set, nobody keeps them, and nothing is paid.
    ///
    /// It is called in the driver's task, once for each frame, fences and damaged
    /// replies included, and before a scan is delivered: it must not block.
    ///
    /// ```
    /// # use tokio_scip::{Sensor, Window, emulator::Emulator};
    /// # #[tokio::main(flavor = "current_thread", start_paused = true)]
    /// # async fn main() -> Result<(), tokio_scip::Error> {
    /// let (sender, mut replies) = tokio::sync::mpsc::unbounded_channel();
    /// let builder = Sensor::builder().tap(move |heard| {
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
    pub fn tap(mut self, tap: impl Fn(Heard<'_>) + Send + Sync + 'static) -> Self {
        self.config.tap = Tap::new(tap);
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

impl Sensor {
    /// Waits until the sensor answers for the first time.
    ///
    /// [`SensorBuilder::connect`] and its like have done so already; this is
    /// for those who [build](SensorBuilder::build) and spawn by themselves.
    /// Cancel-safe.
    ///
    /// # Errors
    ///
    /// Why the driver ended, if it did.
    pub async fn opened(&self) -> Result<(), Error> {
        let mut state = self.state();
        let open = |state: &State| !matches!(state, State::Connecting { .. });
        match state.wait_for(open).await.as_deref() {
            Ok(State::Closed { .. }) | Err(_) => Err(self.client.telemetry().cause()),
            Ok(_) => Ok(()),
        }
    }
}
