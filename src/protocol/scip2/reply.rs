//! Validates a frame against its request: the whole echo, the status and its sum, and every line.

use super::command::{Command, Request};
use super::data::{Scan, Stamp};
use super::identity::{Parameters, State, version};
use super::lines::{characters, quoted, sum};
use super::status::Status;
use crate::protocol::{MalformedError, ReplyError, Text, Version};

/// Complete, well-formed reply to a [`Request`].
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Reply {
    /// Status of the reply.
    pub status: Status,
    /// What it says.
    pub content: Content,
}

/// What a reply says.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Content {
    /// Nothing but its status.
    Nothing,
    /// Identity of the sensor.
    Version(Version),
    /// What the sensor measures.
    Parameters(Parameters),
    /// State of the sensor.
    State(State),
    /// State of the sensor: 000 standby, 001 booting, 002 clock mode, 003 laser on, 004 sending scans,
    /// 005 asleep, 006 waking up, 900 error; 100 to 104 while the first of these is not stable.
    StateCode([u8; 3]),
    /// Time of the sensor's clock.
    Clock(Stamp),
    /// A scan.
    Scan(Scan),
}

impl Reply {
    /// Validates `frame`, a reply without its terminator, against `request`, and decodes it. For a
    /// [`Stream`](super::Stream), that is the answer with status `00` and each scan after it.
    ///
    /// # Errors
    ///
    /// Returns a [`ReplyError`] unless the frame is exactly a reply of SCIP 2 to this request.
    pub fn parse(request: &Request, frame: &[u8]) -> Result<Self, ReplyError> {
        let (left, rest) = match request.strip_echo(frame) {
            Some((left, [b'\n', rest @ ..])) => (left, rest),
            Some((_, [])) => (0, &[][..]),
            _ => return Err(foreign(request, frame)),
        };
        let mut parts = rest.splitn(2, |&byte| byte == b'\n');
        let (line, data) = (parts.next().unwrap_or_default(), parts.next());
        let status = match line {
            &[a, b, found] if sum(&[a, b]) == found => Status::new([a, b]),
            [b'!'..=b'~'] => return Err(ReplyError::Scip1 { status: line.into() }),
            _ => None,
        };
        let status = status.ok_or_else(|| {
            MalformedError::in_scip2(None, "a status of two characters and their sum", quoted(line))
        })?;
        let command = request.command();
        let has_data = match command {
            Command::Stream(_) => status.characters() == *b"99",
            Command::Version | Command::Parameters | Command::State | Command::StateCode => true,
            other => other.stamp_len().is_some(),
        } && status.is_ok();
        let content = match (data, has_data) {
            (None, false) => Content::Nothing,
            (None, true) => return Err(MalformedError::in_scip2(0, "data", "the end").into()),
            (Some(data), false) => return Err(unexpected(0, data).into()),
            (Some(data), true) => content(command, left, data)?,
        };
        Ok(Self { status, content })
    }
}

/// Error for a frame that does not begin with its request.
fn foreign(request: &Request, frame: &[u8]) -> ReplyError {
    let echo = frame.split(|&byte| byte == b'\n').next().unwrap_or_default();
    let found = Text::excerpt(echo);
    match frame {
        [0x02, ..] => ReplyError::Uam,
        [b'H' | b'N', b'D' | b'E', b'0'..=b'9', ..] => ReplyError::MultiEcho { found },
        _ if request.bytes().split(|&byte| byte == b';').next() == Some(echo) => {
            let expected = format!("the echo {} with its text", quoted(request.bytes()));
            MalformedError::in_scip2(None, expected, quoted(echo)).into()
        }
        _ => ReplyError::Foreign { found },
    }
}

fn unexpected(line: usize, data: &[u8]) -> MalformedError {
    MalformedError::in_scip2(line, "the end", quoted(data))
}

fn content(command: &Command, left: u8, data: &[u8]) -> Result<Content, MalformedError> {
    match command {
        Command::Version => return Ok(Content::Version(version(data)?)),
        Command::Parameters => return Ok(Content::Parameters(Parameters::parse(data)?)),
        Command::State => return Ok(Content::State(State::parse(data)?)),
        _ => {}
    }
    let mut lines = data.splitn(2, |&byte| byte == b'\n');
    let (first, rest) = (lines.next().unwrap_or_default(), lines.next());
    let first = characters(first, 0, command.stamp_len().unwrap_or(3))?;
    match (command.scan(), rest) {
        (Some((kind, points)), Some(rest)) => {
            Scan::parse(Stamp::parse(first)?, left, rest, kind, points).map(Content::Scan)
        }
        (Some(_), None) => Err(MalformedError::in_scip2(1, "data", "the end")),
        (None, Some(rest)) => Err(unexpected(1, rest)),
        (None, None) => match first {
            &[a, b, c] => Ok(Content::StateCode([a, b, c])),
            _ => Stamp::parse(first).map(Content::Clock),
        },
    }
}
