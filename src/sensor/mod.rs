//! [`Sensor`], the handle that a service holds: each method sends a request to the
//! driver, or reads what the driver reports.

mod builder;

use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::watch;

pub use self::builder::SensorBuilder;
use crate::driver::{Client, Request};
use crate::port::Endpoint;
use crate::protocol::Version;
use crate::state::{Freshness, State, Stats};
use crate::stream::{ScanStream, StreamBuilder};
use crate::{BaudRate, Error, Rate, Scan, Window};

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
/// [`Error::Disconnected`]; [`state`](Self::state) has the reason. A command without a
/// whole reply is repeated once where that is harmless, and then fails with
/// [`Error::Timeout`] or [`Error::Malformed`]; with a status other than success it
/// fails with [`Error::Refused`]. Once the driver has ended every call fails with the
/// cause, or [`Error::Closed`].
#[derive(Debug, Clone)]
pub struct Sensor {
    client: Client,
}

impl Sensor {
    /// Opens the sensor behind `endpoint` with the builder's defaults, on a
    /// driver that is spawned on the current tokio runtime.
    ///
    /// Takes an [`Endpoint`], a path, or a text that names an endpoint, such as
    /// `/dev/ttyACM0`, `COM3`, `tcp://host:port?baud=115200` or
    /// `serial:H0713090`.
    ///
    /// # Errors
    ///
    /// Fails at once if trying again would not help: no such port, not a serial port,
    /// no permission, in use, SCIP 2, a loopback. Fails with [`Error::NoAnswer`] after
    /// the open timeout (5 s).
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

    /// Opens the sensor behind a byte stream that is open already: a socket, a pipe, an
    /// emulated sensor. The stream has no baud rate, and is never reopened: when it ends,
    /// the driver ends.
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

    /// Returns a builder, for other settings than those of [`open`](Self::open).
    pub fn builder() -> SensorBuilder {
        SensorBuilder::default()
    }

    /// Waits until the sensor answers for the first time.
    ///
    /// The other ways of opening have waited already; this is for a driver that was
    /// [built](SensorBuilder::build) and spawned. Cancel-safe.
    ///
    /// # Errors
    ///
    /// The cause if the driver has ended.
    pub async fn opened(&self) -> Result<(), Error> {
        let mut state = self.state();
        let open = |state: &State| !matches!(state, State::Connecting { .. });
        match state.wait_for(open).await.as_deref() {
            Ok(State::Closed { .. }) | Err(_) => Err(self.client.telemetry().cause()),
            Ok(_) => Ok(()),
        }
    }

    /// Returns the identity of the sensor (`V`, C-42-3320-A p. 4), as it was read when
    /// the link was opened.
    pub async fn version(&self) -> Result<Version, Error> {
        match self.client.telemetry().version() {
            Some(version) => Ok(version),
            None => self.client.ask(Request::Version).await,
        }
    }

    /// Switches the laser on (`L1`, p. 4), and confirms that it is. Succeeds if it is
    /// on already.
    ///
    /// The driver remembers it, also if this call fails or is dropped after it
    /// was written, and restores it whenever the sensor was away.
    pub async fn laser_on(&self) -> Result<(), Error> {
        self.client.ask(|responder| Request::Laser { on: true, responder }).await
    }

    /// Switches the laser off (`L0`, p. 4), and confirms that it is: the sensor refuses
    /// to measure. Succeeds if it is off already.
    ///
    /// Streams pause until [`laser_on`](Self::laser_on). The driver remembers it, also
    /// if this call fails or is dropped after it was written, and restores it whenever
    /// the sensor was away. A sensor that resets itself switches its laser on; on USB,
    /// and while it gets no commands, the driver notices that only if the sensor sends
    /// bytes by itself.
    pub async fn laser_off(&self) -> Result<(), Error> {
        self.client.ask(|responder| Request::Laser { on: false, responder }).await
    }

    /// Changes the baud rate of sensor and port (`S`, p. 5), and confirms that the
    /// sensor answers at it; takes about half a second. The driver restores it whenever
    /// the sensor was away. A sensor on USB accepts it without effect.
    ///
    /// # Errors
    ///
    /// [`Error::UnsupportedBaudRate`], with nothing sent to the sensor, if the port
    /// cannot be set to this baud rate or, as a TCP connection, to any other than that
    /// of its endpoint. [`Error::NotConfirmed`] if the sensor accepted and stayed at the old one, or,
    /// with `L0` as its command, if the laser was off by request and does not go off at
    /// the new one.
    pub async fn set_baud_rate(&self, baud_rate: BaudRate) -> Result<(), Error> {
        self.client.ask(|responder| Request::BaudRate { baud_rate, responder }).await
    }

