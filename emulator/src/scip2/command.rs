//! [`Command`]: a command line of SCIP 2 after parsing.

use crate::body::Steps;
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
    pub(super) steps: Steps,
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
type Refusal = &'static [u8; 2];

impl Command {
    /// Parses a command line without its terminator, which may have been cut.
    ///
    /// # Errors
    ///
    /// The status to answer with. Where the text (p. 10 to 23) leaves open which, it is this
    /// emulator's choice.
    pub(super) fn parse(line: &[u8], too_long: bool, model: Model) -> Result<Self, Refusal> {
        let mut parts = line.splitn(2, |&byte| byte == b';');
        let (body, text) = (parts.next().unwrap_or_default(), parts.next());
        let letters = if body.starts_with(b"%") { 3 } else { 2 };
        let (letters, digits) = body.split_at_checked(letters).ok_or(b"0E")?;
        let count = parameters(letters, model).ok_or(b"0E")?;
        if text.is_some_and(|text| text.len() > MAX_TEXT_BYTES) || too_long {
            return Err(b"0G");
        }
        let is_valid = |byte: &u8| byte.is_ascii_alphanumeric() || b" ._+@".contains(byte);
        if text.is_some_and(|text| !text.iter().all(is_valid)) {
            return Err(b"0H");
        }
        // Seen on a URG-04LX with firmware 3.1.04, which has no such command.
        if digits.len() < count || letters == b"HS" && model == Model::Urg04lx {
            return Err(b"0C");
        }
        if digits.len() > count {
            return Err(b"0D");
        }
        Self::with_digits(letters, digits, model)
    }

    /// Returns true if a sensor in clock mode accepts the command.
    pub(super) const fn is_for_clock_mode(&self) -> bool {
        use Command as C;
        matches!(self, C::EnterClockMode | C::Clock(_) | C::LeaveClockMode)
            || matches!(self, C::Version | C::State | C::StateCode | C::Reset { .. } | C::Reboot)
    }

    fn with_digits(letters: &[u8], digits: &[u8], model: Model) -> Result<Self, Refusal> {
        let unit = if letters.starts_with(b"%") { Unit::Microseconds } else { Unit::Milliseconds };
        Ok(match (letters, digits) {
            (b"VV", _) => Self::Version,
            (b"PP", _) => Self::Parameters,
            (b"II", _) => Self::State,
            (b"%ST", _) => Self::StateCode,
            (b"BM", _) => Self::LaserOn,
            (b"QT", _) => Self::LaserOff,
            (b"RS", _) => Self::Reset { all: true },
            (b"RT", _) => Self::Reset { all: false },
            (b"RB", _) => Self::Reboot,
            (b"%SL", _) => Self::Sleep,
            (b"TM", b"0") => Self::EnterClockMode,
            (b"TM" | b"%TM", b"1") => Self::Clock(unit),
            (b"TM", b"2") => Self::LeaveClockMode,
            (b"HS", b"0" | b"1") => Self::Sensitivity,
            (b"TM" | b"%TM" | b"HS", _) => return Err(b"01"),
            (b"SS", _) => Self::BaudRate(baud_rate(digits)?),
            (b"CR", _) => match number(digits).ok_or(b"01")? {
                speed @ (0..=10 | 99) => Self::MotorSpeed(speed as u8),
                _ => return Err(b"02"),
            },
            ([b'G', _], _) if model != Model::Urg04lx || letters != b"GE" => {
                Self::Latest(asked(letters, digits, unit, model)?)
            }
            ([.., b'M', b'D' | b'S' | b'E'], _) if model != Model::Urg04lx || letters != b"ME" => {
                let asked = asked(letters, digits, unit, model)?;
                let (skipped, count) = digits.get(10..).unwrap_or_default().split_at(1);
                let skipped = number(skipped).ok_or(b"06")?;
                Self::Stream { asked, skipped, count: number(count).ok_or(b"07")? }
            }
            _ => Self::Locking,
        })
    }
}

/// Number of digits that a command has on this model, or `None` if the model does not know it.
fn parameters(letters: &[u8], model: Model) -> Option<usize> {
    let has_intensities = matches!(model, Model::Utm30lx | Model::Ust10lx);
    Some(match letters {
        b"VV" | b"PP" | b"II" | b"BM" | b"QT" | b"RS" | b"RT" | b"RB" => 0,
        b"%ST" | b"%SL" if model == Model::Ust10lx => 0,
        b"TM" => 1,
        b"%TM" if model == Model::Ust10lx => 1,
        b"HS" if !has_intensities => 1,
        b"CR" => 2,
        b"SS" => 6,
        b"GD" | b"GS" => 10,
        b"GE" if has_intensities => 10,
        b"MD" | b"MS" => 13,
        b"ME" if has_intensities => 13,
        b"%MD" | b"%ME" if model == Model::Ust10lx => 13,
        // They lock it, with valid parameters.
        b"GE" | b"HD" | b"HE" if model == Model::Urg04lx => 10,
        b"ME" | b"ND" | b"NE" if model == Model::Urg04lx => 13,
        _ => return None,
    })
}

fn asked(letters: &[u8], digits: &[u8], unit: Unit, model: Model) -> Result<Asked, Refusal> {
    let part = |from: usize, to: usize| number(digits.get(from..to).unwrap_or_default());
    let start = part(0, 4).ok_or(b"01")?;
    let end = part(4, 8).ok_or(b"02")?;
    let cluster = part(8, 10).ok_or(b"03")?;
    if end > model.geometry(true).end {
        return Err(b"04");
    }
    if start > end {
        return Err(b"05");
    }
    let data = match letters.last() {
        Some(b'S') => Data::Short,
        Some(b'E') => Data::Intensities,
        _ => Data::Distances,
    };
    Ok(Asked { data, steps: Steps { start, end, cluster }, unit })
}

fn baud_rate(digits: &[u8]) -> Result<Option<BaudRate>, Refusal> {
    Ok(Some(match digits {
        b"019200" => BaudRate::B19200,
        // "Some sensor models may not be compatible" (p. 16), and so is none here.
        b"038400" => return Ok(None),
        b"057600" => BaudRate::B57600,
        b"115200" => BaudRate::B115200,
        b"250000" => BaudRate::B250000,
        b"500000" => BaudRate::B500000,
        b"750000" => BaudRate::B750000,
        _ if digits.iter().all(u8::is_ascii_digit) => return Err(b"02"),
        _ => return Err(b"01"),
    }))
}

fn number(digits: &[u8]) -> Option<u16> {
    digits.iter().try_fold(0, |number, digit| {
        digit.is_ascii_digit().then(|| number * 10 + u16::from(digit - b'0'))
    })
}
