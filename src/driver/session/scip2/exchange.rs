//! Sends a request, judges the frame that answers it, and drops others but the scans of a stream.

use std::time::Duration;

use super::super::super::failure::ExchangeError;
use super::super::super::transport::{Expected, NoFrame, ReplyTimes};
use super::super::errors::{record_malformed, record_silence, refused};
use super::{LIMITS, Scip2};
use crate::codec::Frame;
use crate::protocol::scip2::{Command, Content, Reply, Request, Status};
use crate::protocol::{Protocol, ReplyError, Text};
use crate::state::KnownFrame;
use crate::{BaudRate, ErrorKind, RawReply};

/// Length of the longest replies without scans: `VV`, `PP` and `II`.
const TEXT_LEN: usize = 512;

/// Reply to a request.
#[derive(Debug)]
pub(super) struct Answer {
    pub(super) request: Request,
    pub(super) status: Status,
    pub(super) content: Content,
    /// Bytes of the reply, if it is one to `VV` or `PP`.
    pub(super) frame: Vec<u8>,
    pub(super) times: ReplyTimes,
}

impl Answer {
    /// The reply as received, if it is one to `VV` or `PP`.
    pub(super) fn known_frame(&self) -> KnownFrame {
        KnownFrame {
            request: Some(self.request),
            bytes: self.frame.as_slice().into(),
            received_at: self.times.received,
            stamp: self.times.stamp,
        }
    }
}

impl Scip2<'_> {
    /// Sends `command` and returns its reply, whatever its status. Ends the stream first: what a
    /// command does to one depends on the model.
    pub(super) async fn exchange(&mut self, command: Command) -> Result<Answer, ExchangeError> {
        self.exchange_within(self.latency(&command), command, false).await
    }

    /// As [`exchange`](Self::exchange), with another latency. To a probe a refusal is an answer like any
    /// other, and observers do not take its reply for a scan.
    pub(super) async fn exchange_within(
        &mut self,
        latency: Duration,
        command: Command,
        is_probe: bool,
    ) -> Result<Answer, ExchangeError> {
        if self.state.is_streaming() && command != Command::LaserOff {
            self.end_stream().await?;
        }
        let outcome = self.ask_within(latency, command, is_probe).await;
        // If the stream still runs, its next scan has a deadline of its own.
        self.expect_scan();
        outcome
    }

    /// Sends `command`, even during a stream, and returns its reply. A damaged reply fails: waiting for
    /// a better one would cost the whole deadline.
    pub(super) async fn ask(&mut self, command: Command) -> Result<Answer, ExchangeError> {
        self.ask_within(self.latency(&command), command, false).await
    }

    async fn ask_within(
        &mut self,
        latency: Duration,
        command: Command,
        is_probe: bool,
    ) -> Result<Answer, ExchangeError> {
        let request = &Request::new(command, self.state.next_label());
        let within = self.time_limit(request, latency);
        let baud_rate = self.line.transport.believed_baud_rate();
        let expected = Expected { reply: None, limits: &LIMITS };
        self.line.is_settled = false;
        if !self.state.is_streaming() {
            self.state.has_stray_frames |= self.line.discard_pending().await? > 0;
        }
        let sent = self.line.transport.send(request.bytes(), &expected, within).await;
        sent.map_err(|failure| record_silence(&self.line.shared, &command, failure))?;
        let mut unlabelled = None;
        loop {
            let received = self.line.transport.next_frame().await;
            let received = received.map_err(|failure| match (failure, unlabelled.take()) {
                (NoFrame::Late { .. }, Some(error)) => {
                    // It may be an older reply, but in this session none had a label.
                    self.state.has_labels.get_or_insert(false);
                    record_malformed(&self.line.shared, &command, error, 0)
                }
                (failure, _) => record_silence(&self.line.shared, &command, failure),
            })?;
            let own = match received.frame() {
                Frame::Reply(all) => {
                    find_own(request, all, &received.times, baud_rate).map(|own| (all, own))
                }
                Frame::Overlong { .. } => None,
            };
            let Some((all, (bytes, times))) = own else {
                let (observers, shared) = (&self.line.observers, &self.line.shared);
                self.state.take_unasked(&received, baud_rate, observers, shared);
                if let Frame::Reply(frame) = received.frame() {
                    unlabelled = without_label(request, frame).or(unlabelled);
                }
                continue;
            };
            let answered = (!is_probe).then_some((*request, times));
            self.line.observers.pass(|| raw_reply(all, answered, received.times));
            self.state.has_labels.get_or_insert(true);
            let (reply, wire_len) = (Reply::parse(request, bytes), received.wire_len());
            let is_identity = matches!(command, Command::Version | Command::Parameters);
            let frame = if is_identity { bytes.to_vec() } else { Vec::new() };
            let bytes = request.bytes().len() + 1 + bytes.len() + 2;
            drop(received);
            let Reply { status, content } = reply
                .map_err(|error| record_malformed(&self.line.shared, &command, error, wire_len))?;
            self.line.is_settled = true;
            if command == Command::LaserOff {
                // Whatever it answers: it may be unable to stop now.
                self.state.stopped();
            }
            let is_ok = status.is_ok_for(&command);
            if let Some(baud_rate) = baud_rate.filter(|_| is_ok) {
                self.line.check_speed(baud_rate.wire_time(bytes), &times);
            }
            if !is_ok && !is_probe {
                self.line.shared.counters.lock().stats.refused += 1;
            }
            return Ok(Answer { request: *request, status, content, frame, times });
        }
    }

    /// How long the sensor may take to begin its answer.
    pub(super) fn latency(&self, command: &Command) -> Duration {
        let usual = match command {
            Command::Latest { .. } => Duration::from_millis(500),
            // A caller waits for the driver's end.
            Command::LaserOff if self.line.shared.is_closing() => Duration::from_millis(500),
            // The second must follow within a second.
            Command::Reboot => Duration::from_millis(400),
            _ => Duration::from_secs(1),
        };
        self.line.reply_latency.unwrap_or(usual)
    }

    /// How long an exchange may take: `latency`, and the time of its bytes on the wire.
    pub(super) fn time_limit(&self, request: &Request, latency: Duration) -> Duration {
        let bytes = request.bytes().len() + 1 + request.reply_len().unwrap_or(TEXT_LEN);
        let bytes = bytes + self.state.bytes_on_the_way();
        let transport = &self.line.transport;
        let baud_rate = transport.believed_baud_rate().or_else(|| transport.measured_baud_rate());
        baud_rate.map_or(latency, |baud_rate| baud_rate.wire_time(bytes) + latency)
    }
}

