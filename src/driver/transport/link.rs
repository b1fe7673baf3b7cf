//! The link outside of an exchange: its baud rate, how it began and ended, whether an older
//! reply may be on its way, and the bytes that arrive while it is idle.

use std::future::poll_fn;
use std::io;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::time::{Instant, Sleep, sleep_until};

use super::super::failure::{ExchangeError, LinkError};
use super::pause::Pauses;
use super::{SCRATCH_BYTES, Transport, again_if_interrupted};
use crate::port::PortHints;
use crate::protocol::Command;
use crate::{BaudRate, ErrorKind};

/// How long after a reply a faulty line may deliver a copy of it.
pub(super) const QUIET_TIME: Duration = Duration::from_millis(20);

impl Transport {
    pub(crate) fn can_die_silently(&mut self) -> bool {
        self.port.hints().is_some_and(PortHints::can_die_silently)
    }

    pub(crate) fn baud_rate(&self) -> Option<BaudRate> {
        self.port.0.baud_rate()
    }

    /// Sets this side's baud rate, and drops the bytes received at another one.
    pub(crate) fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        self.dirty = true;
        self.interrupted = true;
        self.drop_input();
        self.outrun = false;
        self.telemetry.stats().baud_rate_outrun = false;
        self.pauses = Pauses::default();
        let outcome = self.port.0.set_baud_rate(baud_rate);
        let unsupported = |error: &io::Error| error.kind() == io::ErrorKind::Unsupported;
        self.adjustable = !outcome.as_ref().is_err_and(unsupported);
        outcome
    }

    /// Returns true if the port can change its baud rate, as far as known from trying.
    pub(crate) fn is_adjustable(&self) -> bool {
        self.adjustable
    }

    /// Baud rate of the line, unless it has none or a reply has disproved it.
    pub(super) fn believed_baud_rate(&self) -> Option<BaudRate> {
        self.baud_rate().filter(|_| !self.outrun)
    }

    /// Notes that a reply has disproved the port's baud rate.
    pub(crate) fn note_outrun(&mut self) {
        self.outrun = true;
        self.telemetry.stats().baud_rate_outrun = true;
        tracing::debug!("replies come faster than the baud rate can carry");
    }

    /// Returns true if a copy of the latest frame may still be on its way: on a serial
    /// line, for [`QUIET_TIME`] after the frame.
    pub(crate) fn may_echo(&self) -> bool {
        // Last, because reading the clock costs more than the rest.
        self.believed_baud_rate().is_some()
            && self.latest_at.is_some_and(|latest| latest.elapsed() < QUIET_TIME)
    }

    /// Waits until no copy of the latest frame can be on its way any more.
    pub(crate) fn wait_for_echo(&self) -> Sleep {
        sleep_until(self.latest_at.map_or_else(Instant::now, |latest| latest + QUIET_TIME))
    }

    /// How long the sensor may take to begin its answer.
    pub(crate) fn latency(&self, command: &Command) -> Duration {
        let usual = match command {
            Command::Distances(_) => Duration::from_millis(500),
            _ => Duration::from_secs(1),
        };
        self.latency.unwrap_or(usual)
    }

    pub(crate) fn received(&self) -> u64 {
        self.arrivals.total()
    }

    pub(crate) fn began_as_telnet(&self) -> bool {
        self.arrivals.began_as_telnet()
    }

    /// Bytes of a frame that is not complete yet.
    pub(crate) fn unfinished_frame(&self) -> &[u8] {
        &self.input
    }

    /// Latest command, as it was written.
    pub(crate) fn sent(&self) -> &[u8] {
        &self.output
    }

    /// Returns true if the next command needs a fence before it.
    pub(crate) fn is_dirty(&self) -> bool {
        self.dirty
    }

    /// Requires a fence before the next command.
    pub(crate) fn mark_dirty(&mut self) {
        self.dirty = true;
    }

    /// Clears the doubt about the link: a fence was answered, so no older reply follows.
    pub(crate) fn mark_clean(&mut self) {
        self.dirty = false;
    }

    /// Waits for bytes while no command is outstanding, and drops them. Cancel-safe.
    pub(crate) async fn idle(&mut self) -> Result<(), ExchangeError> {
        // Reads at most part of a frame, so that the driver can do other work between two
        // reads.
        let read =
            poll_fn(|cx| self.poll_drop(cx)).await.map_err(|error| self.lost(Some(error)))?;
        if read == 0 {
            return Err(self.lost(None));
        }
        self.telemetry.stats().bytes_skipped += read as u64;
        self.dirty = true;
        Ok(())
    }

    /// Waits for bytes, drops them, and returns their number.
    fn poll_drop(&mut self, cx: &mut Context<'_>) -> Poll<io::Result<usize>> {
        let mut scratch = [0; SCRATCH_BYTES];
        let outcome = self.port.poll_read(cx, &mut scratch.as_mut_slice());
        let read = ready!(again_if_interrupted(outcome, &mut self.retry_timer, cx))?;
        self.arrivals.count(scratch.get(..read).unwrap_or_default(), &mut self.port)?;
        Poll::Ready(Ok(read))
    }

    pub(super) fn drop_input(&mut self) {
        self.latest = None;
        self.input.clear();
        self.codec.reset();
    }

    /// Outcome of an exchange on a failed port. `error` is `None` at the end of the stream.
    pub(super) fn lost(&mut self, error: Option<io::Error>) -> ExchangeError {
        let is_over = self.port.hints().is_some_and(PortHints::is_over);
        match (is_over, error) {
            (false, error) => LinkError::Lost(ErrorKind::disconnected(error)),
            (true, None) => LinkError::Ended(ErrorKind::Closed),
            (true, error) => LinkError::Ended(ErrorKind::disconnected(error)),
        }
        .into()
    }
}
