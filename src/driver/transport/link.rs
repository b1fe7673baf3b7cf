//! The link outside of an exchange: its baud rate, its beginning and end, and bytes while it is idle.

use std::future::poll_fn;
use std::io;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use super::super::failure::LinkError;
use super::Transport;
use super::pause::Pauses;
use crate::port::PortHints;
use crate::protocol::Text;
use crate::{BaudRate, ErrorKind};

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

    /// Sets this side's baud rate, and drops the bytes received at another one.
    pub(crate) async fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        // What was written at another baud rate.
        self.interrupted |= !self.output.is_empty();
        self.clear_input();
        self.pauses = Pauses::default();
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
