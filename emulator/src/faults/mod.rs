//! Faults on demand: [`Fault`] and [`Faults`]. `parse` parses them, `injector` draws them for
//! each reply, and `delivery` applies them to its bytes.

mod delivery;
mod injector;
mod parse;

use std::ops::Range;
use std::time::Duration;

pub(super) use self::delivery::{Aftermath, Delivery};
pub(super) use self::injector::FaultInjector;
pub use self::parse::FaultsError;

/// Fault of one reply.
///
/// Positions are byte offsets in the reply as sent: 0 is the first byte of the echo, and a
/// position past the end has no effect. If you add several faults to one reply,
/// each applies to the result of the previous one.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Fault {
    /// The command never reaches the sensor: it does nothing and sends nothing.
    CommandLost,
    /// The sensor executes the command, but the reply never arrives.
    Lost,
    /// The reply is delayed by this time, and so is everything after it: replies stay in order.
    Late(Duration),
    /// The reply arrives twice.
    Doubled,
    /// These bytes are lost.
    Drop(Range<usize>),
    /// These bytes are inserted before this position.
    Insert(usize, Vec<u8>),
    /// The mask's bits are inverted in the byte at this position.
    Flip(usize, u8),
    /// These bytes arrive twice.
    Repeat(Range<usize>),
    /// Only this number of bytes is sent.
    Cut(usize),
    /// One byte anywhere is lost, arrives twice, has one bit inverted, or has a random byte
    /// inserted before it; or the reply ends there.
    Damaged,
    /// Without the last of its two line feeds, the reply runs into the next one.
    Merged,
    /// These bytes precede the reply.
    Garbage(Vec<u8>),
    /// This number of random bytes precedes the reply.
    Noise(usize),
    /// The reply pauses before the byte at this position.
    Pause(usize, Duration),
    /// Each byte of the reply takes this long.
    Trickle(Duration),
    /// Every line feed becomes CR LF, as on a line that is not raw.
    CrLf,
    /// Not executed: the command is refused with this status, in SCIP 2 after a `0`.
    Status(u8),
    /// Answered as if executed, but nothing changes: some sensors answer `QT` and go on sending.
    Ignored,
    /// The sum of one line is wrong, in SCIP 2: the last character of a line after the first.
    WrongSum,
    /// The sensor's clock moves forward by this number of milliseconds, or back, before the reply.
    ClockJump(i64),
    /// After sending this number of bytes of the reply, the sensor restarts, as at a
    /// [power cycle](super::Emulator::power_cycle).
    Reset(usize),
    /// Hangs up the link after this number of bytes of the reply: reads return the end of the
    /// stream, and you have to open the link again.
    HangUp(usize),
    /// Instead of the reply these bytes repeat, as fast as the line carries them, until the
    /// sensor is reset or you set other faults.
    Endless(Vec<u8>),
}

/// Faults of an emulated sensor: scripted, drawn at random, or both.
///
/// Replies are numbered from 0 since you set the faults. A command that gets no answer anyway
/// has no number. Opening a [`Sensor`](tokio_scip::Sensor) takes a fence and a `V`, and each faulty
/// reply is followed by a fence: their replies are numbered, too. To count from the first scan,
/// set the faults once the sensor is open
/// ([`Emulator::set_faults`](super::Emulator::set_faults)). Random faults depend only on
/// [`seed`](Self::seed): the same commands meet the same faults.
///
/// ```
/// use std::time::Duration;
/// use urg_emulator::{Fault, Faults};
///
/// let scripted = Faults::none().at(3, Fault::Late(Duration::from_secs(2))).at(5, Fault::Lost);
/// let drawn: Faults = "late=0.01:3s,lost=0.005,damaged=0.005,doubled=0.001,seed=7".parse()?;
/// # Ok::<(), urg_emulator::FaultsError>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Faults {
    scripted: Vec<(Trigger, Fault)>,
    random: Vec<(f64, Details)>,
    seed: Option<u64>,
}

/// Replies that a scripted fault applies to.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Trigger {
    Reply(u64),
    EveryReply,
    /// Replies to commands that begin with these bytes.
    Command(Vec<u8>),
    /// The first of these.
    Once(Vec<u8>),
}

/// Fault that is drawn for each reply.
#[derive(Debug, Clone, PartialEq)]
enum Details {
    Fixed(Fault),
    UpTo(Fault),
}

impl Faults {
    /// No faults.
    pub fn none() -> Self {
        Self::default()
    }

    /// Adds a fault of one reply. The first reply is number 0.
    #[must_use]
    pub fn at(mut self, reply: u64, fault: Fault) -> Self {
        self.scripted.push((Trigger::Reply(reply), fault));
        self
    }

    /// Adds a fault of every reply. `Faults::none().every(Fault::Lost)` makes the sensor silent.
    #[must_use]
    pub fn every(mut self, fault: Fault) -> Self {
        self.scripted.push((Trigger::EveryReply, fault));
        self
    }

    /// Adds a fault of every reply to commands that begin with `command`, each scan of a stream
    /// included.
    #[must_use]
    pub fn on(mut self, command: impl Into<Vec<u8>>, fault: Fault) -> Self {
        self.scripted.push((Trigger::Command(command.into()), fault));
        self
    }

    /// Adds a fault of the first reply to a command that begins with `command`.
    /// `Faults::none().once("QT", Fault::Ignored)` makes a stream survive a `QT`.
    #[must_use]
    pub fn once(mut self, command: impl Into<Vec<u8>>, fault: Fault) -> Self {
        self.scripted.push((Trigger::Once(command.into()), fault));
        self
    }

    /// Adds a fault that each reply has with this probability, 0 to 1.
    #[must_use]
    pub fn rate(mut self, probability: f64, fault: Fault) -> Self {
        self.random.push((probability, Details::Fixed(fault)));
        self
    }

    /// Adds a fault that each reply has with this probability, 0 to 1. For `Late`, `Pause`, `Noise`,
    /// `Reset`, `HangUp` and `ClockJump`, each reply draws its own time, length or position, between
    /// zero and the one in `most`; a clock jumps forward or back. Any other fault is added unchanged.
    #[must_use]
    pub fn up_to(mut self, probability: f64, most: Fault) -> Self {
        self.random.push((probability, Details::UpTo(most)));
        self
    }

    /// Sets the seed of random faults. Default: the sensor's seed.
    #[must_use]
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = Some(seed);
        self
    }
}
