//! A fence proves that no older reply is on its way.
//!
//! A fence is a single-step `G`, with a different step each time, repeated until it is
//! answered. Replies come in order, and the sensor echoes even an invalid command. So no
//! older reply can follow the answer.

use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::super::super::failure::{ExchangeError, LinkError};
use super::super::super::transport::Transport;
use super::super::errors::{malformed, no_reply, timeout};
use super::exchange::{expected, raw_reply};
use super::{FIRST_LIMITS, Scip1};
use crate::ErrorKind;
use crate::codec::Frame;
use crate::protocol::scip2::has_data;
use crate::protocol::{Command, MalformedError, Protocol, Reply, ReplyError, Status};

/// Time between two looks at output that a device does not take.
const OUTPUT_INTERVAL: Duration = Duration::from_millis(20);

impl Scip1 {
    /// Sends fences until the latest one is answered, and returns the status of that answer.
    ///
    /// # Errors
    ///
    /// [`LinkError::Silent`] if the sensor answers no fence.
    pub(in super::super) async fn fence(&mut self) -> Result<Status, ExchangeError> {
        let mut failure = LinkError::Silent(ErrorKind::disconnected(None));
        let latency = self.usual_latency();
        for _ in 0..self.line.tries() {
            match self.fence_once(latency).await {
                Err(ExchangeError::Command(error)) => failure = LinkError::Silent(error),
                outcome => return outcome,
            }
            if self.line.shared.is_closing() {
                break;
            }
        }
        Err(failure.into())
    }

    /// Sends one fence. Waits for its answer for `latency`, in addition to its time on the wire.
    pub(in super::super) async fn fence_once(
        &mut self,
        latency: Duration,
    ) -> Result<Status, ExchangeError> {
        let command = Command::Distances(self.unique_requests.fence());
        self.line.is_settled = false;
        if !self.is_output_taken(latency).await {
            let error = timeout(&command, latency);
            tracing::trace!(%error, "the device takes no bytes");
            return Err(ExchangeError::Command(error));
        }
        self.line.shared.counters.lock().stats.fences += 1;
        let mut latest_malformed = None;
        let answer = self.answer_to_fence(&command, latency, &mut latest_malformed).await;
        let answer = match answer {
            Err(timeout @ ExchangeError::Command(ErrorKind::Timeout { .. })) => {
                let explained = explain_silence(&self.line.transport, &command);
                Err(explained.or(latest_malformed).unwrap_or(timeout))
            }
            answer => answer,
        };
        match &answer {
            Ok(_) => {
                self.line.is_settled = true;
                self.unique_requests.clear();
            }
            Err(failure) if failure.is_lost_reply() => {
                self.line.shared.counters.lock().stats.fence_timeouts += 1;
                if self.line.transport.latest_at.is_none() {
                    // Another program may have left half a command; only an LF tells an echo from a reply.
                    self.line.transport.interrupted = true;
                }
                tracing::trace!(error = %failure.kind(), "no answer to a fence");
            }
            Err(_) => {}
        }
        answer
    }

    /// Waits until the device has taken earlier commands. Returns false if it does not within `latency`.
    async fn is_output_taken(&mut self, latency: Duration) -> bool {
        let end = Instant::now() + latency;
        while self.line.transport.holds_output() {
            if Instant::now() >= end {
                return false;
            }
            sleep(OUTPUT_INTERVAL).await;
        }
        true
    }

    /// Sends a fence and waits for its answer, skipping the frames before it. Stores the error of
    /// the latest malformed frame in `latest_malformed`.
    async fn answer_to_fence(
        &mut self,
        command: &Command,
        latency: Duration,
        latest_malformed: &mut Option<ExchangeError>,
    ) -> Result<Status, ExchangeError> {
        let bytes = command.bytes();
        let within = self.wire_time(command) + latency;
        let late = |failure| no_reply(command, failure);
        let mut expected = expected(command, &bytes);
        if self.line.transport.latest_at.is_none() {
            // A server may first send the scans of SCIP 2 that it received before it had a client.
            expected.limits = &FIRST_LIMITS;
        }
        self.line.transport.send(&bytes, &expected, within).await.map_err(late)?;
        let sent = self.line.transport.sent().to_vec();
        loop {
            let received = self.line.transport.next_frame().await.map_err(late)?;
            let frame = received.frame();
            if let Frame::Reply(bytes) = frame {
                self.line.observers.pass(|| raw_reply(bytes, None, &received.times));
            }
            let error = match judge(command, frame) {
                Ok(_) if is_echoed(&sent, command, frame) => {
                    return Err(LinkError::Lost(ErrorKind::Loopback).into());
                }
                Ok(status) => {
                    let times = received.times;
                    drop(received);
                    if let Some(baud_rate) = self.line.transport.believed_baud_rate() {
                        self.check_speed(command, baud_rate, status, &times);
                    }
                    return Ok(status);
                }
                Err(ReplyError::Scip2 { status }) => {
                    let error = ErrorKind::WrongProtocol { expected: Protocol::Scip1, status };
                    return Err(ExchangeError::Command(error));
                }
                Err(error) => error,
            };
            self.line.shared.counters.count_malformed(&error, received.wire_len());
            if let ReplyError::Malformed(source) = error {
                *latest_malformed = Some(ExchangeError::Command(malformed(command, source)));
            }
        }
    }
}

/// Looks for the reply to `command` at the end of `frame`: the bytes before it are older.
fn judge(command: &Command, frame: Frame<&[u8]>) -> Result<Status, ReplyError> {
    match frame {
        Frame::Reply(bytes) => Reply::parse_end(command, bytes).map(|reply| reply.status),
        Frame::Overlong { bytes } => Err(MalformedError::Overlong { bytes }.into()),
    }
}

/// Returns true if `frame` is the bytes that were sent, followed by a reply to them.
fn is_echoed(sent: &[u8], command: &Command, frame: Frame<&[u8]>) -> bool {
    let Frame::Reply(bytes) = frame else { return false };
    bytes.strip_prefix(sent).is_some_and(|rest| rest.starts_with(&command.bytes()))
}

/// Explains why no frame answered `command`, if the unfinished frame shows the cause.
fn explain_silence(transport: &Transport, command: &Command) -> Option<ExchangeError> {
    let pending = transport.pending();
    if pending.starts_with(b"\n") && pending == transport.sent() {
        return Some(LinkError::Lost(ErrorKind::Loopback).into());
    }
    // On a slow line a scan takes longer than a fence.
    if has_data(pending) {
        let error = ErrorKind::WrongProtocol { expected: Protocol::Scip1, status: "99b".into() };
        return Some(ExchangeError::Command(error));
    }
    // Only on a port without a baud rate: a wrong one can produce any bytes.
    let telnet = !transport.adjustable && transport.greeting.is_telnet();
    let echo = [&command.bytes(), &b"\r\n"[..]].concat();
    let translated = pending.windows(echo.len()).any(|part| part == echo);
    (telnet || translated)
        .then(|| ExchangeError::Command(malformed(command, MalformedError::NotRaw)))
}
