//! The link outside of an exchange: its baud rate, its beginning and end, and bytes while it is idle.

use std::future::poll_fn;
use std::io;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use super::super::failure::LinkError;
use super::pause::Pauses;
use super::{ReplyTimes, Transport};
use crate::port::PortHints;
use crate::protocol::Text;
use crate::{BaudRate, ErrorKind};

/// Length in bytes of a reply that shows how fast a line is. A shorter one may come in one piece.
const SHOWS_SPEED: u64 = 32;
/// Speed in bits a second of the fastest baud rate.
pub(super) const FAST: u64 = 750_000;

impl Transport {
    pub(crate) fn can_die_silently(&mut self) -> bool {
        self.port.hints().is_some_and(PortHints::can_die_silently)
    }

    pub(crate) fn delivers_intact(&mut self) -> bool {
        self.port.hints().is_some_and(PortHints::delivers_intact)
    }

    /// Returns true while the device has not taken all bytes of the commands so far.
    pub(crate) fn holds_output(&mut self) -> bool {
        !self.output.is_empty() && self.port.hints().is_some_and(PortHints::holds_output)
    }

    pub(crate) fn baud_rate(&self) -> Option<BaudRate> {
        self.port.baud_rate()
    }

    /// Baud rate of the line, unless it has none or a reply has disproved it.
    pub(crate) fn believed_baud_rate(&self) -> Option<BaudRate> {
        self.baud_rate().filter(|_| !self.is_baud_rate_disproved)
    }

    /// Baud rate that the fastest reply reached. `None` if it was faster than any, or none came.
    pub(crate) fn measured_baud_rate(&self) -> Option<BaudRate> {
        let is_reached = |baud_rate: &BaudRate| u64::from(u32::from(*baud_rate)) <= self.speed;
        let reached = BaudRate::ALL.into_iter().rev().find(is_reached);
        (1..FAST).contains(&self.speed).then(|| reached.unwrap_or(BaudRate::B19200))
    }

    #[cold]
    pub(super) fn measure_speed(&mut self, times: &ReplyTimes, len: u64) {
        if len >= SHOWS_SPEED && self.believed_baud_rate().is_none() {
            let nanos = times.received.duration_since(times.began).as_nanos() as u64;
            self.speed = self.speed.max(len * 10_000_000_000 / nanos.max(1));
        }
    }

    /// Sets this side's baud rate, and drops the bytes received at another one.
    pub(crate) async fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        // What was written at another baud rate.
        self.interrupted |= !self.output.is_empty();
        self.clear_input();
        self.pauses = Pauses::default();
        self.is_baud_rate_disproved = false;
        let outcome = poll_fn(|cx| self.port.poll_set_baud_rate(cx, baud_rate)).await;
        let unsupported = |error: &io::Error| error.kind() == io::ErrorKind::Unsupported;
        self.adjustable = !outcome.as_ref().is_err_and(unsupported);
        outcome
    }

    /// Text that came before any reply, if there is one.
    pub(crate) fn words(&self) -> Option<Text> {
        self.latest_at.is_none().then(|| self.greeting.words()).flatten()
    }

    /// Received bytes that belong to no frame yet.
    pub(crate) fn pending(&self) -> &[u8] {
        &self.input
    }

    /// Latest command, as it was written.
    pub(crate) fn sent(&self) -> &[u8] {
        &self.output
    }

    /// Waits for bytes while no command is outstanding. They are [pending](Self::pending) then.
    pub(crate) fn poll_idle(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), LinkError>> {
        Poll::Ready(match ready!(self.poll_read(cx)) {
            Ok(0) => Err(self.lost(None)),
            Ok(_) => Ok(()),
            Err(error) => Err(self.lost(Some(error))),
        })
    }

    /// Failure of the port. `error` is `None` at the end of the stream.
    #[cold]
    pub(super) fn lost(&mut self, error: Option<io::Error>) -> LinkError {
        let is_over = self.port.hints().is_some_and(PortHints::is_over);
        match (is_over, error) {
            (false, error) => LinkError::Lost(match self.words() {
                Some(words) => ErrorKind::Rejected { words, source: error.map(Arc::new) },
                None => ErrorKind::disconnected(error),
            }),
            (true, None) => LinkError::Ended(ErrorKind::Closed),
            (true, error) => LinkError::Ended(ErrorKind::disconnected(error)),
        }
    }
}
