//! [`Session`]: one open port, on which one command is outstanding at a time.
//!
//! SCIP 1.1 numbers nothing, and two polls of the same window have the same
//! echo. A reply is the answer to its command because nothing older can still be
//! on its way. So everything that casts doubt on that (bytes that nobody asked
//! for, a malformed reply, a deadline that passed) makes the link dirty, and a
//! dirty link is fenced before the next command.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tracing::Instrument;

use super::exchange::{ExchangeError, Timing};
use super::fence::{Fence, UniqueRequests, Widened};
use super::transport::Transport;
use crate::codec::Frame;
use crate::observer::{RawReply, ReplyObserver};
use crate::port::Port;
use crate::protocol::{Command, Malformed, Reply, ReplyError, Status, Version};
use crate::state::Telemetry;
use crate::{BaudRate, Error, Window};

/// A reader of replies. Not a type parameter: the driver is compiled once for all.
type Read<'a> = dyn FnMut(&Reply<'_>) + Send + 'a;

/// The result of a successful poll, besides its values.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Polled {
    pub(crate) timing: Timing,
    /// The index of the first value of the window: successive polls ask for some values
    /// in front of it or behind it.
    pub(crate) first: usize,
}

pub(crate) struct Session {
    transport: Transport,
    fence: Fence,
    observer: ReplyObserver,
    telemetry: Arc<Telemetry>,
}

impl Session {
    pub(crate) fn new(
        port: Box<dyn Port>,
        latency: Option<Duration>,
        observer: ReplyObserver,
        unique_requests: UniqueRequests,
        telemetry: Arc<Telemetry>,
    ) -> Self {
        let fence = Fence::new(unique_requests, observer.clone(), Arc::clone(&telemetry));
        let transport = Transport::new(port, latency, Arc::clone(&telemetry));
        Self { transport, fence, observer, telemetry }
    }

    /// Closes the port, and returns the requests that the next session must not repeat.
    pub(crate) fn close(self) -> UniqueRequests {
        self.fence.into_unique_requests()
    }

    pub(crate) fn baud_rate(&self) -> Option<BaudRate> {
        self.transport.baud_rate()
    }

    pub(crate) fn can_die_silently(&self) -> bool {
        self.transport.can_die_silently()
    }

