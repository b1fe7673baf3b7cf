//! [`Session`] for SCIP 1.1: one command is outstanding at a time.
//!
//! SCIP 1.1 numbers nothing, and two polls of the same window have the same echo. A reply
//! answers its command only because no older reply can still be on its way. Three things cast
//! doubt on that: unsolicited bytes, a malformed reply, and a missed deadline. So a command
//! leaves the link unsettled until its reply is accepted, and an unsettled link is fenced before
//! the next command.
//!
//! `exchange` sends one command and judges its reply, `fence` proves that no older reply can follow, and `unique_requests` chooses what each `G`
//! asks for.

mod baud_rate;
mod errors;
mod exchange;
mod fence;
mod identity;
mod laser;
mod scip2_model;
#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests;
mod unique_requests;

use std::io;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::time::Instant;

use self::errors::on_behalf_of;
use self::exchange::{Answer, EchoKind, accepted};
use self::unique_requests::UniqueRequests;
use super::super::failure::{ExchangeError, LinkError};
use super::super::observers::ReplyObservers;
use super::super::transport::{Limits, Transport};
use super::Acquired;
use crate::codec::MAX_FRAME;
use crate::port::Port;
use crate::protocol::{Command, Status};
use crate::state::Shared;
use crate::{BaudRate, Window};

/// A sensor answers a command with one frame of at most 1,576 bytes.
const LIMITS: Limits = Limits { frame: MAX_FRAME, frames: 64, bytes: 64 * 1024 };
/// How long after a reply a faulty line may deliver a copy of it.
const COPY_TIME: Duration = Duration::from_millis(20);

/// Stands for all commands that are answered like a scan.
const ANY_SCAN: Command = Command::Distances(Window::FULL);

/// What a session leaves for the next one.
#[derive(Debug, Default)]
pub(crate) struct Leftovers {
    /// The system keeps bytes that arrive while a port is closed, so the next session may read
    /// replies to these.
    unique_requests: UniqueRequests,
    /// True if the sensor may hold part of a command. An LF ends it, and can cost a revolution.
    interrupted: bool,
}

impl Leftovers {
    /// Before the first session, an earlier program may have left replies to anything.
    pub(crate) fn unknown() -> Self {
        Self { unique_requests: UniqueRequests::random(), interrupted: false }
    }
}

pub(crate) struct Session {
    transport: Transport,
    /// True if no reply older than the next command can be on its way.
    is_settled: bool,
    /// True once a reply arrived faster than the port's baud rate allows, as on a
    /// pseudo-terminal, a USB adapter or a server on a fast line.
    is_baud_rate_disproved: bool,
    unique_requests: UniqueRequests,
    /// How long the sensor may take to begin its answer, if set.
    reply_latency: Option<Duration>,
    observers: Arc<ReplyObservers>,
    shared: Arc<Shared>,
}

impl Session {
    pub(crate) fn new(
        port: Box<dyn Port>,
        reply_latency: Option<Duration>,
        before: Leftovers,
        observers: Arc<ReplyObservers>,
        shared: Arc<Shared>,
    ) -> Self {
        let Leftovers { unique_requests, interrupted } = before;
        shared.counters.stats().baud_rate_disproved = false;
        Self {
            transport: Transport::new(port, &LIMITS, interrupted),
            // The last user of the port may have left bytes behind.
            is_settled: false,
            is_baud_rate_disproved: false,
            unique_requests,
            reply_latency,
            observers,
            shared,
        }
    }

    /// Closes the port.
    pub(crate) fn close(self) -> Leftovers {
        let interrupted = self.transport.is_interrupted();
        Leftovers { unique_requests: self.unique_requests, interrupted }
    }

    /// Returns true while the driver is closing. A silent sensor then gets no second try.
    fn is_closing(&self) -> bool {
        self.shared.closing.is_announced()
    }

    /// Returns true if the next command has to be preceded by a [`probe`](Self::probe), as far as
    /// known without reading.
    pub(crate) fn needs_probe(&self) -> bool {
        !self.is_settled || !self.transport.pending().is_empty()
    }

    /// Waits for unsolicited bytes. The session [needs a probe](Self::needs_probe) then.
    pub(crate) fn poll_unasked(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), LinkError>> {
        self.transport.poll_idle(cx)
    }

    /// When the sensor was last heard.
    pub(crate) fn heard_at(&self) -> Option<Instant> {
        self.transport.latest_at()
    }

