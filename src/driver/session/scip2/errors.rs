//! Errors of SCIP 2's commands.

use super::super::errors::Asked;
use crate::error::Operation;
use crate::protocol::Text;
use crate::protocol::scip2::{Command, Request};

impl Asked for Request {
    fn operation(&self) -> Operation {
        match self.command() {
            Command::LaserOn => Operation::LaserOn,
            Command::LaserOff => Operation::LaserOff,
            Command::BaudRate(_) => Operation::SetBaudRate,
            Command::Reboot => Operation::Reboot,
            Command::Latest { .. } | Command::Stream(_) => Operation::Scan,
            _ => Operation::Identify,
        }
    }

    fn text(&self) -> Text {
        // The label differs each time, and says nothing to a reader.
        self.command().to_string().into()
    }
}
