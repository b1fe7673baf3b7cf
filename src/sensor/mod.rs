//! [`Sensor`], the handle that a service holds: it sends requests to the driver, or reads its reports.

mod builder;

pub use self::builder::SensorBuilder;
use crate::RawReply;
use crate::driver::{Client, ReplyObservation, Request};
use crate::port::Endpoint;
use crate::protocol::scip2::{Parameters, State};
use crate::protocol::{Command, Protocol, Version};
use crate::state::{Freshness, LinkState, StateWatch};
use crate::stats::Stats;
use crate::stream::StreamBuilder;
use crate::{BaudRate, Error, Geometry, Rate, Scan, Window};

/// Handle to a URG sensor.
///
/// The handle talks to the driver, a task that owns the port. Cloning the handle is cheap, all
/// methods take `&self`, and all clones share one driver. The driver serves requests one at a time,
/// first come, first served, and alternates them with the polls of streams.
///
/// The driver stops and closes the port when you drop the last handle and the last stream, or on
/// [`close`](Self::close). Dropping a handle never blocks or spawns, and needs no runtime.
///
/// # Cancel safety
///
/// All futures of this type are cancel-safe. If you drop one before its request was written, the
/// driver skips it; after that the sensor carries it out, and the driver drops the reply.
///
/// # Errors
///
/// While there is no link, a request waits for one. After the [request
/// timeout](SensorBuilder::request_timeout) it fails with the reason why there is none, as in
/// [`watch_state`](Self::watch_state). A command without a complete reply is repeated once if that is
/// harmless, and then fails with [`Timeout`](crate::ErrorKind::Timeout) or
/// [`Malformed`](crate::ErrorKind::Malformed). A status other than success is
/// [`Refused`](crate::ErrorKind::Refused). Once the driver has ended, every call fails with the cause, or
/// [`Closed`](crate::ErrorKind::Closed).
#[derive(Debug, Clone)]
pub struct Sensor {
    client: Client,
}

impl Sensor {
    /// Opens the sensor behind `endpoint` by the builder's defaults. Spawns on the current runtime.
    ///
    /// Pass an [`Endpoint`], a path, or a string that names an endpoint, such as `/dev/ttyACM0`,
    /// `COM3`, `tcp://host:port?baud=115200` or `serial:H0713090`.
    ///
    /// # Errors
    ///
    /// Fails at once with [`InvalidEndpoint`](crate::ErrorKind::InvalidEndpoint),
    /// [`NoSuchPort`](crate::ErrorKind::NoSuchPort),
    /// [`NotASerialPort`](crate::ErrorKind::NotASerialPort), [`Busy`](crate::ErrorKind::Busy),
    /// [`PermissionDenied`](crate::ErrorKind::PermissionDenied), [`Loopback`](crate::ErrorKind::Loopback),
    /// or [`Open`](crate::ErrorKind::Open) for other errors of the system. Fails with `Open`, too, if the
    /// port does not open within the open timeout (5 s), and with
    /// [`NoAnswer`](crate::ErrorKind::NoAnswer) if no sensor answers within the same time after that.
    /// A search for a serial number ends with [`NoSuchSensor`](crate::ErrorKind::NoSuchSensor).
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

    /// Creates a builder, to change the settings of [`open`](Self::open).
    pub fn builder() -> SensorBuilder {
        SensorBuilder::default()
    }

    /// Identity of the sensor, as the driver read it when it opened the link (`V`, p. 4 of the
    /// protocol text C-42-3320-A; `VV` in SCIP 2). Sends no command, so the `STAT:` line may be
    /// outdated. Waits for a link if there is none.
    pub async fn version(&self) -> Result<Version, Error> {
        self.known(LinkState::version_reply).await.map(|reply| reply.version)
    }

    /// Directions and distances that the sensor measures, as it told them when the driver opened the
    /// link (`PP`; in SCIP 1.1 the bracket in the firmware line, and the protocol text for what that
    /// lacks). Waits for a link if there is none.
    pub async fn geometry(&self) -> Result<Geometry, Error> {
        self.known(LinkState::geometry).await
    }

    /// Returns what is known of the sensor while there is a link. Waits for one if there is none.
    async fn known<T>(&self, known: impl Fn(&LinkState) -> Option<T>) -> Result<T, Error> {
        loop {
            if let Some(known) = known(&self.client.shared.link) {
                return Ok(known);
            }
            self.client.ask(Request::Link).await?;
        }
    }

