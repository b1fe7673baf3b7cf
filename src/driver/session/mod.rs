//! [`Session`]: one open port, on which one command is outstanding at a time.
//!
//! SCIP 1.1 numbers nothing, and two polls of the same window have the same echo. A reply
//! answers its command only because no older reply can still be on its way. Three things cast
//! doubt on that: unsolicited bytes, a malformed reply, and a missed deadline. Each makes the
//! link dirty, and a dirty link is fenced before the next command.
//!
//! `exchange` sends a command and judges its reply, `fence` proves that no older
//! reply can follow, and `unique_requests` chooses what each `G` asks for.

mod exchange;
mod fence;
mod unique_requests;

use std::sync::Arc;
use std::time::Duration;

use self::exchange::EchoKind;
pub(crate) use self::unique_requests::UniqueRequests;
use super::failure::ExchangeError;
use super::observers::ReplyObservers;
use super::transport::{Timing, Transport};
use crate::port::Port;
use crate::protocol::{Command, Reply, Status, Version};
use crate::state::{Telemetry, VersionReply};
use crate::{ErrorKind, Window};

/// Reader of a reply. A trait object, so that the driver is compiled only once.
type Read<'a> = dyn FnMut(&Reply<'_>) + Send + 'a;

/// Result of a successful poll, besides its values.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Polled {
    pub(crate) timing: Timing,
    /// Index of the window's first value. Successive polls ask for extra values before or
    /// after the window.
    pub(crate) first: usize,
}

pub(crate) struct Session {
    pub(crate) transport: Transport,
    unique_requests: UniqueRequests,
    observers: Arc<ReplyObservers>,
    telemetry: Arc<Telemetry>,
}

impl Session {
    pub(crate) fn new(
        port: Box<dyn Port>,
        latency: Option<Duration>,
        unique_requests: UniqueRequests,
        observers: Arc<ReplyObservers>,
        telemetry: Arc<Telemetry>,
    ) -> Self {
        let transport = Transport::new(port, latency, Arc::clone(&telemetry));
        Self { transport, unique_requests, observers, telemetry }
    }

    /// Closes the port, and returns the requests that the next session must not repeat.
    pub(crate) fn close(self) -> UniqueRequests {
        self.unique_requests
    }

    /// Drops pending input, and sends a fence if the link is dirty. Returns the status of the
    /// fence.
    pub(crate) async fn settle(&mut self) -> Result<Option<Status>, ExchangeError> {
        self.transport.discard_pending().await?;
        if !self.transport.is_dirty() {
            return Ok(None);
        }
        self.fence().await.map(Some)
    }

    /// Returns true while the driver is closing. A silent sensor then gets no second try.
    pub(crate) fn is_closing(&self) -> bool {
        self.telemetry.is_closing()
    }

    /// Polls `window`, and decodes the reply into `values`. Set `can_wait` if the poll may be
    /// a few milliseconds late.
    pub(crate) async fn poll(
        &mut self,
        window: Window,
        can_wait: bool,
        values: &mut Arc<[u16]>,
    ) -> Result<Polled, ExchangeError> {
        // First, so that the fence's `clear` cannot forget this poll.
        self.settle().await.map_err(|error| error.of(Command::Distances(window)))?;
        let mut widened = self.unique_requests.widen(window);
        if widened.repeats && self.transport.may_echo() {
            // A copy of the latest reply would match this poll. A fence rules the copy out,
            // but costs a revolution. A poll on a grid can wait instead: then the line is as
            // quiet as before a poll of a slower grid.
            let is_fenced = if can_wait {
                self.transport.wait_for_echo().await;
                self.settle().await.map(|status| status.is_some())
            } else {
                self.fence().await.map(|_| true)
            };
            if is_fenced.map_err(|error| error.of(Command::Distances(window)))? {
                widened = self.unique_requests.widen(window);
            }
        }
        self.telemetry.stats().polls += 1;
        let echo = if widened.repeats { EchoKind::Repeated } else { EchoKind::Unique };
        let (_, timing) =
            self.exchange(Command::Distances(widened.asked), echo, values, &mut |_| ()).await?;
        Ok(Polled { timing, first: widened.first })
    }

    /// Reads the version of the sensor.
    pub(crate) async fn version(&mut self) -> Result<VersionReply, ExchangeError> {
        let (mut version, mut frame) = (Version::default(), Vec::new());
        let mut read = |reply: &Reply<'_>| {
            version = Version::from_reply(reply);
            frame = reply.frame(&Command::Version);
        };
        let (_, timing) = self.command_twice(Command::Version, &mut read).await?;
        let Timing { received, stamp, .. } = timing;
        Ok(VersionReply { version, frame: frame.into(), received_at: received, stamp })
    }

    /// Sends `command`, shows its reply to `read`, and returns its status and its times.
    ///
    /// # Errors
    ///
    /// Any status but success is [`ErrorKind::Refused`].
    pub(crate) async fn command(
        &mut self,
        command: Command,
        read: &mut Read<'_>,
    ) -> Result<(Status, Timing), ExchangeError> {
        self.settle().await.map_err(|error| error.of(command))?;
        self.exchange(command, EchoKind::Common, &mut Arc::default(), read).await
    }

    /// Like [`command`](Self::command), but sends the command once more if there was no
    /// answer. Only for commands that may be sent twice.
    pub(crate) async fn command_twice(
        &mut self,
        command: Command,
        read: &mut Read<'_>,
    ) -> Result<(Status, Timing), ExchangeError> {
        match self.command(command, read).await {
            Err(ExchangeError::Command(
                ErrorKind::Timeout { .. } | ErrorKind::Malformed { .. },
            )) if !self.telemetry.is_closing() => self.command(command, read).await,
            outcome => outcome,
        }
    }
}
