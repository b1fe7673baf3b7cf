//! [`Arrivals`]: counts the bytes from a port, and notes when a reply begins.

use std::io;
use std::time::SystemTime;

use tokio::time::Instant;

use super::PromptPort;

/// Number of bytes that may arrive between two commands. A sensor answers a command with at
/// most 1,576. Without this limit, a line that always has more to read would keep the driver
/// from checking its deadline.
pub(super) const FLOOD_BYTES: u64 = 64 * 1024;

/// Arrival of a byte, by both clocks.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arrival {
    pub(super) at: Instant,
    pub(super) stamp: SystemTime,
    /// True if the wall clock is a recording's.
    pub(super) is_replayed: bool,
}

impl Arrival {
    fn now(port: &mut PromptPort) -> Self {
        let at = Instant::now();
        let recorded = port.hints().and_then(|hints| hints.wall_clock());
        let stamp = recorded.unwrap_or_else(SystemTime::now);
        Self { at, stamp, is_replayed: recorded.is_some() }
    }
}

/// Counters of the bytes from a port.
#[derive(Debug, Default)]
pub(super) struct Arrivals {
    /// Arrival of the first byte of a reply.
    first_byte: Option<Arrival>,
    /// Number of bytes received so far.
    total: u64,
    /// First two of these bytes.
    first: [u8; 2],
    /// Number of bytes received before the latest command was written.
    before: u64,
}

impl Arrivals {
    /// Starts to count anew, because a command is written.
    pub(super) fn begin_command(&mut self) {
        self.before = self.total;
        self.begin_reply();
    }

    /// Notes that the next byte other than NUL is the first of a reply.
    pub(super) fn begin_reply(&mut self) {
        self.first_byte = None;
    }

    /// Arrival of the first byte of the reply, or the current time if no byte has arrived.
    pub(super) fn first_byte(&self, port: &mut PromptPort) -> Arrival {
        self.first_byte.unwrap_or_else(|| Arrival::now(port))
    }

    /// Number of bytes received so far.
    pub(super) fn total(&self) -> u64 {
        self.total
    }

    /// Counts received bytes, and fails if there are too many.
    pub(super) fn count(&mut self, fresh: &[u8], port: &mut PromptPort) -> io::Result<()> {
        if !fresh.is_empty() {
            if self.total < 2 {
                let unset = self.first.iter_mut().skip(self.total as usize);
                unset.zip(fresh).for_each(|(first, byte)| *first = *byte);
            }
            self.total += fresh.len() as u64;
            // The codec skips the NULs that a line leaves in front of a reply when it
            // changes its speed or breaks.
            if self.first_byte.is_none() && fresh.iter().any(|byte| *byte != 0) {
                self.first_byte = Some(Arrival::now(port));
            }
        }
        if self.total - self.before > FLOOD_BYTES { Err(flood()) } else { Ok(()) }
    }

    /// Returns true if the first two bytes ever received were a telnet command, as from a
    /// server that begins by negotiating options.
    pub(super) fn began_as_telnet(&self) -> bool {
        matches!(self.first, [0xff, 0xfb..=0xfe])
    }
}

/// Error for a line that sends far more than any sensor does.
pub(super) fn flood() -> io::Error {
    io::Error::new(
        io::ErrorKind::InvalidData,
        "expected at most 64 KiB and 64 replies after a command, found more: check that the port leads to a sensor",
    )
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tokio::time::advance;

    use super::super::scripted_port::ScriptedPort;
    use super::*;
    use crate::BaudRate;

    #[tokio::test(start_paused = true)]
    async fn a_nul_in_front_of_a_reply_is_not_its_first_byte() {
        let port = ScriptedPort { baud_rate: Some(BaudRate::B19200), ..Default::default() };
        let mut port = PromptPort(Box::new(port));
        let mut arrivals = Arrivals::default();
        arrivals.begin_command();
        arrivals.count(&[0, 0], &mut port).unwrap();
        assert!(arrivals.first_byte.is_none());
        advance(Duration::from_millis(80)).await;
        let first_byte = Instant::now();
        arrivals.count(b"\0G0", &mut port).unwrap();
        advance(Duration::from_millis(80)).await;
        arrivals.count(b"0", &mut port).unwrap();
        assert_eq!(arrivals.first_byte(&mut port).at, first_byte);
        assert_eq!(arrivals.total(), 6);
    }
}
