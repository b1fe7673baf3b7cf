//! [`Line`]: an open port with what both protocols know of it.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use super::super::failure::ExchangeError;
use super::super::observers::ReplyObservers;
use super::super::transport::{ReplyTimes, Transport};
use crate::BaudRate;
use crate::state::Shared;

/// Number of unanswered fences or probes after which a link counts as silent. Fewer if the sensor may
/// have restarted at another baud rate.
const TRIES: usize = 6;
pub(super) const TRIES_AT_A_BAUD_RATE: usize = 3;

/// Open port, and what is known of it in either protocol.
pub(super) struct Line {
    pub(super) transport: Transport,
    /// True if no reply older than the next command can be on its way.
    pub(super) is_settled: bool,
    /// How long the sensor may take to begin its answer, if set.
    pub(super) reply_latency: Option<Duration>,
    pub(super) observers: Arc<ReplyObservers>,
    pub(super) shared: Arc<Shared>,
}

impl Line {
    /// Returns true if the sensor can be searched for at several baud rates.
    pub(super) fn is_searchable(&self) -> bool {
        self.transport.adjustable && self.transport.baud_rate().is_some()
    }

    /// Number of unanswered commands after which the link counts as silent.
    pub(super) fn tries(&self) -> usize {
        if self.is_searchable() { TRIES_AT_A_BAUD_RATE } else { TRIES }
    }

    /// Sets this side's baud rate. Forgets what is known of the line at the former one.
    pub(super) async fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        self.shared.counters.lock().stats.baud_rate_disproved = false;
        self.transport.set_baud_rate(baud_rate).await
    }

    /// Drops pending input. Returns the number of bytes.
    pub(super) async fn discard_pending(&mut self) -> Result<u64, ExchangeError> {
        let dropped = self.transport.discard_pending().await?;
        self.count_dropped(dropped);
        Ok(dropped)
    }

    /// Does the same if that needs no waiting. Returns `None` if it does.
    pub(super) fn try_discard_pending(&mut self) -> Result<Option<u64>, ExchangeError> {
        let Some(dropped) = self.transport.try_discard_pending() else { return Ok(None) };
        let dropped = dropped?;
        self.count_dropped(dropped);
        Ok(Some(dropped))
    }

    fn count_dropped(&self, bytes: u64) {
        if bytes > 0 {
            self.shared.counters.lock().stats.bytes_skipped += bytes;
        }
    }

    /// Checks whether a command and its reply took less time than their `wire_time`: then the port's
    /// baud rate is wrong. The reply must not be an older one.
    pub(super) fn check_speed(&mut self, wire_time: Duration, times: &ReplyTimes) {
        if times.received - times.requested < wire_time {
            self.disprove_baud_rate();
        }
    }

    #[cold]
    fn disprove_baud_rate(&mut self) {
        self.transport.is_baud_rate_disproved = true;
        self.shared.counters.lock().stats.baud_rate_disproved = true;
        tracing::debug!("replies come faster than the baud rate can carry");
    }
}
