//! Times of an exchange: its [`Deadline`], and the [`Timing`] of the frame that it receives.

use std::time::{Duration, SystemTime};

use tokio::time::Instant;

use crate::codec::Frame;
use crate::protocol::{Command, Status};
use crate::{BaudRate, ErrorKind};

/// Absolute deadline of an exchange: the wire time of the command and its reply at the
/// port's baud rate, and a latency.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Deadline {
    command: Command,
    pub(super) requested: Instant,
    after: Duration,
}

impl Deadline {
    pub(super) fn new(command: Command, baud_rate: Option<BaudRate>, latency: Duration) -> Self {
        let bytes = command.bytes().len() + 1 + command.reply_len();
        let wire = baud_rate.map_or(Duration::ZERO, |rate| rate.wire_time(bytes));
        Self { command, requested: Instant::now(), after: wire + latency }
    }

    pub(super) fn at(&self) -> Instant {
        self.requested + self.after
    }

    /// Error of an exchange that has reached its deadline.
    pub(super) fn error(&self) -> ErrorKind {
        ErrorKind::Timeout { command: self.command, after: self.after }
    }
}

/// Frame received after a command.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TimedFrame<'a> {
    pub(crate) frame: Frame<&'a [u8]>,
    /// Number of its bytes on the wire.
    pub(crate) wire_len: u64,
    pub(crate) timing: Timing,
}

/// Times of a command and its reply.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Timing {
    pub(crate) requested: Instant,
    /// When the first byte was read.
    pub(crate) began: Instant,
    /// When the last byte was read.
    pub(crate) received: Instant,
    /// Wall-clock time when the first byte arrived.
    pub(crate) stamp: SystemTime,
    /// True if the reply comes from a recording: its time tells nothing about the motor.
    pub(crate) is_replayed: bool,
    /// Baud rate of the line, unless it has none or a reply has disproved it.
    pub(super) baud_rate: Option<BaudRate>,
}

impl Timing {
    /// Time that `command` and the first byte of its reply take on the wire.
    pub(crate) fn least_until_reply(&self, command: &Command) -> Duration {
        self.wire_time(command.bytes().len() + 2)
    }

    /// Returns true if the reply arrived faster than its bytes and the bytes of its
    /// `command` can. The command's echo must be unique, so that the reply cannot be an
    /// older one.
    pub(crate) fn disproves_baud_rate(&self, command: &Command, status: Status) -> bool {
        let echo = command.bytes().len() + 1;
        let bytes = echo + if status.is_ok() { command.reply_len() } else { echo + 3 };
        self.received.saturating_duration_since(self.requested) < self.wire_time(bytes)
    }

    fn wire_time(&self, bytes: usize) -> Duration {
        self.baud_rate.map_or(Duration::ZERO, |baud_rate| baud_rate.wire_time(bytes))
    }
}