    pub(crate) fn can_die_silently(&mut self) -> bool {
        self.transport.can_die_silently()
    }

    pub(crate) fn delivers_intact(&mut self) -> bool {
        self.transport.delivers_intact()
    }

    /// Baud rate of the port, unless it has none.
    pub(crate) fn baud_rate(&self) -> Option<BaudRate> {
        self.transport.baud_rate()
    }

    /// Baud rate of the line, unless it has none or a reply has disproved it.
    pub(crate) fn believed_baud_rate(&self) -> Option<BaudRate> {
        self.baud_rate().filter(|_| !self.is_baud_rate_disproved)
    }

    /// Returns true if the sensor can be searched for at several baud rates.
    pub(crate) fn is_searchable(&self) -> bool {
        self.transport.is_adjustable() && self.baud_rate().is_some()
    }

    /// Drops pending input, and sends fences until one is answered. Returns true if the sensor
    /// measures: it refuses to while its laser is off.
    pub(crate) async fn probe(&mut self) -> Result<bool, ExchangeError> {
        self.discard_pending().await?;
        self.fence().await.map(Status::is_ok)
    }

    /// Asks for the values of `window`.
    pub(crate) async fn acquire(&mut self, window: Window) -> Result<Acquired, ExchangeError> {
        let wanted = Command::Distances(window);
        // First, so that the fence's `clear` cannot forget this request.
        if !self.is_quiet()? {
            self.settle().await.map_err(on_behalf_of(wanted))?;
        }
        let mut widened = self.unique_requests.widen(window);
        if widened.repeats && self.may_be_copied() {
            // A copy of the latest reply would match this request.
            Box::pin(self.fence()).await.map_err(on_behalf_of(wanted))?;
            widened = self.unique_requests.widen(window);
        }
        self.shared.counters.count_poll();
        let echo = if widened.repeats { EchoKind::Repeated } else { EchoKind::Unique };
        let command = Command::Distances(widened.asked);
        let Answer { reply, times } = accepted(&command, self.exchange(command, echo).await?)?;
        Ok(Acquired { values: reply.into_values(), first: widened.first, times })
    }

    /// Returns when [`acquire`](Self::acquire) of this window needs no fence to rule out a copy of
    /// the latest reply, or `None` if it needs no fence now.
    pub(crate) fn copies_end(&self, window: Window) -> Option<Instant> {
        let may_match = self.may_be_copied() && self.unique_requests.repeats(window);
        self.transport.latest_at().filter(|_| may_match).map(|latest| latest + COPY_TIME)
    }

    /// Sets this side's baud rate. Forgets what is known of the line at the former one.
    async fn set_port_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        self.is_settled = false;
        self.is_baud_rate_disproved = false;
        self.shared.counters.stats().baud_rate_disproved = false;
        self.transport.set_baud_rate(baud_rate).await
    }

    /// Drops pending input. Bytes without a command cast doubt on the link.
    async fn discard_pending(&mut self) -> Result<(), ExchangeError> {
        let dropped = self.transport.discard_pending().await?;
        self.record_dropped(dropped);
        Ok(())
    }

    /// Drops pending input if that needs no waiting. Returns true if there is no doubt about the link
    /// then.
    fn is_quiet(&mut self) -> Result<bool, ExchangeError> {
        match self.transport.try_discard_pending() {
            Some(dropped) => {
                self.record_dropped(dropped?);
                Ok(self.is_settled)
            }
            None => Ok(false),
        }
    }

    fn record_dropped(&mut self, bytes: u64) {
        if bytes > 0 {
            self.is_settled = false;
            self.shared.counters.stats().bytes_skipped += bytes;
        }
    }

    /// Drops pending input, and sends a fence if there is doubt about the link.
    async fn settle(&mut self) -> Result<(), ExchangeError> {
        self.discard_pending().await?;
        if self.is_settled { Ok(()) } else { Box::pin(self.fence()).await.map(drop) }
    }

    /// Returns true if a copy of the latest frame may still be on its way: on a serial line, for
    /// [`COPY_TIME`] after the frame.
    fn may_be_copied(&self) -> bool {
        // Last, because reading the clock costs more than the rest.
        self.believed_baud_rate().is_some()
            && self.transport.latest_at().is_some_and(|latest| latest.elapsed() < COPY_TIME)
    }
}
