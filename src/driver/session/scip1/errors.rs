//! Errors of SCIP 1.1's commands.

use super::super::errors::Asked;
use crate::error::Operation;
use crate::protocol::{Command, Text};

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
