//! One request and its reply: sends it, drops the frames that answer other requests, and judges the
//! one that answers it.

use std::time::Duration;

use super::super::super::failure::ExchangeError;
use super::super::super::transport::{Expected, NoFrame, ReplyTimes};
use super::super::errors::{no_reply, refused};
use super::errors::bad_reply;
use super::{LIMITS, Scip2};
use crate::RawReply;
use crate::codec::FoundFrame;
use crate::protocol::scip2::{Command, Content, Reply, ReplyError, Request, Status};
use crate::protocol::{Protocol, Text};
use crate::state::Shared;

/// Length of the longest replies without scans: `VV`, `PP` and `II`.
const TEXT_LEN: usize = 512;

/// Reply to a request.
#[derive(Debug)]
pub(super) struct Answer {
    pub(super) status: Status,
    pub(super) content: Content,
    /// Bytes of the reply, if it is one to `VV`.
    pub(super) frame: Vec<u8>,
    pub(super) times: ReplyTimes,
}

impl Scip2<'_> {
    /// Sends `command` and returns its reply, whatever its status. A damaged reply fails: waiting for
    /// a better one would cost the whole deadline.
    pub(super) async fn exchange(
        &mut self,
        command: Command,
        latency: Duration,
    ) -> Result<Answer, ExchangeError> {
        let request = Request::new(command, self.state.labels.next_label());
        let within = self.time_limit(&request, latency);
        let expected = Expected { reply: None, limits: &LIMITS };
        self.line.is_settled = false;
        self.state.has_stray_frames |= self.line.discard_pending().await? > 0;
        let sent = self.line.transport.send(request.bytes(), &expected, within).await;
        sent.map_err(|failure| record_silence(&self.line.shared, &request, failure))?;
        loop {
            let received = match self.line.transport.next_frame().await {
                Ok(received) => received,
                Err(failure) => {
                    return Err(record_silence(&self.line.shared, &request, failure));
                }
            };
            let (times, wire_len) = (received.times, received.wire_len());
            let mut outcome = Err(None);
            if let FoundFrame::Reply(bytes) = received.frame() {
                let (received_at, stamp) = (times.received, times.stamp);
                let protocol = Protocol::Scip2;
                let reply = || RawReply { protocol, command: None, bytes, received_at, stamp };
                self.line.observers.pass(reply);
                if let Some(frame) = find_own(&request, bytes) {
                    let parsed = Reply::parse(&request, frame).map_err(Some);
                    let is_version = matches!(command, Command::Version);
                    let kept = if is_version { frame.to_vec() } else { Vec::new() };
                    outcome = parsed.map(|reply| (reply, kept, frame.len()));
                }
            }
            drop(received);
            match outcome {
                Ok((Reply { status, content }, frame, length)) => {
                    self.line.is_settled = true;
                    if status.is_ok_for(&command) {
                        let bytes = request.bytes().len() + 1 + length + 2;
                        if let Some(baud_rate) = self.line.believed_baud_rate() {
                            self.line.check_speed(baud_rate.wire_time(bytes), &times);
                        }
                    } else {
                        self.line.shared.counters.stats().refused += 1;
                    }
                    return Ok(Answer { status, content, frame, times });
                }
                Err(Some(error)) => return Err(self.record_malformed(&request, error, wire_len)),
                Err(None) => {
                    self.state.has_stray_frames = true;
                    self.line.shared.counters.stats().bytes_skipped += wire_len;
                }
            }
        }
    }

    /// How long the sensor may take to begin its answer.
    pub(super) fn latency(&self, command: &Command) -> Duration {
        let usual = match command {
            Command::Latest { .. } => Duration::from_millis(500),
            _ => Duration::from_secs(1),
        };
        self.line.reply_latency.unwrap_or(usual)
    }

    /// How long an exchange may take: `latency`, and the time of its bytes on the wire.
    pub(super) fn time_limit(&self, request: &Request, latency: Duration) -> Duration {
        let bytes = request.bytes().len() + 1 + request.reply_len().unwrap_or(TEXT_LEN);
        let wire_time = self.line.believed_baud_rate().map(|baud_rate| baud_rate.wire_time(bytes));
        wire_time.unwrap_or_default() + latency
    }

    #[cold]
    fn record_malformed(
        &self,
        request: &Request,
        error: ReplyError,
        wire_len: u64,
    ) -> ExchangeError {
        let mut stats = self.line.shared.counters.stats();
        stats.malformed.count_scip2(&error);
        stats.bytes_skipped += wire_len;
        drop(stats);
        let error = bad_reply(request, error);
        tracing::trace!(%error, "no answer");
        ExchangeError::Command(error)
    }
}

#[cold]
fn record_silence(shared: &Shared, request: &Request, failure: NoFrame) -> ExchangeError {
    let failure = no_reply(request, failure);
    if let ExchangeError::Command(error) = &failure {
        shared.counters.stats().timeouts += 1;
        tracing::trace!(%error, "no answer");
    }
    failure
}

/// Finds the reply to `request` in a frame. A reply that was cut short has no terminator, so the next
/// one follows it in the same frame.
fn find_own<'a>(request: &Request, frame: &'a [u8]) -> Option<&'a [u8]> {
    let echo = request.bytes();
    if frame.starts_with(echo) {
        return Some(frame);
    }
    let at = frame.windows(echo.len()).rposition(|part| part == echo)?;
    frame.get(at..)
}

/// Returns the answer, or the error of `command` if the sensor refused it.
pub(super) fn accepted(command: &Command, answer: Answer) -> Result<Answer, ExchangeError> {
    if answer.status.is_ok_for(command) {
        return Ok(answer);
    }
    let (request, status) = (Request::new(*command, None), answer.status);
    let error = refused(&request, text(status), status.meaning(command));
    tracing::trace!(%error, "no answer");
    Err(ExchangeError::Command(error))
}

pub(super) fn text(status: Status) -> Text {
    status.characters()[..].into()
}