    /// Sets this side's baud rate.
    pub(crate) fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        self.transport.set_baud_rate(baud_rate)
    }

    /// Returns whether the port can change its baud rate, as far as was tried.
    pub(crate) fn is_adjustable(&self) -> bool {
        self.transport.is_adjustable()
    }

    /// Returns the number of bytes that ever arrived.
    pub(crate) fn received(&self) -> u64 {
        self.transport.received()
    }

    /// Returns true if a fence is needed before the next command.
    pub(crate) fn is_dirty(&self) -> bool {
        self.transport.is_dirty()
    }

    /// Returns the time that the sensor may take to begin its answer.
    pub(crate) fn latency(&self, command: &Command) -> Duration {
        self.transport.latency(command)
    }

    /// Waits while no command is outstanding until bytes arrive, and drops them.
    /// Cancel-safe.
    ///
    /// Like other methods that only pass on a future, it is not `async`: that would wrap it in
    /// another one, which is compiled and kept, too.
    pub(crate) fn idle(&mut self) -> impl Future<Output = Result<(), ExchangeError>> {
        self.transport.idle()
    }

    /// Drops pending input, and raises a fence if one is needed. Returns the status of its
    /// answer.
    pub(crate) async fn settle(&mut self) -> Result<Option<Status>, ExchangeError> {
        self.discard_pending().await?;
        if !self.transport.is_dirty() {
            return Ok(None);
        }
        self.fence().await.map(Some)
    }

    /// Requires a fence before the next command, as after a malformed reply.
    pub(crate) fn mark_dirty(&mut self) {
        self.transport.mark_dirty();
    }

    /// Drops pending input: it is older than the next command.
    pub(crate) fn discard_pending(&mut self) -> impl Future<Output = Result<(), ExchangeError>> {
        self.transport.discard_pending()
    }

    /// Sends fences until one is answered, and returns the status of its answer.
    pub(crate) fn fence(&mut self) -> impl Future<Output = Result<Status, ExchangeError>> {
        self.fence.raise(&mut self.transport)
    }

    /// Sends one fence, to be answered within `latency`.
    pub(crate) fn fence_once(
        &mut self,
        latency: Duration,
    ) -> impl Future<Output = Result<Status, ExchangeError>> {
        self.fence.raise_once(&mut self.transport, latency)
    }

    /// Polls `window`. The reply is decoded into `values`.
    pub(crate) async fn poll(
        &mut self,
        window: Window,
        values: &mut Arc<[u16]>,
    ) -> Result<Polled, ExchangeError> {
        // First: what a fence clears must not be this poll.
        self.settle().await.map_err(|error| error.of(Command::Distances(window)))?;
        let mut widened = self.fence.widen(window);
        if widened.repeats && self.transport.may_echo() {
            // A copy of the latest reply would match this poll; a fence rules one out.
            self.fence().await.map_err(|error| error.of(Command::Distances(window)))?;
            widened = self.fence.widen(window);
        }
        let Widened { asked, surplus, repeats } = widened;
        let command = Command::Distances(asked);
        self.telemetry.stats().polls += 1;
        // No byte of the reply comes before the command has left the wire. Where
        // the echo proves nothing, what does is a copy of the latest reply.
        let least = match repeats {
            true => self.transport.least_wire_time(command.bytes().len() + 2),
            false => Duration::ZERO,
        };
        let (_, timing) = self.exchange(command, least, values, &mut |_| ()).await?;
        if !repeats {
            self.transport.note_unique_reply(&command, Status::OK, timing);
        }
        self.telemetry.stats().scanned(timing.requested, timing.received);
        Ok(Polled { timing, first: surplus })
    }

    /// Reads the version of the sensor.
    pub(crate) async fn version(&mut self) -> Result<Version, ExchangeError> {
        let mut version = Version::default();
        let mut read = |reply: &Reply<'_>| version = Version::from_reply(reply);
        self.command_twice(Command::Version, &mut read).await?;
        Ok(version)
    }

    /// Sends `command`, shows its reply to `read`, and returns its status.
    ///
    /// # Errors
    ///
    /// Any status but success is [`Error::Refused`].
    pub(crate) async fn command(
        &mut self,
        command: Command,
        read: &mut Read<'_>,
    ) -> Result<Status, ExchangeError> {
        self.settle().await.map_err(|error| error.of(command))?;
        let answer = self.exchange(command, Duration::ZERO, &mut Arc::default(), read).await?;
        Ok(answer.0)
    }

    /// Like [`command`](Self::command), and once more if there was no answer:
    /// for commands that may be sent twice.
    pub(crate) async fn command_twice(
        &mut self,
        command: Command,
        read: &mut Read<'_>,
    ) -> Result<Status, ExchangeError> {
        match self.command(command, read).await {
            Err(ExchangeError::Command(Error::Timeout { .. } | Error::Malformed { .. }))
                if !self.telemetry.is_closing() =>
            {
                self.command(command, read).await
            }
            outcome => outcome,
        }
    }

    /// Sends `command` on a link that is settled, and judges the frame that
    /// comes: it is the answer, or the command has failed. To wait for a better
    /// one would cost the whole deadline wherever the reply itself was damaged.
    ///
    /// A reply that begins sooner than `least` after its command is refused.
    async fn exchange(
        &mut self,
        command: Command,
        least: Duration,
        values: &mut Arc<[u16]>,
        read: &mut Read<'_>,
    ) -> Result<(Status, Timing), ExchangeError> {
        let Self { transport, observer, telemetry, .. } = self;
        let latency = transport.latency(&command);
        let mut judge = |frame: Frame<&[u8]>, timing: Timing| {
            let after = timing.began - timing.requested;
            let outcome = match parse(&command, frame, timing, observer, values) {
                Ok(_) if after < least => Err(Malformed::Early { after, least }.into()),
                outcome => outcome,
            };
            if let Err(error) = &outcome {
                let mut stats = telemetry.stats();
                stats.malformed.count(error);
                if !is_echoed(error) {
                    stats.bytes_skipped += frame.wire_len();
                }
            }
            let error = match outcome {
                Ok(reply) if reply.status().is_ok_for(&command) => {
                    read(&reply);
                    return Some(Ok(reply.status()));
                }
                Ok(reply) => Error::Refused { command, status: reply.status() },
                Err(ReplyError::Malformed(source)) => Error::Malformed { command, source },
                Err(ReplyError::Scip2 { status }) => Error::WrongProtocol { sensor: None, status },
                Err(ReplyError::Foreign { found }) => {
                    Error::Malformed { command, source: Malformed::Echo { found } }
                }
            };
            Some(Err(ExchangeError::Command(error)))
        };
        let span = tracing::trace_span!("exchange", %command);
        let answer = transport.exchange(&command, latency, &mut judge);
        let answer = answer.instrument(span.clone()).await;
        if let Err(ExchangeError::Command(error)) = &answer {
            tracing::trace!(parent: &span, %error, "no answer");
            match error {
                Error::Refused { .. } => self.telemetry.stats().refused += 1,
                Error::Timeout { .. } => self.telemetry.stats().timeouts += 1,
                _ => self.transport.mark_dirty(),
            }
        }
        answer
    }
}

/// Compares a frame with `command`, and shows it to the observer.
fn parse<'a>(
    command: &Command,
    frame: Frame<&'a [u8]>,
    timing: Timing,
    observer: &ReplyObserver,
    values: &mut Arc<[u16]>,
) -> Result<Reply<'a>, ReplyError> {
    let bytes = match frame {
        Frame::Reply(bytes) => bytes,
        Frame::Overlong { bytes } => return Err(Malformed::Overlong { bytes }.into()),
    };
    let outcome = Reply::parse_into_shared(command, bytes, values);
    observer.observe(|| RawReply {
        command: outcome.as_ref().err().is_none_or(is_echoed).then_some(*command),
        bytes,
        received_at: timing.received,
        stamp: timing.stamp,
    });
    outcome
}

/// Returns true if a reply with this error began with its command.
fn is_echoed(error: &ReplyError) -> bool {
    !matches!(error, ReplyError::Foreign { .. } | ReplyError::Malformed(Malformed::Overlong { .. }))
}
