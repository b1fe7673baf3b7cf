//! Errors of SCIP 2's commands.

use super::super::errors::{Asked, malformed};
use crate::ErrorKind;
use crate::error::Operation;
use crate::protocol::scip2::{Command, ReplyError, Request};
use crate::protocol::{MalformedError, Text};

impl Asked for Request {
    fn operation(&self) -> Operation {
        match self.command() {
            Command::LaserOn => Operation::LaserOn,
            Command::LaserOff => Operation::LaserOff,
            Command::BaudRate(_) => Operation::SetBaudRate,
            Command::Latest { .. } | Command::Stream(_) => Operation::Scan,
            _ => Operation::Identify,
        }
    }

    fn text(&self) -> Text {
        // The label differs each time, and says nothing to a reader.
        self.command().to_string().into()
    }
}

/// Converts the error of a reply to `request`.
pub(super) fn bad_reply(request: &Request, error: ReplyError) -> ErrorKind {
    let source = match error {
        ReplyError::Malformed(source) => MalformedError::Scip2(source),
        // Damaged, or from a URG-04LX that has restarted: then it answers nothing else either.
        ReplyError::Scip1(found) => MalformedError::Status { found },
        ReplyError::Foreign(found) | ReplyError::MultiEcho(found) => MalformedError::Echo { found },
        ReplyError::Uam => MalformedError::Echo { found: Text::default() },
    };
    malformed(request, source)
}
