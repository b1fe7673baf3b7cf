//! What goes wrong, and when: [`Fault`] and [`Faults`]. What a fault does to a
//! reply is in `damage`, how faults are written down in `spec`.

use std::ops::Range;
use std::time::Duration;

use super::random::Random;

/// One thing that goes wrong with one reply.
///
/// Places are byte offsets in the reply as sent, 0 being the first byte of the
/// echo; those past its end do nothing. Several faults of one reply are applied
/// in the order in which they were given, each to what the one before has left.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Fault {
    /// The command never reaches the sensor: nothing is done, nothing is sent.
    CommandLost,
    /// The sensor does what it was told, and the reply never arrives.
    Lost,
    /// The reply comes this much later, and so does everything behind it:
    /// replies stay in order.
    Late(Duration),
    /// The reply comes twice.
    Doubled,
    /// These bytes are lost.
    Drop(Range<usize>),
    /// Bytes come in before this place.
    Insert(usize, Vec<u8>),
    /// The bits of the mask are inverted in the byte at this place.
    Flip(usize, u8),
    /// These bytes come twice.
    Repeat(Range<usize>),
    /// Only this many bytes are sent.
    Cut(usize),
    /// One byte anywhere is lost, or comes twice, or has one bit inverted, or a
    /// random one comes in, or the rest is lost from there on.
    Damaged,
    /// The last of the two line feeds is lost: the reply runs into the next one.
    Merged,
    /// These bytes come before the reply.
    Garbage(Vec<u8>),
    /// As many random bytes come before the reply.
    Noise(usize),
    /// The reply pauses before the byte at this place.
    Pause(usize, Duration),
    /// Each byte of the reply takes this long.
    Trickle(Duration),
    /// Every line feed becomes CR LF, as on a line that is not raw.
    CrLf,
    /// The command is refused with this status, and not done.
    Status(u8),
    /// The sensor restarts when it has sent this many bytes of the reply: 19,200
    /// baud, laser on, silent for its boot time.
    Reset(usize),
    /// The link is hung up after this many bytes of the reply: its readers see
    /// the end, and it has to be opened again.
    HangUp(usize),
    /// Instead of the reply these bytes come over and over, as fast as the line
    /// carries them, until the sensor is reset or gets other faults.
    Endless(Vec<u8>),
}

/// Which replies are faulty, and how: scripted, drawn at random, or both.
///
/// Replies are numbered from 0 since the faults were set; a command that is not
/// answered anyway has no number. A [`Sensor`](crate::Sensor) is opened with a
/// fence and a `V`, and sends a fence after each reply that went wrong: their
/// replies have numbers, too. To count from the first scan set the faults once the
/// sensor is open ([`Emulator::set_faults`](super::Emulator::set_faults)). Random
/// faults are drawn from [`seed`](Self::seed) alone: the same commands give the
/// same faults.
///
/// ```
/// use std::time::Duration;
/// use tokio_scip::emulator::{Fault, Faults};
///
/// let scripted = Faults::none().at(3, Fault::Late(Duration::from_secs(2))).at(5, Fault::Lost);
/// let drawn: Faults = "late=0.01:3s,lost=0.005,damaged=0.005,doubled=0.001,seed=7".parse()?;
/// # Ok::<(), tokio_scip::emulator::InvalidFaults>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Faults {
    pub(super) script: Vec<(When, Fault)>,
    pub(super) rates: Vec<(f64, Drawn)>,
    pub(super) seed: Option<u64>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum When {
    At(u64),
    Every,
}

/// A fault whose particulars are drawn when it fires.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Drawn {
    Late(Duration),
    Pause(Duration),
    Noise(usize),
    Reset,
    HangUp,
    Just(Fault),
}

impl Faults {
    /// Nothing goes wrong.
    pub fn none() -> Self {
        Self::default()
    }

    /// Adds a fault of one reply, the first one being number 0.
    #[must_use]
    pub fn at(mut self, reply: u64, fault: Fault) -> Self {
        self.script.push((When::At(reply), fault));
        self
    }

    /// Adds a fault of every reply. `Faults::none().every(Fault::Lost)` is a
    /// sensor that is silent.
    #[must_use]
    pub fn every(mut self, fault: Fault) -> Self {
        self.script.push((When::Every, fault));
        self
    }

    /// Adds a fault that each reply has with this probability, 0 to 1.
    #[must_use]
    pub fn rate(mut self, probability: f64, fault: Fault) -> Self {
        self.rates.push((probability, Drawn::Just(fault)));
        self
    }

    /// With this probability a reply is late by up to `longest`.
    #[must_use]
    pub fn late(mut self, probability: f64, longest: Duration) -> Self {
        self.rates.push((probability, Drawn::Late(longest)));
        self
    }

    /// With this probability a reply pauses somewhere, for up to `longest`.
    #[must_use]
    pub fn paused(mut self, probability: f64, longest: Duration) -> Self {
        self.rates.push((probability, Drawn::Pause(longest)));
        self
    }

    /// With this probability up to `longest` random bytes precede a reply.
    #[must_use]
    pub fn noise(mut self, probability: f64, longest: usize) -> Self {
        self.rates.push((probability, Drawn::Noise(longest)));
        self
    }

    /// With this probability the sensor restarts somewhere within a reply.
    #[must_use]
    pub fn reset(mut self, probability: f64) -> Self {
        self.rates.push((probability, Drawn::Reset));
        self
    }

    /// With this probability the link is hung up somewhere within a reply.
    #[must_use]
    pub fn hung_up(mut self, probability: f64) -> Self {
        self.rates.push((probability, Drawn::HangUp));
        self
    }

