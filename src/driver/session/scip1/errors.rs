//! Errors of SCIP 1.1's commands.

use super::super::errors::{self, Asked};
use crate::ErrorKind;
use crate::error::Operation;
use crate::protocol::{Command, Status, Text};

impl Asked for Command {
    fn operation(&self) -> Operation {
        match self {
            Command::Version => Operation::Identify,
            Command::LaserOn => Operation::LaserOn,
            Command::LaserOff => Operation::LaserOff,
            Command::BaudRate(_) => Operation::SetBaudRate,
            Command::Distances(_) => Operation::Scan,
        }
    }

    fn text(&self) -> Text {
        self.bytes()[..].into()
    }
}

pub(super) fn refused(command: &Command, status: Status) -> ErrorKind {
    errors::refused(command, status.into(), status.meaning(command))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BaudRate, Window};

    #[test]
    fn a_known_status_is_explained() {
        let refused = |command, status| refused(&command, Status::new(status)).to_string();
        for (command, status, meaning) in [
            (Command::Distances(Window::FULL), b'6', "'6': the laser is off"),
            (Command::Version, b'6', "'6'"),
            (Command::LaserOff, b'2', "'2': the laser is already in that state"),
            (Command::BaudRate(BaudRate::B115200), b'3', "or is on USB"),
            (Command::Version, b'E', "does not know the command"),
        ] {
            assert!(refused(command, status).ends_with(meaning), "{command}");
        }
    }
}