    /// What the sensor told about itself in SCIP 2 (`PP`) when the driver opened the link: its model,
    /// and its geometry in numbers. `None` in SCIP 1.1, and without a link.
    pub fn parameters(&self) -> Option<Parameters> {
        Some(self.client.shared.link.version_reply()?.parameters?.parameters.clone())
    }

    /// Asks the sensor for its state in SCIP 2 (`II`): laser, motor, clock, and in its own words whether
    /// it works. `None` in SCIP 1.1, where [`Version::status`] is all that a sensor tells.
    ///
    /// If the sensor is sending a stream, the driver stops it, asks, and starts it again: a UTM that is
    /// asked during a stream sends only half of each scan. You lose the scans in between.
    pub async fn sensor_state(&self) -> Result<Option<State>, Error> {
        self.client.ask(Request::State).await
    }

    /// Switches the laser on (`L1`, p. 4; `BM` in SCIP 2) and confirms it, also if it is on already.
    ///
    /// The driver remembers the setting, see [`laser_off`](Self::laser_off).
    ///
    /// # Errors
    ///
    /// [`NotConfirmed`](crate::ErrorKind::NotConfirmed) if the laser stays off.
    pub async fn laser_on(&self) -> Result<(), Error> {
        self.client.ask(|responder| Request::Laser { on: true, responder }).await
    }

    /// Switches the laser off (`L0`, p. 4; `QT` in SCIP 2), and confirms it: the sensor refuses to
    /// measure. Succeeds if the laser is off already.
    ///
    /// Streams pause until you call [`laser_on`](Self::laser_on).
    ///
    /// The driver remembers the setting as soon as it takes up your call: at once without a link,
    /// otherwise between two commands. From then on you can drop the call. The driver applies the
    /// setting whenever it finds the sensor. If the laser does not follow, streams continue, and the
    /// driver tries again after 1 s to 30 s.
    ///
    /// A sensor that resets itself switches its laser on. On USB the driver notices that only at your
    /// next command, unless you set an [idle probe](SensorBuilder::idle_probe).
    ///
    /// # Errors
    ///
    /// [`NotConfirmed`](crate::ErrorKind::NotConfirmed) if the laser stays on.
    pub async fn laser_off(&self) -> Result<(), Error> {
        self.client.ask(|responder| Request::Laser { on: false, responder }).await
    }

    /// Changes the baud rate of sensor and port (`S`, p. 5; `SS` in SCIP 2), and confirms that the
    /// sensor answers at the new one. Takes up to a second. The driver restores the baud rate
    /// whenever it finds the sensor. A sensor on USB accepts it without effect.
    ///
    /// Without a link the driver remembers the baud rate, even if the call fails, and changes to it
    /// when the sensor comes back. With a link, an error other than
    /// [`Disconnected`](crate::ErrorKind::Disconnected) restores the baud rate before.
    ///
    /// # Errors
    ///
    /// [`UnsupportedBaudRate`](crate::ErrorKind::UnsupportedBaudRate) if the port cannot
    /// be set to this baud rate; nothing is sent then. A TCP connection supports only the baud rate
    /// of its endpoint. [`NotConfirmed`](crate::ErrorKind::NotConfirmed) if the sensor
    /// accepted but does not answer at this baud rate.
    pub async fn set_baud_rate(&self, baud_rate: BaudRate) -> Result<(), Error> {
        self.client.ask(|responder| Request::BaudRate { baud_rate, responder }).await
    }

    /// Restarts the sensor (`RB`, in SCIP 2), as switching its power off and on does. A sensor that refuses to
    /// measure with status `0L` is in an abnormal state: a restart ends it.
    ///
    /// Returns at most 1.5 s after the sensor has accepted the command, once it is silent. The link is lost
    /// while it starts, which takes some seconds. The driver finds it again, and restores the laser and the
    /// baud rate. [Wait](StateWatch::connected) until it has: other requests fail after the [request
    /// timeout](SensorBuilder::request_timeout). Two calls restart it twice.
    ///
    /// # Errors
    ///
    /// [`UnsupportedReboot`](crate::ErrorKind::UnsupportedReboot) in SCIP 1.1.
    pub async fn reboot(&self) -> Result<(), Error> {
        self.client.ask(Request::Reboot).await
    }