    /// Polls once, and returns the scan of `window` (`G`, p. 5). The poll may come
    /// between those of streams. The scan is number 0, and takes none of their numbers.
    ///
    /// # Errors
    ///
    /// [`Error::LaserOff`] after [`laser_off`](Self::laser_off), and those of
    /// [every request](Self#errors).
    pub async fn scan(&self, window: Window) -> Result<Scan, Error> {
        self.client.ask(|responder| Request::Scan { window, responder }).await
    }

    /// Returns a stream of scans of `window` at `rate`, starting with the next one. The
    /// short form of [`stream`](Self::stream), without settings.
    ///
    /// Polls lie on a fixed grid, without drift. One that falls due while the line is
    /// busy is sent as soon as it is free; further ones are skipped, never made up.
    /// Streams of the same window and rate share their polls. A rate that the line
    /// cannot carry is not an error: log and [`stats`](Self::stats) report the rate that
    /// is reached, and [`Window::wire_time`] predicts it.
    ///
    /// Waits neither for a scan nor for a link. While the link is lost the stream starts
    /// with [`Error::Disconnected`] or the reason of the latest attempt, and continues
    /// when the link is back. A driver that still waits for its first link reports the
    /// reason in [`state`](Self::state) only. After [`laser_off`](Self::laser_off) the
    /// stream pauses, without an error.
    ///
    /// # Errors
    ///
    /// The cause if the driver has ended.
    pub async fn scans(&self, window: Window, rate: Rate) -> Result<ScanStream, Error> {
        self.stream(window, rate).open().await
    }

    /// Returns a builder of a stream, for other settings than those of
    /// [`scans`](Self::scans).
    pub fn stream(&self, window: Window, rate: Rate) -> StreamBuilder {
        StreamBuilder::new(self.client.clone(), window, rate)
    }

    /// Returns the time of the last good scan, of all streams and single scans, and the
    /// reason why there is no newer one.
    pub fn freshness(&self) -> Freshness {
        self.client.telemetry().freshness()
    }

    /// Returns the counters since the driver started, across all links.
    pub fn stats(&self) -> Stats {
        self.client.telemetry().snapshot()
    }

    /// Returns a watch of the state of the driver and its link.
    ///
    /// The receiver's `borrow`, `borrow_and_update` and `wait_for` return a lock: while
    /// it is held the driver cannot enter another state. Clone the [`State`] out of it,
    /// and hold no borrow across an await.
    ///
    /// The watch lasts as long as a handle or a stream does, also after the driver has
    /// ended: a task that waits for a state has to wait for [`State::Closed`] too, or it
    /// may wait for ever.
    ///
    /// ```
    /// # use tokio_scip::emulator::Emulator;
    /// use tokio_scip::{Sensor, State};
    ///
    /// # #[tokio::main(flavor = "current_thread", start_paused = true)]
    /// # async fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # let sensor = Sensor::builder().connect(Emulator::default()).await?;
    /// let mut state = sensor.state();
    /// let up_or_over =
    ///     |state: &State| matches!(state, State::Connected { .. } | State::Closed { .. });
    /// let now = state.wait_for(up_or_over).await?.clone(); // the borrow ends here
    /// if let State::Closed { error, .. } = now {
    ///     println!("no sensor any more: {error:?}");
    /// }
    /// # assert!(matches!(&*sensor.state().borrow(), State::Connected { .. }));
    /// # Ok(())
    /// # }
    /// ```
    pub fn state(&self) -> watch::Receiver<State> {
        self.client.telemetry().watch()
    }

    /// Ends the driver and closes the port. Earlier requests are answered first, if
    /// there is a link; later ones fail with [`Error::Closed`], and streams end. Returns
    /// at once if the driver has ended already.
    ///
    /// If the sensor does not answer, this waits for the deadlines of the command under
    /// way and of one fence: 1.5 s unless [`reply_latency`](SensorBuilder::reply_latency)
    /// was set, and their time on the wire.
    pub async fn close(&self) {
        let _closing = self.client.telemetry().closing();
        // Any answer means that the driver has ended.
        let _ = self.client.ask(Request::Close).await;
    }
}
