//! [`Command`]: a command line of SCIP 2 after parsing.

use std::cmp::Ordering;
use std::ops::Range;

use crate::body::{Body, Steps};
use crate::format::{baud_rate, number};
use crate::models::Model;
use tokio_scip::BaudRate;

/// Longest text of the host, after a semicolon (C-42-03320B p. 9).
const MAX_TEXT_BYTES: usize = 16;

/// Command with its parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Command {
    Version,
    Parameters,
    State,
    StateCode,
    LaserOn,
    LaserOff,
    Reset {
        all: bool,
    },
    Reboot,
    Sleep,
    EnterClockMode,
    Clock(Unit),
    LeaveClockMode,
    /// `None` for a baud rate that the emulator does not have.
    BaudRate(Option<BaudRate>),
    MotorSpeed(u8),
    Sensitivity,
    Latest(Asked),
    Stream {
        asked: Asked,
        skipped: u16,
        count: u16,
    },
    /// Locks a URG-04LX.
    Locking,
}

/// Unit of a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unit {
    Milliseconds,
    Microseconds,
}

/// Points that a command asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Asked {
    pub(super) data: Data,
    pub(crate) steps: Steps,
    pub(super) unit: Unit,
}

/// What is sent for each point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Data {
    /// Two characters.
    Short,
    /// Three characters.
    Distances,
    /// Three characters each.
    Intensities,
}

/// Status of an answer to a command with a mistake.
pub(crate) type Refusal = &'static [u8; 2];