    /// Polls once for a scan of `window` (`G`, p. 5; `GD` in SCIP 2), possibly between the polls of
    /// streams. While a sensor of SCIP 2 sends a stream, returns its next scan. The scan has the
    /// sequence number 0, and no stream counts it.
    ///
    /// # Errors
    ///
    /// [`LaserOff`](crate::ErrorKind::LaserOff) after [`laser_off`](Self::laser_off),
    /// and the errors of [every request](Self#errors).
    pub async fn scan(&self, window: Window) -> Result<Scan, Error> {
        self.client.ask(|responder| Request::Scan { window, responder }).await
    }

    /// Opens a stream of scans of `window` at `rate`, starting with the next one. Await it, or set
    /// its [depth](StreamBuilder::depth) first.
    ///
    /// Polls lie on a fixed grid, without drift. A poll that falls due while the line is busy is sent
    /// as soon as the line is free. Further ones are skipped and never made up. Streams of the same
    /// window and rate share their polls. If the line cannot carry the rate, you get no error: the log
    /// and [`stats`](Self::stats) tell the achieved rate, and [`Window::wire_time`] predicts it.
    ///
    /// Returns without waiting for a scan or a link. While the link is lost, the stream starts with
    /// [`Disconnected`](crate::ErrorKind::Disconnected) or the reason of the latest attempt, and
    /// continues when the link is back. While the driver waits for its first link, the stream yields
    /// nothing: [`freshness`](Self::freshness) and [`watch_state`](Self::watch_state) have the reason.
    /// After [`laser_off`](Self::laser_off) the stream pauses, without an error. If the sensor does not
    /// measure the window, the stream yields
    /// [`WindowError::NotMeasured`](crate::protocol::WindowError::NotMeasured) once, and no scans while
    /// this sensor is connected.
    ///
    /// # Errors
    ///
    /// The cause if the driver has ended.
    pub fn scans(&self, window: Window, rate: Rate) -> StreamBuilder {
        StreamBuilder::new(self.client.clone(), window, rate)
    }

    /// Observes every reply from now on, to record or log the bytes of a sensor that is open already.
    ///
    /// Before this method returns, it calls your observer with the latest replies to `V`, or to `PP`
    /// and `VV`, if there is a link. From then on the driver calls it in its task, as it calls the observers of
    /// [`on_reply`](SensorBuilder::on_reply). Drop the observation to end it. A call that has begun
    /// on another thread may return after that.
    pub fn observe_replies(
        &self,
        observer: impl Fn(RawReply<'_>) + Send + Sync + 'static,
    ) -> ReplyObservation {
        if let Some(version) = self.client.shared.link.version_reply() {
            let parameters = version.parameters.as_ref().map(|reply| &reply.frame);
            for frame in parameters.into_iter().chain([&*version.frame]) {
                observer(RawReply {
                    protocol: frame.request.map_or(Protocol::Scip1, |_| Protocol::Scip2),
                    command: frame.request.is_none().then_some(Command::Version),
                    request: frame.request,
                    bytes: &frame.bytes,
                    received_at: frame.received_at,
                    stamp: frame.stamp,
                });
            }
        }
        self.client.observers.observe_until_dropped(observer)
    }

    /// When the last good scan arrived, over all streams and single scans, and why none is newer.
    pub fn freshness(&self) -> Freshness {
        self.client.shared.freshness()
    }

    /// Counters since the driver started, across all links.
    pub fn stats(&self) -> Stats {
        self.client.shared.counters.snapshot()
    }

    /// Watches the state of the driver and its link. Read it, wait for a
    /// [connected](StateWatch::connected) sensor, or [for any state](StateWatch::wait_for).
    pub fn watch_state(&self) -> StateWatch {
        self.client.shared.link.watch()
    }

    /// Closes the port and stops the driver. If there is a link, earlier requests are answered
    /// first. Later requests fail with [`Closed`](crate::ErrorKind::Closed), and streams
    /// end. Returns at once if the driver has ended already. Leaves the laser as it is, except that
    /// the command that ends a stream in SCIP 2 (`QT`) also switches it off. To be sure that it is off,
    /// call [`laser_off`](Self::laser_off) first.
    ///
    /// If the sensor does not answer, this waits for the deadlines of the current command and of
    /// one more: 1.5 s and their time on the wire, unless you set
    /// [`reply_latency`](SensorBuilder::reply_latency). A pending [`reboot`](Self::reboot) may add a
    /// second, a pending scan of a stream the time from scan to scan.
    pub async fn close(&self) {
        let _closing = self.client.shared.announce_closing();
        // Any outcome means that the driver has ended.
        let _ = self.client.ask(Request::Close).await;
    }
}
