//! A sensor in software, to test a service without hardware (feature
//! `emulator`).
//!
//! [`Emulator`] plays a URG sensor after the protocol text and after what real
//! sensors do. It answers `V`, `L`, `S` and `G`, keeps its laser's state and its
//! baud rate, sees a room with people in it (or a [`World`] of yours), takes
//! its time as a real one does, and goes wrong on demand ([`Faults`]). The same
//! seed and the same commands at the same times give the same bytes.
//!
//! ```
//! use tokio::io::{AsyncReadExt, AsyncWriteExt};
//! use tokio_scip::emulator::{Emulator, Fixed};
//!
//! # #[tokio::main(flavor = "current_thread", start_paused = true)]
//! # async fn main() -> std::io::Result<()> {
//! let emulator = Emulator::builder().world(Fixed::filled(1234)).build();
//! let mut link = emulator.link();
//! link.write_all(b"G38438401\n").await?;
//! let mut reply = [0; 16];
//! link.read_exact(&mut reply).await?;
//! assert_eq!(&reply, b"G38438401\n0\nCB\n\n");
//! # Ok(())
//! # }
//! ```
//!
//! # How to reach it
//!
//! - [`Emulator::link`]: in memory, for tests. The [`Link`] is a
//!   [`Port`](crate::Port) with a baud rate.
//! - `Emulator` is a [`Connect`]: each connection is a new link to the same
//!   sensor, which can be unplugged and plugged in again.
//! - [`Emulator::serve`]: on any stream; [`Emulator::serve_tcp`]: on TCP;
//!   `Pty`: on a pseudo-terminal (Unix, with feature `serial`).
//! - [`FaultyLink`] wraps any stream in one whose calls fail when they are told
//!   to.
//!
//! # Where the text is silent
//!
//! | command | status |
//! |---|---|
//! | `L` for what the laser does already | `2` |
//! | `S` for the baud rate that is set already, or on USB ([`Firmware::V3`]) | `3` |
//! | `G` while the laser is off | `6` |
//! | undefined ([`Firmware::V3`]; no answer from [`Firmware::Text`]) | `E` |
//! | a wrong number of bytes | `1` |
//! | a control code, baud rate, step or cluster that does not exist | `4` |
//! | starting point bigger than end point | `5` |
//!
//! The first four are what real sensors are known to answer; the other three
//! are this emulator's own choice, since only "an error status" is known. A
//! cluster count of `00` works like `01`. Lines of more than 64 bytes are cut
//! and refused.

mod builder;
mod damage;
mod device;
mod encode;
mod faults;
mod faulty_link;
mod journal;
mod link;
#[cfg(all(unix, feature = "serial"))]
mod pty;
mod random;
mod request;
mod room;
#[cfg_attr(not(feature = "mcap"), allow(dead_code, reason = "only recordings have scripts"))]
mod script;
mod sensor;
mod serve;
mod spec;
mod timing;
mod transmitter;
mod wire;
mod world;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Waker;

use tokio::sync::Notify;
use tokio::time::Instant;

use self::link::HostBaudRate;
use self::sensor::Sensor;
use crate::{BaudRate, Connect, Error};

pub use self::builder::Builder;
pub use self::device::{EmptyCommand, Firmware, Mode};
pub use self::faults::{Fault, FaultCounts, Faults};
pub use self::faulty_link::{Call, CallCounter, Failure, FaultyLink};
pub use self::journal::{Counts, Received, Verdict};
pub use self::link::Link;
#[cfg(all(unix, feature = "serial"))]
pub use self::pty::Pty;
pub use self::room::Room;
#[cfg(feature = "mcap")]
pub(crate) use self::script::Script;
pub use self::spec::InvalidFaults;
pub use self::timing::Pace;
pub use self::world::{Fixed, STEPS, Values, World, WorldTime};

/// A handle to an emulated sensor.
///
/// Clones are handles to the same sensor, which lives as long as any of them or
/// of its links. It runs no task and no thread: it is brought up to date when
/// somebody reads, writes or asks. Without a link it costs nothing.
///
/// Methods that are not `async` never wait. They are also fine outside of a
/// runtime.
#[derive(Debug, Clone)]
pub struct Emulator {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    state: Mutex<State>,
    /// Told when a link is opened and when the cable is pulled or put back.
    changed: Notify,
}

#[derive(Debug)]
struct State {
    sensor: Sensor,
    plugged_in: bool,
    /// The link that is open.
    link: Option<u64>,
    links: u64,
    /// The speed of the host's end when it was last seen, in bits a second.
    host: Option<u32>,
    /// Who waits for bytes from the sensor.
    reader: Option<Waker>,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        // Only a `World` can panic in here, and it leaves nothing half done
        // that a later command would stumble over.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    async fn until(&self, condition: impl Fn(&State) -> bool) {
        loop {
            // Before the look: a notice between the two is not lost.
            let notice = self.changed.notified();
            if condition(&self.lock()) {
                return;
            }
            notice.await;
        }
    }
}

impl Default for Emulator {
    /// A sensor on USB with everything as [`Builder`] has it by default.
    fn default() -> Self {
        Self::builder().build()
    }
}

impl Emulator {
    /// Says what kind of sensor it is to be.
    pub fn builder() -> Builder {
        Builder::default()
    }

    fn new(sensor: Sensor) -> Self {
        let state =
            State { sensor, plugged_in: true, link: None, links: 0, host: None, reader: None };
        Self { shared: Arc::new(Shared { state: Mutex::new(state), changed: Notify::new() }) }
    }

