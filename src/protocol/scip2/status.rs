//! [`Status`]: the two characters of a reply that stand for success or a refusal.

use std::fmt;

use super::Command;
use crate::protocol::Text;

/// Status of a reply: two characters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Status([u8; 2]);

impl Status {
    /// Creates a status of two digits or capital letters: the sum does not see bit 6 of others.
    pub(super) fn new(characters: [u8; 2]) -> Option<Self> {
        let is_valid = |byte: &u8| matches!(byte, b'0'..=b'9' | b'A'..=b'Z');
        characters.iter().all(is_valid).then_some(Self(characters))
    }

    /// Both characters.
    pub(crate) const fn characters(self) -> [u8; 2] {
        self.0
    }

    /// Returns true for `00`, and for `99`, with which a stream sends each scan.
    pub const fn is_ok(self) -> bool {
        matches!(&self.0, b"00" | b"99")
    }

    /// Returns true for success, and for a status that means "nothing to do" or "once more":
    /// the laser is on already, the speed is the same, the mode is as asked, or the first `RB`.
    pub const fn is_ok_for(self, command: &Command) -> bool {
        match (command, &self.0) {
            (Command::LaserOn | Command::EnterClockMode, b"02")
            | (Command::BaudRate(_) | Command::MotorSpeed(_) | Command::LeaveClockMode, b"03")
            | (Command::Reboot, b"01") => true,
            _ => self.is_ok(),
        }
    }

    /// Meaning of this status in answer to `command` (p. 10 to 23), or `None` if it is not known.
    pub const fn meaning(self, command: &Command) -> Option<&'static str> {
        use Command as C;
        Some(match (command, &self.0) {
            (_, b"00") => "success",
            (C::Stream(_), b"99") => "a scan follows",
            (_, b"0A") => "the sensor failed to make a reply",
            (_, b"0B") => "the command is being processed already, or the buffer is full",
            (_, b"0C") => "the command is too short",
            (_, b"0D") => "the command is too long, or not known",
            (_, b"0E") => "the sensor does not know the command",
            (_, b"0F") => "the command is too short, or this model does not support it",
            (_, b"0G") => "the label is longer than 16 characters",
            (_, b"0H") => "the label has a character that is not allowed",
            (_, b"0I") => "the sensor is in firmware update mode: RS ends it",
            (_, b"0L") => "the sensor is in an abnormal state: reboot or power-cycle it",
            (_, b"0M") => "the sensor is not stable yet",
            (C::Latest { .. }, b"10") => "the laser is off",
            (_, b"10") => "the sensor's state does not allow the command",
            (C::Latest { .. } | C::Stream(_), b"01") => "the first step is not a number",
            (C::Latest { .. } | C::Stream(_), b"02") => "the last step is not a number",
            (C::Latest { .. } | C::Stream(_), b"03") => "the cluster count is not a number",
            (C::Latest { .. } | C::Stream(_), b"04") => "the last step is out of range",
            (C::Latest { .. } | C::Stream(_), b"05") => "the last step is before the first",
            (C::Stream(_), b"06") => "the number of skipped scans is not a number",
            (C::Stream(_), b"07") => "the number of scans is not a number",
            (C::Stream(_), [b'2', b'1'..=b'9'] | [b'3' | b'4', b'0'..=b'9']) => {
                "the sensor stopped to check an error"
            }
            (C::Stream(_), b"98") => "the sensor resumes, with its laser in order again",
            (C::Latest { .. } | C::Stream(_), [b'5'..=b'9', b'0'..=b'9']) => {
                "laser, motor or other hardware is out of order"
            }
            (C::LaserOn, b"01") => "the laser is out of order, or the sensor not stable yet",
            (C::LaserOn, b"02") => "the laser is on already",
            (C::BaudRate(_), b"01") => "the baud rate is not a number",
            (C::BaudRate(_), b"02") => "the sensor has no such baud rate",
            (C::BaudRate(_), b"03") => "the sensor is at that baud rate already",
            (C::MotorSpeed(_), b"01") => "the motor speed is not a number",
            (C::MotorSpeed(_), b"02") => "the motor speed is out of range",
            (C::MotorSpeed(_), b"03") => "the motor runs at that speed already",
            (C::BaudRate(_) | C::MotorSpeed(_), b"04") => "this model does not support it",
            (C::EnterClockMode | C::Clock | C::LeaveClockMode, b"01") => "the digit is wrong",
            (C::EnterClockMode, b"02") => "the sensor is in clock mode already",
            (C::LeaveClockMode, b"03") => "the sensor is not in clock mode",
            (C::Clock, b"04") => "the sensor is not in clock mode",
            (C::Reboot, b"01") => "send it once more within a second",
            _ => return None,
        })
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Text::from(&self.0[..]).fmt(f)
    }
}