/// Letters of commands, their number of digits, the models that know them, and how to read them.
type Form = (&'static str, usize, &'static [Model], fn(Digits<'_>) -> Result<Command, Refusal>);

const ALL: &[Model] = &[Model::Urg04lx, Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx];
const CLASSIC: &[Model] = &[Model::Urg04lx];
const URG: &[Model] = &[Model::Urg04lx, Model::Urg04lxUg01];
const UTM: &[Model] = &[Model::Utm30lx, Model::Ust10lx];
const UST: &[Model] = &[Model::Ust10lx];
/// All that know two characters for a distance: a UST does not (C-42-04076 p. 13).
const SHORT: &[Model] = &[Model::Urg04lx, Model::Urg04lxUg01, Model::Utm30lx];

const FORMS: [Form; 24] = [
    ("VV", 0, ALL, |_| Ok(Command::Version)),
    ("PP", 0, ALL, |_| Ok(Command::Parameters)),
    ("II", 0, ALL, |_| Ok(Command::State)),
    ("%ST", 0, UST, |_| Ok(Command::StateCode)),
    ("BM", 0, ALL, |_| Ok(Command::LaserOn)),
    ("QT", 0, ALL, |_| Ok(Command::LaserOff)),
    ("RS", 0, ALL, |_| Ok(Command::Reset { all: true })),
    ("RT", 0, ALL, |_| Ok(Command::Reset { all: false })),
    ("RB", 0, ALL, |_| Ok(Command::Reboot)),
    ("%SL", 0, UST, |_| Ok(Command::Sleep)),
    ("TM", 1, ALL, |digits| digits.clock()),
    ("%TM", 1, UST, |digits| digits.clock()),
    ("SS", 6, ALL, |digits| digits.baud_rate()),
    ("CR", 2, ALL, |digits| digits.motor_speed()),
    ("HS", 1, URG, |digits| digits.sensitivity()),
    ("GD", 10, ALL, |digits| digits.asked().map(Command::Latest)),
    ("GS", 10, SHORT, |digits| digits.asked().map(Command::Latest)),
    ("GE", 10, UTM, |digits| digits.asked().map(Command::Latest)),
    ("MD", 13, ALL, |digits| digits.stream()),
    ("MS", 13, SHORT, |digits| digits.stream()),
    ("ME", 13, UTM, |digits| digits.stream()),
    ("%MD %ME", 13, UST, |digits| digits.stream()),
    ("GE HD HE", 10, CLASSIC, |_| Ok(Command::Locking)),
    ("ME ND NE", 13, CLASSIC, |_| Ok(Command::Locking)),
];

impl Command {
    /// Parses a command line without its terminator, which may have been cut.
    ///
    /// # Errors
    ///
    /// The status to answer with. Where the text (p. 10 to 23) leaves open which, it is this
    /// emulator's choice.
    pub(crate) fn parse(line: &[u8], too_long: bool, body: &Body) -> Result<Self, Refusal> {
        let mut parts = line.splitn(2, |&byte| byte == b';');
        let (command, text) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
        let letters = if command.starts_with(b"%") { 3 } else { 2 };
        let is_ust = body.model == Model::Ust10lx;
        let unknown = if is_ust { b"0F" } else { b"0E" };
        let (letters, digits) = command.split_at_checked(letters).ok_or(unknown)?;
        let is_it = |(known, _, models, _): &&Form| {
            known.split(' ').any(|known| known.as_bytes() == letters)
                && models.contains(&body.model)
        };
        let (_, count, _, read) = FORMS.iter().find(is_it).ok_or(unknown)?;
        if text.len() > MAX_TEXT_BYTES || too_long {
            return Err(b"0G");
        }
        if !text.iter().all(|byte| byte.is_ascii_alphanumeric() || b" ._+@".contains(byte)) {
            return Err(b"0H");
        }
        // A real UST (2.23.0000) looks at its laser before the digits.
        let is_dark = is_ust && letters.starts_with(b"G") && !body.is_laser_on;
        let refused = |refusal| Err(if is_dark { b"10" } else { refusal });
        match digits.len().cmp(count) {
            Ordering::Less => refused(b"0C"),
            Ordering::Greater => refused(b"0D"),
            Ordering::Equal => read(Digits { letters, digits, body }).or_else(refused),
        }
    }

    /// Returns true if a sensor in clock mode accepts the command.
    pub(super) const fn is_for_clock_mode(&self) -> bool {
        use Command as C;
        matches!(self, C::EnterClockMode | C::Clock(_) | C::LeaveClockMode)
            || matches!(self, C::Version | C::State | C::StateCode | C::Reset { .. } | C::Reboot)
    }
}

/// Digits of a command, as many as it has.
struct Digits<'a> {
    letters: &'a [u8],
    digits: &'a [u8],
    body: &'a Body,
}

impl Digits<'_> {
    fn unit(&self) -> Unit {
        if self.letters.starts_with(b"%") { Unit::Microseconds } else { Unit::Milliseconds }
    }

    fn clock(self) -> Result<Command, Refusal> {
        match (self.digits, self.unit()) {
            (b"0", Unit::Milliseconds) => Ok(Command::EnterClockMode),
            (b"1", unit) => Ok(Command::Clock(unit)),
            (b"2", Unit::Milliseconds) => Ok(Command::LeaveClockMode),
            _ => Err(b"01"),
        }
    }

    fn baud_rate(self) -> Result<Command, Refusal> {
        match (baud_rate(self.digits), self.digits) {
            (Some(baud_rate), _) => Ok(Command::BaudRate(Some(baud_rate))),
            // "Some sensor models may not be compatible" (p. 16), and so is none here.
            (None, b"038400") => Ok(Command::BaudRate(None)),
            (None, digits) if digits.iter().all(u8::is_ascii_digit) => Err(b"02"),
            (None, _) => Err(b"01"),
        }
    }

    fn motor_speed(self) -> Result<Command, Refusal> {
        match self.number(0..2).ok_or(b"01")? {
            speed @ (0..=10 | 99) => Ok(Command::MotorSpeed(speed as u8)),
            _ => Err(b"02"),
        }
    }

    fn sensitivity(self) -> Result<Command, Refusal> {
        match self.digits {
            // Seen on a URG-04LX with firmware 3.1.04.
            _ if self.body.model == Model::Urg04lx => Err(b"0C"),
            b"0" | b"1" => Ok(Command::Sensitivity),
            _ => Err(b"01"),
        }
    }

    fn stream(self) -> Result<Command, Refusal> {
        let asked = self.asked()?;
        let skipped = self.number(10..11).ok_or(b"06")?;
        Ok(Command::Stream { asked, skipped, count: self.number(11..13).ok_or(b"07")? })
    }

    fn asked(&self) -> Result<Asked, Refusal> {
        let start = self.number(0..4).ok_or(b"01")?;
        let end = self.number(4..8).ok_or(b"02")?;
        let cluster = self.number(8..10).ok_or(b"03")?;
        let data = match self.letters.last() {
            Some(b'S') => Data::Short,
            Some(b'E') => Data::Intensities,
            _ => Data::Distances,
        };
        match () {
            () if end > self.body.geometry(true).end => Err(b"04"),
            () if start > end => Err(b"05"),
            () => Ok(Asked { data, steps: Steps { start, end, cluster }, unit: self.unit() }),
        }
    }

    fn number(&self, place: Range<usize>) -> Option<u16> {
        number(self.digits.get(place)?)
    }
}
