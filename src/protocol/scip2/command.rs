//! Commands of SCIP 2 and their bytes.

use std::fmt::{self, Write};

use super::Label;
use crate::protocol::{BaudRate, Bytes, ParameterError, Window};

/// Characters in a full line of data, without its sum (p. 13).
pub(super) const LINE: usize = 64;

/// Command with its parameters.
///
/// The window of a command for scans has the sensor's own steps: [resolve](Window::resolve) one of
/// degrees, or of all steps, with the sensor's [`Parameters::geometry`](super::Parameters::geometry).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Command {
    /// `VV`: read the sensor's identity (p. 20).
    Version,
    /// `PP`: read what the sensor measures (p. 21).
    Parameters,
    /// `II`: read the sensor's state (p. 22). Do not send it during a [`Stream`]: a UTM-30LX then
    /// sends halves of scans, a UST splits the stream.
    State,
    /// `%ST`: read the state as a number. Ethernet models only.
    StateCode,
    /// `%SL`: let the sensor sleep, with its laser off, until `QT` wakes it. Ethernet models only.
    Sleep,
    /// `BM`: switch the laser on (p. 14). It is off after power-up.
    LaserOn,
    /// `QT`: switch the laser off, and end a [`Stream`] (p. 14).
    LaserOff,
    /// `RS`: switch the laser off, and reset clock, motor speed and baud rate (p. 14).
    Reset,
    /// `RT`: like `RS`, but keep motor speed and baud rate.
    ResetClock,
    /// `RB`: restart the sensor. Send it twice within a second: the first is answered `01`.
    Reboot,
    /// `SS`: change the baud rate of RS-232 (p. 16).
    BaudRate(BaudRate),
    /// `CR`: change the speed of the motor (p. 17).
    MotorSpeed(MotorSpeed),
    /// `TM0`: enter clock mode, with the laser off (p. 15).
    EnterClockMode,
    /// `TM1`: read the clock in ms (p. 15). Real sensors answer outside of clock mode, too.
    Clock,
    /// `%TM1`: read the clock in us. A UST with firmware 4.1, or 1.1 and later.
    ClockInMicroseconds,
    /// `TM2`: leave clock mode (p. 15).
    LeaveClockMode,
    /// `GD`, `GS` or `GE`: read the newest scan (p. 13). The laser must be on.
    Latest {
        /// What to send for each point.
        data: Data,
        /// Steps to send.
        window: Window,
    },
    /// `MD`, `MS` or `ME`, and `%MD` or `%ME`: send scans without being asked again (p. 10).
    Stream(Stream),
}

impl Command {
    /// What a successful scan holds for each point, and how many points, for a command with scans.
    pub(super) const fn scan(&self) -> Option<(Data, usize)> {
        match self {
            Self::Latest { data, window } | Self::Stream(Stream { data, window, .. }) => {
                Some((*data, window.points()))
            }
            _ => None,
        }
    }

    /// Number of characters of the time in a successful reply, if there is one.
    pub(super) const fn stamp_len(&self) -> Option<usize> {
        match self {
            Self::ClockInMicroseconds | Self::Stream(Stream { in_microseconds: true, .. }) => {
                Some(11)
            }
            Self::Clock | Self::Latest { .. } | Self::Stream(_) => Some(4),
            _ => None,
        }
    }
}

/// What a sensor sends for each point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Data {
    /// `D`: a distance in three characters, 18 bits.
    Distances,
    /// `S`: a distance in two characters, 12 bits. A URG-04LX-UG01 sends 4095 for larger ones.
    ShortDistances,
    /// `E`: distance and intensity, three characters each. Do not ask a URG-04LX: it can lock up until
    /// it is switched off.
    Intensities,
}

impl Data {
    const fn letter(self) -> char {
        match self {
            Self::Distances => 'D',
            Self::ShortDistances => 'S',
            Self::Intensities => 'E',
        }
    }

    /// Number of characters for each point.
    pub(super) const fn characters(self) -> usize {
        match self {
            Self::Distances => 3,
            Self::ShortDistances => 2,
            Self::Intensities => 6,
        }
    }
}

/// Scans that the sensor sends one after the other (p. 10). It switches the laser on, answers `00`
/// once, and then sends a reply with status `99` for each scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Stream {
    /// What to send for each point.
    pub data: Data,
    /// Steps to send.
    pub window: Window,
    skipped: u8,
    count: u8,
    in_microseconds: bool,
}

impl Stream {
    /// Creates a stream of every scan, until [`Command::LaserOff`].
    pub const fn new(data: Data, window: Window) -> Self {
        Self { data, window, skipped: 0, count: 0, in_microseconds: false }
    }

    /// Leaves out this number of scans after each one sent.
    ///
    /// # Errors
    ///
    /// [`ParameterError`] above 9.
    pub fn skipping(self, scans: u8) -> Result<Self, ParameterError> {
        match scans {
            0..=9 => Ok(Self { skipped: scans, ..self }),
            _ => Err(ParameterError::new("number of skipped scans", "0 to 9", scans)),
        }
    }

    /// Ends the stream after this number of scans. The echo of each then counts down.
    ///
    /// # Errors
    ///
    /// [`ParameterError`] outside of 1..=99.
    pub fn ending_after(self, scans: u8) -> Result<Self, ParameterError> {
        match scans {
            1..=99 => Ok(Self { count: scans, ..self }),
            _ => Err(ParameterError::new("number of scans", "1 to 99", scans)),
        }
    }