/// Returns true if a frame begins like the scans of a stream, and unlike a late reply.
pub(super) fn is_like_a_stream(frame: &[u8]) -> bool {
    matches!(frame.first(), Some(b'M' | b'N'))
}

/// Error of a frame that answers a request, but does not repeat its label.
pub(super) fn without_label(request: &Request, frame: &[u8]) -> Option<ReplyError> {
    Reply::parse(request, frame).err().filter(|error| matches!(error, ReplyError::Malformed(_)))
}

pub(super) fn raw_reply<'a>(
    bytes: &'a [u8],
    answered: Option<(Request, ReplyTimes)>,
    times: ReplyTimes,
) -> RawReply<'a> {
    let (request, own) = answered.unzip();
    let ReplyTimes { received: received_at, stamp, .. } = own.unwrap_or(times);
    RawReply { protocol: Protocol::Scip2, command: None, request, bytes, received_at, stamp }
}

/// Finds the reply to `request` in a frame, and its times. A reply that was cut short has no
/// terminator, so the next one follows it in the same frame. It began as long ago as its bytes take.
pub(super) fn find_own<'a>(
    request: &Request,
    frame: &'a [u8],
    times: &ReplyTimes,
    baud_rate: Option<BaudRate>,
) -> Option<(&'a [u8], ReplyTimes)> {
    let echo = request.bytes();
    if !echo.contains(&b';') {
        // Too short to be found within a frame.
        let is_own = frame.strip_prefix(echo).is_some_and(|rest| rest.starts_with(b"\n"));
        return is_own.then_some((frame, *times));
    }
    // All replies to a stream begin alike.
    let is_alone = request.reply_len().is_none_or(|len| frame.len() < len);
    if is_alone && frame.starts_with(echo) {
        return Some((frame, *times));
    }
    let at = frame.windows(echo.len()).rposition(|part| part == echo)?;
    let own = frame.get(at..)?;
    let wire_time = baud_rate.map_or(Duration::ZERO, |baud_rate| baud_rate.wire_time(own.len()));
    let later = times.received.duration_since(times.began).saturating_sub(wire_time);
    let (began, stamp) = (times.began + later, times.stamp + later);
    Some((own, ReplyTimes { began, stamp, ..*times }))
}

/// Returns the answer, or the error of its command if the sensor refused it.
pub(super) fn accepted(answer: Answer) -> Result<Answer, ExchangeError> {
    let command = answer.request.command();
    if answer.status.is_ok_for(command) {
        return Ok(answer);
    }
    Err(ExchangeError::Command(refusal(command, answer.status)))
}

/// Error of a command that the sensor refused.
pub(super) fn refusal(command: &Command, status: Status) -> ErrorKind {
    refused(command, text(status), status.meaning(command))
}

pub(super) fn text(status: Status) -> Text {
    status.characters()[..].into()
}
