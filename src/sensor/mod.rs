//! [`Sensor`], the handle that a service holds: each method is a request to the
//! driver, or a look at what the driver tells of itself.

mod builder;

use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::watch;

pub use self::builder::SensorBuilder;
use crate::driver::{Client, Request};
use crate::port::Endpoint;
use crate::protocol::Version;
use crate::state::{State, Stats};
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
/// [`Error::Disconnected`]; why there is none is in [`state`](Self::state). A reply
/// that does not come, or comes damaged, is asked for once more where that is
/// harmless, and then is [`Error::Timeout`] or [`Error::Malformed`]; a status other
/// than success is [`Error::Refused`]. Once the driver has ended every call fails
/// with the cause, or [`Error::Closed`].
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
    /// sensor. It is taken to have no baud rate, and is never reopened: when
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

    /// Moves sensor and port to another baud rate (`S`, p. 5), and makes sure
    /// that they meet there; about half a second. The driver restores it
    /// whenever the sensor was away. A sensor on USB accepts it without effect.
    ///
    /// # Errors
    ///
    /// [`Error::UnsupportedBaudRate`] before the sensor is told anything, if the
    /// port cannot be set to this baud rate or, as a TCP connection, to any other than
    /// that of its endpoint.
    /// [`Error::NotConfirmed`] if the sensor accepted and stayed where it was, or,
    /// with `L0` as its command, if the laser was off by request and will not go
    /// off at the new speed.
    pub async fn set_baud_rate(&self, baud_rate: BaudRate) -> Result<(), Error> {
        self.client.ask(|promise| Request::BaudRate { baud_rate, promise }).await
    }

    /// A single scan of `window`, asked for now (`G`, p. 5). It may come between
    /// those of streams, is number 0, and takes none of their numbers.
    ///
    /// # Errors
    ///
    /// [`Error::LaserOff`] after [`laser_off`](Self::laser_off), and those of
    /// [every request](Self#errors).
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
    ///
    /// Waits for no scan and for no link: while there is none the stream begins
    /// with the reason, if one is known, and goes on when the link is back. After
    /// [`laser_off`](Self::laser_off) it rests, without an error.
    ///
    /// # Errors
    ///
    /// Why the driver has ended, if it has.
    pub async fn scans(&self, window: Window, rate: Rate) -> Result<ScanStream, Error> {
        let subscribe = |promise| Request::Subscribe { window, rate, promise };
        let cursor = self.client.ask(subscribe).await?;
        Ok(ScanStream::new(cursor, window, rate, self.client.clone()))
    }

    /// What happened since the driver began, across all links.
    pub fn stats(&self) -> Stats {
        self.client.telemetry().snapshot()
    }

    /// A watch of what the driver is about.
    ///
    /// What the receiver's `borrow`, `borrow_and_update` and `wait_for` give is a
    /// lock: while it is held the driver cannot go on to another state. Clone the
    /// [`State`] out of it, and hold no borrow across an await.
    ///
    /// The watch itself lasts as long as a handle or a stream does, also after the
    /// driver has ended: who waits for a state waits for [`State::Closed`], too, or
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
    /// if let State::Closed { error } = now {
    ///     println!("no sensor any more: {error:?}");
    /// }
    /// # assert!(matches!(&*sensor.state().borrow(), State::Connected { .. }));
    /// # Ok(())
    /// # }
    /// ```
    pub fn state(&self) -> watch::Receiver<State> {
        self.client.telemetry().watch()
    }

    /// Ends the driver and closes the port. Requests made before are answered
    /// first, if there is a link; later ones fail with [`Error::Closed`], and
    /// streams end. Returns at once if the driver has ended already.
    ///
    /// If the sensor does not answer, this waits for the deadlines of the command
    /// under way and of one fence: 1.5 s unless
    /// [`reply_latency`](SensorBuilder::reply_latency) was set, and their time on
    /// the wire.
    pub async fn close(&self) {
        let _closing = self.client.telemetry().closing();
        // The only answer is that the driver has ended, one way or the other.
        let _ = self.client.ask(Request::Close).await;
    }
}
