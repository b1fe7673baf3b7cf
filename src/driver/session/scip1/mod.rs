//! SCIP 1.1: one command is outstanding at a time.
//!
//! SCIP 1.1 numbers nothing, and two polls of the same window have the same echo. A reply answers
//! its command only because no older reply can still be on its way. Three things cast doubt on that:
//! unsolicited bytes, a malformed reply, and a missed deadline. So a command leaves the link
//! unsettled until its reply is accepted, and an unsettled link is fenced before the next command.
//!
//! `exchange` sends one command and judges its reply, `fence` proves that no older reply can follow,
//! and `unique_requests` chooses what each `G` asks for.

mod exchange;
mod fence;
mod laser;
mod unique_requests;

use std::time::Duration;

use tokio::time::Instant;

pub(super) use self::exchange::{Answer, EchoKind, accepted};
pub(super) use self::unique_requests::{UniqueRequests, Widened};
use super::super::failure::ExchangeError;
use super::super::rarely::rarely;
use super::super::transport::Limits;
use super::errors::on_behalf_of;
use super::line::Line;
use super::scip2;
use crate::codec::MAX_FRAME;
use crate::protocol::{Command, Status, Text, Version};
use crate::state::{KnownFrame, VersionReply};
use crate::{BaudRate, Window};

/// A sensor answers a command with one frame of at most 1,576 bytes.
pub(super) const LIMITS: Limits = Limits { frame: MAX_FRAME, frames: 64, bytes: 64 * 1024 };
/// For the first command, before anything has answered.
pub(super) const FIRST_LIMITS: Limits = Limits { frame: MAX_FRAME, ..scip2::LIMITS };
/// How long after a reply a faulty line may deliver a copy of it.
pub(super) const COPY_TIME: Duration = Duration::from_millis(20);

/// Stands for all commands that are answered like a scan.
const ANY_SCAN: Command = Command::Distances(Window::FULL);

/// Line to a sensor that speaks SCIP 1.1, as every sensor is asked at first.
pub(super) struct Scip1 {
    pub(super) line: Line,
    pub(super) unique_requests: UniqueRequests,
}

impl Scip1 {
    /// Drops pending input, and sends fences until one is answered. Returns true if the sensor
    /// measures: it refuses to while its laser is off.
    pub(super) async fn probe(&mut self) -> Result<bool, ExchangeError> {
        self.line.discard_pending().await?;
        self.fence().await.map(Status::is_ok)
    }

    /// Chooses what to ask for to get `window`. `None` if a copy of the latest reply would match.
    pub(super) fn choose(&mut self, window: Window) -> Option<Widened> {
        let widened = self.unique_requests.widen(window);
        (!widened.repeats || !self.may_be_copied()).then_some(widened)
    }

    /// Chooses what to ask for after a fence, which no copy of an older reply can follow.
    pub(super) async fn choose_after_fence(
        &mut self,
        window: Window,
    ) -> Result<Widened, ExchangeError> {
        self.fence().await.map_err(on_behalf_of(Command::Distances(window)))?;
        Ok(self.unique_requests.widen(window))
    }

    /// Returns when [`acquire`](Self::acquire) of this window needs no fence to rule out a copy of
    /// the latest reply, or `None` if it needs no fence now.
    pub(super) fn copies_end(&self, window: Window) -> Option<Instant> {
        let may_match = self.may_be_copied() && self.unique_requests.repeats(window);
        self.line.transport.latest_at.filter(|_| may_match).map(|latest| latest + COPY_TIME)
    }

    /// Reads the version once.
    pub(super) async fn version(&mut self) -> Result<VersionReply, ExchangeError> {
        let command = Command::Version;
        let Answer { reply, times } = accepted(&command, self.command_twice(command).await?)?;
        let frame = KnownFrame {
            request: None,
            bytes: reply.version_frame().into(),
            received_at: times.received,
            stamp: times.stamp,
        };
        Ok(VersionReply {
            version: Version::from_reply(&reply),
            frame: frame.into(),
            parameters: None,
        })
    }

    /// Sends `S`, and returns the status if the sensor obeys.
    pub(super) async fn send_baud_rate(
        &mut self,
        baud_rate: BaudRate,
    ) -> Result<Text, ExchangeError> {
        let command = Command::BaudRate(baud_rate);
        let answer = accepted(&command, self.command(command).await?)?;
        Ok(answer.reply.status.into())
    }

    /// Does the same, and sends it once more if there was no answer.
    pub(super) async fn send_baud_rate_twice(
        &mut self,
        baud_rate: BaudRate,
    ) -> Result<(), ExchangeError> {
        let command = Command::BaudRate(baud_rate);
        accepted(&command, self.command_twice(command).await?).map(drop)
    }

    /// Drops pending input if that needs no waiting. Returns true if there is no doubt about the link
    /// then: bytes without a command cast doubt on it.
    pub(super) fn is_quiet(&mut self) -> Result<bool, ExchangeError> {
        let dropped = self.line.try_discard_pending()?;
        self.line.is_settled &= dropped.is_none_or(|dropped| dropped == 0);
        Ok(dropped.is_some() && self.line.is_settled)
    }

    /// Drops pending input, and sends a fence if there is doubt about the link.
    pub(super) async fn settle(&mut self) -> Result<(), ExchangeError> {
        self.line.is_settled &= self.line.discard_pending().await? == 0;
        if self.line.is_settled { Ok(()) } else { rarely(|| self.fence()).await.map(drop) }
    }

    /// Returns true if a copy of the latest frame may come: on a serial line, for [`COPY_TIME`].
    pub(super) fn may_be_copied(&self) -> bool {
        // Last, because reading the clock costs more than the rest.
        self.line.transport.believed_baud_rate().is_some()
            && self.line.transport.latest_at.is_some_and(|latest| latest.elapsed() < COPY_TIME)
    }
}
