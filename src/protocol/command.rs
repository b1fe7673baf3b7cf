//! Commands of SCIP 1.1 and their bytes.

use std::fmt::{self, Write};
use std::ops::Deref;
use std::time::Duration;

use super::window::LAST;
use super::{BaudRate, Bytes, Window};

/// One of the four commands, with its parameters (C-42-3320-A p. 3).
///
/// A value of this type is always a command that a sensor knows. Sensors do not answer
/// undefined commands (p. 8), so this type cannot represent one. SCIP 1.1 has these four
/// commands and will get no more, so the enum is exhaustive.
///
/// ```
/// use tokio_scip::protocol::{BaudRate, Command, Window};
///
/// assert_eq!(&*Command::Version.bytes(), b"V");
/// assert_eq!(&*Command::LaserOn.bytes(), b"L1");
/// assert_eq!(&*Command::BaudRate(BaudRate::B57600).bytes(), b"S0576000000000");
/// assert_eq!(&*Command::Distances(Window::FULL).bytes(), b"G00076801");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Command {
    /// `V`: read the sensor's identity (p. 4).
    Version,
    /// `L1`: switch the laser on (p. 4).
    LaserOn,
    /// `L0`: switch the laser off (p. 4).
    LaserOff,
    /// `S`: change the baud rate of RS-232 (p. 5).
    BaudRate(BaudRate),
    /// `G`: read the distances in the sensor's memory (p. 5).
    Distances(Window),
}

impl Command {
    /// Bytes to send, without the terminator. A reply begins with the same bytes.
    pub fn bytes(&self) -> impl Deref<Target = [u8]> + fmt::Display + Copy + use<> {
        // The longest is `S` with its parameters.
        let mut out = Bytes::<14>::new();
        // Never fails: there is room.
        let _ = match self {
            Self::Version => out.push(b"V"),
            Self::LaserOn => out.push(b"L1"),
            Self::LaserOff => out.push(b"L0"),
            // The zeros are reserved: echoed, without effect on the sensor (p. 5).
            Self::BaudRate(rate) => write!(out, "S{:06}0000000", rate.bits_per_second()),
            Self::Distances(window) => out.push(&distances(window)),
        };
        out
    }

    /// Strips the echo of this command from the front of `frame`. Returns `None` if
    /// `frame` does not begin with it.
    pub(super) fn strip_echo<'a>(&self, frame: &'a [u8]) -> Option<&'a [u8]> {
        match self {
            // Runs for each scan: the compiler turns this into two comparisons of integers.
            Self::Distances(window) => frame
                .split_first_chunk()
                .and_then(|(echo, rest)| (*echo == distances(window)).then_some(rest)),
            other => frame.strip_prefix(&*other.bytes()),
        }
    }

    /// Length in bytes of the longest reply to this command, terminator included.
    pub(crate) fn reply_len(&self) -> usize {
        match self {
            // Up to six lines of at most 64 bytes, and room for one more.
            Self::Version => 4 + 7 * 65 + 1,
            Self::Distances(window) => window.reply_len(),
            other => other.bytes().len() + 4,
        }
    }

    /// Time that this command and its longest reply occupy a line at this baud rate.
    pub(crate) fn wire_time(&self, baud_rate: BaudRate) -> Duration {
        match self {
            Self::Distances(window) => baud_rate.wire_time(window.exchange_len()),
            other => baud_rate.wire_time(other.bytes().len() + 1 + other.reply_len()),
        }
    }
}

impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.bytes().fmt(f)
    }
}

/// Encodes a `G`. The window of a scan of another sensor may end after the last step of a `G`: the
/// command then asks for fewer points, and no reply to it fits.
#[inline(never)]
fn distances(window: &Window) -> [u8; 9] {
    let [a, b, c] = digits(window.start().min(LAST));
    let [d, e, f] = digits(window.end().min(LAST));
    let [g, h] = digits(window.cluster_count());
    [b'G', a, b, c, d, e, f, g, h]
}

/// Formats `number` as `N` decimal digits, with leading zeros.
fn digits<const N: usize>(number: impl Into<u32>) -> [u8; N] {
    let (mut out, mut number) = ([b'0'; N], number.into());
    for slot in out.iter_mut().rev() {
        *slot = b'0' + (number % 10) as u8;
        number /= 10;
    }
    out
}
