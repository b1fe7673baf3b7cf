//! [`Fence`]: proves that no older reply is on its way.
//!
//! A single-step `G`, a different one each time, is sent until it is answered.
//! Replies come in order, and even an invalid command is echoed, so nothing
//! older can follow that answer. A fence must differ from every earlier request, so
//! this module also chooses the windows of polls.

mod unique_requests;

use std::sync::Arc;
use std::time::Duration;

use tracing::Instrument;

pub(crate) use self::unique_requests::{UniqueRequests, Widened};
use super::exchange::{ExchangeError, Timing};
use super::transport::Transport;
use crate::codec::Frame;
use crate::observer::{RawReply, ReplyObserver};
use crate::protocol::{Command, Malformed, Reply, ReplyError, Status};
use crate::state::Telemetry;
use crate::{Error, Window};

/// Fences sent before a link counts as silent; and fewer where the sensor may be
/// found at another baud rate, to which it goes when it restarts.
const FENCES: usize = 6;
const FENCES_AT_A_BAUD_RATE: usize = 3;

/// Raises fences, and remembers what every `G` asked for.
pub(crate) struct Fence {
    unique_requests: UniqueRequests,
    observer: ReplyObserver,
    telemetry: Arc<Telemetry>,
}

impl Fence {
    pub(crate) fn new(
        unique_requests: UniqueRequests,
        observer: ReplyObserver,
        telemetry: Arc<Telemetry>,
    ) -> Self {
        Self { unique_requests, observer, telemetry }
    }

    /// Returns the requests that the next user of the port must not repeat.
    pub(crate) fn into_unique_requests(self) -> UniqueRequests {
        self.unique_requests
    }

    /// Returns the window to ask for in order to get `window`.
    pub(crate) fn widen(&mut self, window: Window) -> Widened {
        self.unique_requests.widen(window)
    }

    /// Sends fences until the latest of them is answered, and returns the status
    /// of that answer.
    ///
    /// # Errors
    ///
    /// [`ExchangeError::Silent`] if none is answered.
    pub(crate) async fn raise(
        &mut self,
        transport: &mut Transport,
    ) -> Result<Status, ExchangeError> {
        let mut failure = ExchangeError::Silent(Error::disconnected(None));
        let searchable = transport.is_adjustable() && transport.baud_rate().is_some();
        let latency = transport.latency(&Command::Distances(Window::FULL));
        for _ in 0..if searchable { FENCES_AT_A_BAUD_RATE } else { FENCES } {
            match self.raise_once(transport, latency).await {
                Err(ExchangeError::Command(error)) => failure = ExchangeError::Silent(error),
                outcome => return outcome,
            }
            if self.telemetry.is_closing() {
                break;
            }
        }
        Err(failure)
    }

    /// Sends one fence, to be answered within `latency`.
    pub(crate) async fn raise_once(
        &mut self,
        transport: &mut Transport,
        latency: Duration,
    ) -> Result<Status, ExchangeError> {
        let command = Command::Distances(self.unique_requests.fence());
        transport.mark_dirty();
        self.telemetry.stats().fences += 1;
        let span = tracing::trace_span!("fence", %command);
        let answer = self.exchange(transport, &command, latency).instrument(span).await;
        match &answer {
            Ok(_) => {
                transport.mark_clean();
                self.unique_requests.clear();
            }
            Err(ExchangeError::Command(Error::Timeout { .. } | Error::Malformed { .. })) => {
                self.telemetry.stats().fence_timeouts += 1;
            }
            Err(_) => {}
        }
        answer
    }

    /// Sends a fence and waits for its answer, whatever comes before it.
    async fn exchange(
        &self,
        transport: &mut Transport,
        command: &Command,
        latency: Duration,
    ) -> Result<Status, ExchangeError> {
        let command = *command;
        let mut malformed = None;
        let sent = transport.outgoing(&command);
        let mut judge =
            |frame: Frame<&[u8]>, timing: Timing| match self.judge(&command, frame, timing) {
                Ok(_) if is_echoed(&sent, &command, frame) => {
                    Some(Err(ExchangeError::Lost(Error::Loopback { sensor: None })))
                }
                Ok(status) => Some(Ok(status)),
                Err(ReplyError::Scip2 { status }) => {
                    Some(Err(ExchangeError::Command(Error::WrongProtocol { sensor: None, status })))
                }
                Err(ReplyError::Malformed(source)) => {
                    malformed = Some(ExchangeError::Command(Error::Malformed { command, source }));
                    None
                }
                Err(_) => None,
            };
        let timeout = match transport.exchange(&command, latency, &mut judge).await {
            Ok((status, timing)) => {
                transport.note_unique_reply(&command, status, timing);
                return Ok(status);
            }
            Err(timeout @ ExchangeError::Command(Error::Timeout { .. })) => timeout,
            Err(error) => return Err(error),
        };
        let explained = explain_silence(transport, &sent, &command);
        Err(explained.or(malformed).unwrap_or(timeout))
    }

    /// Looks for the reply to `command` at the end of `frame`: what is in front
    /// of it is older.
    fn judge(
        &self,
        command: &Command,
        frame: Frame<&[u8]>,
        timing: Timing,
    ) -> Result<Status, ReplyError> {
        let outcome = match frame {
            Frame::Reply(bytes) => {
                self.observer.observe(|| RawReply {
                    command: None,
                    bytes,
                    received_at: timing.received,
                    stamp: timing.stamp,
                });
                Reply::parse_end(command, bytes).map(|reply| reply.status())
            }
            Frame::Overlong { bytes } => Err(Malformed::Overlong { bytes }.into()),
        };
        if let Err(error) = &outcome
            && !matches!(error, ReplyError::Scip2 { .. })
        {
            self.telemetry.stats().malformed.count(error);
        }
        outcome
    }
}

/// Returns true if `frame` is the bytes that were sent, followed by a reply to them.
fn is_echoed(sent: &[u8], command: &Command, frame: Frame<&[u8]>) -> bool {
    let Frame::Reply(bytes) = frame else { return false };
    bytes.strip_prefix(sent).is_some_and(|rest| rest.starts_with(&command.bytes()))
}

/// Returns the cause that the unfinished frame reveals, when no frame was the
/// answer to `sent`.
fn explain_silence(transport: &Transport, sent: &[u8], command: &Command) -> Option<ExchangeError> {
    let pending = transport.unfinished_frame();
    if pending.starts_with(b"\n") && pending == sent {
        return Some(ExchangeError::Lost(Error::Loopback { sensor: None }));
    }
    // At a wrong baud rate any bytes may come, so only a port that cannot have
    // one counts as telnet.
    let telnet = !transport.is_adjustable() && transport.began_as_telnet();
    let echo = [&command.bytes(), &b"\r\n"[..]].concat();
    let translated = pending.windows(echo.len()).any(|part| part == echo);
    (telnet || translated).then(|| {
        let (command, source) = (*command, Malformed::NotRaw);
        ExchangeError::Command(Error::Malformed { command, source })
    })
}