    /// Draws from this seed. Without one the sensor's own seed is used.
    #[must_use]
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = Some(seed);
        self
    }
}

/// How often each kind of fault has fired, drawn ones and scripted ones.
///
/// A fault counts when it meets a reply, even if there it changes nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct FaultCounts {
    /// [`Fault::CommandLost`].
    pub command_lost: u64,
    /// [`Fault::Lost`].
    pub lost: u64,
    /// [`Fault::Late`].
    pub late: u64,
    /// [`Fault::Doubled`].
    pub doubled: u64,
    /// [`Fault::Drop`].
    pub dropped: u64,
    /// [`Fault::Insert`].
    pub inserted: u64,
    /// [`Fault::Flip`].
    pub flipped: u64,
    /// [`Fault::Repeat`].
    pub repeated: u64,
    /// [`Fault::Cut`].
    pub cut: u64,
    /// [`Fault::Damaged`].
    pub damaged: u64,
    /// [`Fault::Merged`].
    pub merged: u64,
    /// [`Fault::Garbage`].
    pub garbage: u64,
    /// [`Fault::Noise`].
    pub noise: u64,
    /// [`Fault::Pause`].
    pub paused: u64,
    /// [`Fault::Trickle`].
    pub trickled: u64,
    /// [`Fault::CrLf`].
    pub crlf: u64,
    /// [`Fault::Status`].
    pub status: u64,
    /// [`Fault::Reset`].
    pub reset: u64,
    /// [`Fault::HangUp`].
    pub hung_up: u64,
    /// [`Fault::Endless`].
    pub endless: u64,
}

impl FaultCounts {
    /// All of them together.
    pub fn total(&self) -> u64 {
        let Self {
            command_lost,
            lost,
            late,
            doubled,
            dropped,
            inserted,
            flipped,
            repeated,
            cut,
            damaged,
            merged,
            garbage,
            noise,
            paused,
            trickled,
            crlf,
            status,
            reset,
            hung_up,
            endless,
        } = self;
        [command_lost, lost, late, doubled, dropped, inserted, flipped, repeated, cut, damaged]
            .into_iter()
            .chain([merged, garbage, noise, paused, trickled, crlf, status, reset, hung_up])
            .chain([endless])
            .sum()
    }

    fn count(&mut self, fault: &Fault) {
        let counter = match fault {
            Fault::CommandLost => &mut self.command_lost,
            Fault::Lost => &mut self.lost,
            Fault::Late(_) => &mut self.late,
            Fault::Doubled => &mut self.doubled,
            Fault::Drop(_) => &mut self.dropped,
            Fault::Insert(..) => &mut self.inserted,
            Fault::Flip(..) => &mut self.flipped,
            Fault::Repeat(_) => &mut self.repeated,
            Fault::Cut(_) => &mut self.cut,
            Fault::Damaged => &mut self.damaged,
            Fault::Merged => &mut self.merged,
            Fault::Garbage(_) => &mut self.garbage,
            Fault::Noise(_) => &mut self.noise,
            Fault::Pause(..) => &mut self.paused,
            Fault::Trickle(_) => &mut self.trickled,
            Fault::CrLf => &mut self.crlf,
            Fault::Status(_) => &mut self.status,
            Fault::Reset(_) => &mut self.reset,
            Fault::HangUp(_) => &mut self.hung_up,
            Fault::Endless(_) => &mut self.endless,
        };
        *counter += 1;
    }
}

/// Faults at work: which reply is next, and what has fired.
#[derive(Debug)]
pub(super) struct Mishaps {
    faults: Faults,
    random: Random,
    next: u64,
    pub(super) counts: FaultCounts,
}

impl Mishaps {
    pub(super) fn new(faults: Faults, seed: u64) -> Self {
        let random = Random::new(faults.seed.unwrap_or(seed));
        Self { faults, random, next: 0, counts: FaultCounts::default() }
    }

    /// Other faults from now on; what has fired stays counted.
    pub(super) fn replace(&mut self, faults: Faults, seed: u64) {
        *self = Self { counts: self.counts, ..Self::new(faults, seed) };
    }

    /// The faults of the next reply, and a word of randomness for their places.
    pub(super) fn draw(&mut self) -> (Vec<Fault>, Random) {
        // One word a reply for all of it, so that no draw depends on an
        // earlier reply's length or faults.
        let mut random = Random::new(self.random.next());
        let next = self.next;
        self.next += 1;
        let mut fired = Vec::new();
        for (when, fault) in &self.faults.script {
            if matches!(when, When::Every) || *when == When::At(next) {
                fired.push(fault.clone());
            }
        }
        for (probability, drawn) in &self.faults.rates {
            if random.fraction() < *probability {
                fired.push(drawn.fault(&mut random));
            }
        }
        for fault in &fired {
            self.counts.count(fault);
        }
        (fired, random)
    }
}

impl Drawn {
    fn fault(&self, random: &mut Random) -> Fault {
        // A full reply has 1,576 bytes; in a shorter one places fall on its end.
        let mut up_to = |longest: &Duration| longest.mul_f64(random.fraction());
        match self {
            Self::Late(longest) => Fault::Late(up_to(longest)),
            Self::Pause(longest) => {
                let pause = up_to(longest);
                Fault::Pause(random.below(64) as usize, pause)
            }
            Self::Noise(longest) => Fault::Noise(random.below(*longest as u64 + 1) as usize),
            Self::Reset => Fault::Reset(random.below(1600) as usize),
            Self::HangUp => Fault::HangUp(random.below(1600) as usize),
            Self::Just(fault) => fault.clone(),
        }
    }
}