    /// Asks for times in us, by `%MD` or `%ME`: of a UST with firmware 4.1, or 1.1 and later.
    pub const fn in_microseconds(self) -> Self {
        Self { in_microseconds: true, ..self }
    }
}

/// Speed of the motor: 0 is the default, 1 to 10 are other speeds, 99 is the initial one (p. 17).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct MotorSpeed(u8);

impl MotorSpeed {
    /// Creates the speed with this number.
    ///
    /// # Errors
    ///
    /// [`ParameterError`] for a number other than 0 to 10 and 99.
    pub fn new(number: u8) -> Result<Self, ParameterError> {
        match number {
            0..=10 | 99 => Ok(Self(number)),
            _ => Err(ParameterError::new("motor speed", "0 to 10, or 99", number)),
        }
    }
}

/// Writes the command as it is sent.
impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Version => "VV",
            Self::Parameters => "PP",
            Self::State => "II",
            Self::StateCode => "%ST",
            Self::Sleep => "%SL",
            Self::LaserOn => "BM",
            Self::LaserOff => "QT",
            Self::Reset => "RS",
            Self::ResetClock => "RT",
            Self::Reboot => "RB",
            Self::EnterClockMode => "TM0",
            Self::Clock => "TM1",
            Self::ClockInMicroseconds => "%TM1",
            Self::LeaveClockMode => "TM2",
            Self::BaudRate(rate) => return write!(f, "SS{:06}", rate.bits_per_second()),
            Self::MotorSpeed(MotorSpeed(speed)) => return write!(f, "CR{speed:02}"),
            Self::Latest { data, window } => return write_scan(f, 'G', *data, window),
            Self::Stream(Stream { data, window, skipped, count, in_microseconds }) => {
                f.write_str(if *in_microseconds { "%" } else { "" })?;
                write_scan(f, 'M', *data, window)?;
                return write!(f, "{skipped}{count:02}");
            }
        })
    }
}

fn write_scan(f: &mut fmt::Formatter<'_>, verb: char, data: Data, window: &Window) -> fmt::Result {
    let (start, end, cluster_count) = (window.start(), window.end(), window.cluster_count());
    write!(f, "{verb}{}{start:04}{end:04}{cluster_count:02}", data.letter())
}

/// Most bytes of a request: `%MD`, 13 digits, `;` and a label.
const LONGEST: usize = 3 + 13 + 1 + Label::CAPACITY;

/// Command with the label that its reply must echo.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Request {
    command: Command,
    label: Option<Label>,
    bytes: Bytes<LONGEST>,
}

impl Request {
    /// Creates a request. Pass `None` to send no label.
    pub fn new(command: Command, label: impl Into<Option<Label>>) -> Self {
        let (label, mut bytes) = (label.into(), Bytes::new());
        // Never fails: there is room for the longest command and label.
        let _ = match &label {
            Some(label) => write!(bytes, "{command};{label}"),
            None => write!(bytes, "{command}"),
        };
        Self { command, label, bytes }
    }

    /// Command of the request.
    pub const fn command(&self) -> &Command {
        &self.command
    }

    /// Bytes to send, without the terminator: an LF or a CR. A reply begins with the same bytes.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Strips the echo of this request from the front of `frame`, and returns the number of scans
    /// that it leaves. Returns `None` if `frame` does not begin with it.
    pub(super) fn strip_echo<'a>(&self, frame: &'a [u8]) -> Option<(u8, &'a [u8])> {
        let Command::Stream(Stream { count, .. }) = &self.command else {
            return Some((0, frame.strip_prefix(self.bytes())?));
        };
        // The number of scans counts down.
        let label_len = self.label.map_or(0, |label| label.len() + 1);
        let (head, tail) = self.bytes().split_at_checked(self.bytes.len() - label_len)?;
        let rest = frame.strip_prefix(head.split_last_chunk::<2>()?.0)?;
        let (&[tens @ b'0'..=b'9', ones @ b'0'..=b'9'], rest) = rest.split_first_chunk()? else {
            return None;
        };
        let left = (tens - b'0') * 10 + (ones - b'0');
        Some((left, rest.strip_prefix(tail)?)).filter(|_| left <= *count)
    }

    /// Length in bytes of a successful reply, terminator included: for a [`Stream`] the length of
    /// each scan. Returns `None` for `VV`, `PP` and `II`, which differ from sensor to sensor.
    pub fn reply_len(&self) -> Option<usize> {
        let characters = match &self.command {
            Command::Version | Command::Parameters | Command::State => return None,
            Command::StateCode => Some(3),
            other => other.stamp_len(),
        };
        let data = self.command.scan().map(|(data, points)| data.characters() * points);
        // Each line has a sum and an LF.
        let lines = [Some(2), characters, data].into_iter().flatten();
        let lines = lines.map(|characters| characters + 2 * characters.div_ceil(LINE));
        Some(self.bytes.len() + 1 + lines.sum::<usize>() + 1)
    }
}

/// Writes the request as it is sent.
impl fmt::Display for Request {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.bytes.fmt(f)
    }
}
