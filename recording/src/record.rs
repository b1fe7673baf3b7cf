//! [`Record`]: one message of a recording.

use std::ops::Range;
use std::sync::Arc;
use std::time::SystemTime;

use crate::event::Event;
use crate::ros::LaserScan;
use tokio_scip::protocol::Command;
use tokio_scip::{BaudRate, Window};

/// One recorded message.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Record {
    /// When it happened: the wall clock at the start of the recording, continued by a
    /// steady clock, which is never set.
    pub at: SystemTime,
    /// Publish time: for a recorded scan or reply, its stamp.
    pub(super) stamp: SystemTime,
    /// Topic of a scan if it is not `/scan`.
    pub(super) topic: Option<Arc<str>>,
    /// Number among the records of its kind. For a scan, its number in its schedule.
    pub sequence: u32,
    /// Content.
    pub entry: Entry,
}

/// Content of a [`Record`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Entry {
    /// Scan that the stream delivered.
    Scan(LaserScan),
    /// Reply of the sensor.
    Reply(RecordedReply),
    /// Other event.
    Event(Event),
}

/// Reply of the sensor, byte by byte.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct RecordedReply {
    /// Command that it answers, even if the reply is malformed. `None` for the reply to a
    /// fence and for an unsolicited one.
    pub command: Option<Command>,
    /// Bytes of the reply, including the two LFs at its end.
    pub bytes: Vec<u8>,
    /// Wall clock when the first byte arrived.
    pub stamp: SystemTime,
}

/// Parses a command as it is written on the wire.
pub(super) fn parse_command(text: &str) -> Option<Command> {
    let digits = text.strip_prefix('G').unwrap_or_default();
    if digits.len() == 8 && digits.bytes().all(|byte| byte.is_ascii_digit()) {
        let number = |range: Range<usize>| digits.get(range)?.parse::<u16>().ok();
        let window = Window::new(number(0..3)?..=number(3..6)?).ok()?;
        let cluster = number(6..8)?.try_into().ok()?;
        let command = window.with_cluster_count(cluster).ok().map(Command::Distances);
        // A window may have more steps than a `G` can name.
        return command.filter(|command| command.to_string() == text);
    }
    let fixed = [Command::Version, Command::LaserOn, Command::LaserOff];
    let speeds = BaudRate::ALL.into_iter().map(Command::BaudRate);
    fixed.into_iter().chain(speeds).find(|command| command.to_string() == text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_parses_back_from_its_text() {
        let window = Window::new(3..=768).and_then(|window| window.with_cluster_count(99)).unwrap();
        let commands = [Command::Version, Command::LaserOn, Command::LaserOff]
            .into_iter()
            .chain(BaudRate::ALL.into_iter().map(Command::BaudRate))
            .chain([Command::Distances(window), Command::Distances(Window::FULL)]);
        for command in commands {
            assert_eq!(parse_command(&command.to_string()), Some(command));
        }
        for text in [
            "",
            "G",
            "G00076800",
            "G00076901",
            "G76800001",
            "G+0076801",
            "Gx0076801",
            "G\u{e9}\u{e9}\u{e9}\u{e9}",
            "X",
        ] {
            assert_eq!(parse_command(text), None, "{text}");
        }
    }
}
