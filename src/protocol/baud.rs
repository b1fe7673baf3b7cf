//! The six baud rates of RS-232.

use std::fmt;
use std::str::FromStr;

use super::ParameterError;

/// A baud rate that a sensor knows (C-42-3320-A p. 2 and 5).
///
/// After power-up it is [`BaudRate::B19200`], unless Hokuyo's `URG_Configurer` has changed that. As
/// text, as a `u32` and as data (feature `serde`) it is the number of bits per second: 115200.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(into = "u32", try_from = "u32"))]
pub enum BaudRate {
    /// 19,200 bit/s, the usual baud rate after power-up.
    B19200,
    /// 57,600 bit/s.
    B57600,
    /// 115,200 bit/s.
    B115200,
    /// 250,000 bit/s.
    B250000,
    /// 500,000 bit/s.
    B500000,
    /// 750,000 bit/s.
    B750000,
}

impl BaudRate {
    /// All six, slowest first.
    pub const ALL: [Self; 6] =
        [Self::B19200, Self::B57600, Self::B115200, Self::B250000, Self::B500000, Self::B750000];

    /// Number of bits per second.
    pub(crate) const fn bits_per_second(self) -> u32 {
        match self {
            Self::B19200 => 19_200,
            Self::B57600 => 57_600,
            Self::B115200 => 115_200,
            Self::B250000 => 250_000,
            Self::B500000 => 500_000,
            Self::B750000 => 750_000,
        }
    }

    /// Time that `bytes` bytes take on the line: 10 bits each, with a start and a stop bit (p. 2).
    pub(crate) const fn wire_time(self, bytes: usize) -> std::time::Duration {
        let bits = (bytes as u64).saturating_mul(10);
        let baud_rate = self.bits_per_second() as u64;
        let nanos = bits % baud_rate * 1_000_000_000 / baud_rate;
        std::time::Duration::new(bits / baud_rate, nanos as u32)
    }
}

impl fmt::Display for BaudRate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.bits_per_second())
    }
}

/// Error for anything other than the six baud rates.
fn invalid(found: impl ToString) -> ParameterError {
    let expected = "19200, 57600, 115200, 250000, 500000 or 750000";
    ParameterError::new("baud rate", expected, found)
}

impl TryFrom<u32> for BaudRate {
    type Error = ParameterError;

    fn try_from(bits_per_second: u32) -> Result<Self, ParameterError> {
        Self::ALL
            .into_iter()
            .find(|baud_rate| baud_rate.bits_per_second() == bits_per_second)
            .ok_or_else(|| invalid(bits_per_second))
    }
}

impl From<BaudRate> for u32 {
    fn from(baud_rate: BaudRate) -> Self {
        baud_rate.bits_per_second()
    }
}

impl FromStr for BaudRate {
    type Err = ParameterError;

    fn from_str(text: &str) -> Result<Self, ParameterError> {
        let number = text.parse::<u32>().map_err(|_| invalid(text))?;
        Self::try_from(number).map_err(|_| invalid(text))
    }
}