    /// Opens a link in memory. One that is open is hung up: there is one cable.
    ///
    /// A sensor on RS-232 hears the link at 19,200 baud until
    /// [`set_baud_rate`](crate::Port::set_baud_rate). While the sensor is
    /// unplugged the link is hung up from the start.
    pub fn link(&self) -> Link {
        self.open(match self.baud_rate() {
            Some(_) => HostBaudRate::Set(BaudRate::B19200),
            None => HostBaudRate::Follows,
        })
    }

    /// Opens a link as [`link`](Self::link) does, through a bridge whose line
    /// speed cannot be changed from here.
    pub fn bridge(&self, speed: BaudRate) -> Link {
        self.open(HostBaudRate::Fixed(speed))
    }

    fn open(&self, speed: HostBaudRate) -> Link {
        let mut state = self.shared.lock();
        state.links += 1;
        let id = state.links;
        let hung_up = state.reader.take();
        if state.plugged_in && !state.sensor.gone {
            let before = state.host;
            state.sensor.advance(Instant::now(), before);
            state.sensor.hung_up = false;
            state.host = speed.bits_per_second();
            state.link = Some(id);
        }
        drop(state);
        self.shared.changed.notify_waiters();
        if let Some(reader) = hung_up {
            reader.wake();
        }
        Link::new(self.shared.clone(), id, speed)
    }

    /// Looks at the sensor as it is now.
    fn inspect<T>(&self, look: impl FnOnce(&State) -> T) -> T {
        let mut state = self.shared.lock();
        let host = state.host;
        state.sensor.advance(Instant::now(), host);
        look(&state)
    }

    /// Changes the sensor, after all that was due before.
    fn change(&self, change: impl FnOnce(&mut State, Instant)) {
        let mut state = self.shared.lock();
        let now = Instant::now();
        let host = state.host;
        state.sensor.advance(now, host);
        change(&mut state, now);
        let reader = state.reader.take();
        drop(state);
        if let Some(reader) = reader {
            reader.wake();
        }
    }

    /// Pulls the cable. The open link is hung up, connecting fails with
    /// [`Error::NoSuchPort`], and what was on the way is lost. The sensor itself
    /// goes on; one that is powered by its cable also wants
    /// [`power_cycle`](Self::power_cycle).
    pub fn unplug(&self) {
        self.change(|state, now| {
            state.plugged_in = false;
            state.link = None;
            state.sensor.unplug(now);
        });
        self.shared.changed.notify_waiters();
    }

    /// Puts the cable back. Links that were hung up stay so.
    pub fn plug_in(&self) {
        self.change(|state, now| {
            if !state.plugged_in {
                // What the sensor has said meanwhile nobody has heard.
                state.sensor.unplug(now);
            }
            state.plugged_in = true;
        });
        self.shared.changed.notify_waiters();
    }

    /// Cuts the power for a moment: 19,200 baud, laser on, SCIP 1.1, and silent
    /// for the boot time, from now on. An open link stays open.
    pub fn power_cycle(&self) {
        self.change(|state, now| state.sensor.power_cycle(now));
    }

    /// Gives the sensor other faults from the next reply on, which is number 0
    /// for them. What has fired stays counted.
    pub fn set_faults(&self, faults: Faults) {
        self.change(|state, _| state.sensor.set_faults(faults));
    }

    /// Changes the serial number that `V` tells, as if another sensor had been
    /// put in the place of this one.
    pub fn set_serial_number(&self, serial_number: impl Into<String>) {
        self.change(|state, _| state.sensor.device.serial_number = serial_number.into());
    }

    /// Makes the sensor speak another protocol.
    pub fn set_mode(&self, mode: Mode) {
        self.change(|state, now| state.sensor.set_mode(mode, now));
    }

    /// Sends bytes that nobody has asked for, behind what is being sent.
    pub fn inject(&self, bytes: impl Into<Vec<u8>>) {
        self.change(|state, now| state.sensor.say(now, bytes.into()));
    }

    /// Whether the laser is on.
    pub fn is_laser_on(&self) -> bool {
        self.inspect(|state| state.sensor.device.laser)
    }

    /// The sensor's baud rate, `None` on USB.
    pub fn baud_rate(&self) -> Option<BaudRate> {
        self.inspect(|state| state.sensor.device.speed)
    }

    /// Whether a link is open, and not hung up.
    pub fn is_connected(&self) -> bool {
        self.inspect(|state| state.link.is_some() && !state.sensor.hung_up)
    }

    /// What has come and gone.
    pub fn counts(&self) -> Counts {
        self.inspect(|state| state.sensor.journal.counts)
    }

    /// Which faults have fired.
    pub fn fault_counts(&self) -> FaultCounts {
        self.inspect(|state| state.sensor.mishaps.counts)
    }

    #[cfg(all(unix, feature = "serial"))]
    async fn wait_until_plugged_in(&self) {
        self.shared.until(|state| state.plugged_in).await;
    }

    /// The last command lines that arrived, oldest first, as many as
    /// [`Builder::log`] says.
    pub fn log(&self) -> Vec<Received> {
        self.inspect(|state| state.sensor.journal.log())
    }
}

/// Opens a new [`Link`] to the same sensor each time.
///
/// Connecting fails with [`Error::NoSuchPort`] while the sensor is unplugged and
/// with [`Error::Busy`] while another link is open. Cancel-safe.
impl Connect for Emulator {
    type Port = Link;

    async fn connect(&mut self) -> Result<Link, Error> {
        let port = || "emulated".to_owned();
        let (plugged_in, busy) =
            self.inspect(|state| (state.plugged_in && !state.sensor.gone, state.link.is_some()));
        match (plugged_in, busy) {
            (false, _) => Err(Error::NoSuchPort { port: port() }),
            (true, true) => Err(Error::Busy { port: port() }),
            (true, false) => Ok(self.link()),
        }
    }
}
