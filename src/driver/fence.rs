//! The fence: what proves that no older reply is on its way.
//!
//! A single-step `G`, a different one each time, is sent until it is answered.
//! Replies come in order, and even an invalid command is echoed, so nothing
//! older can follow that answer.

use std::time::Duration;

use bytes::{BufMut, BytesMut};
use tokio::time::Instant;
use tracing::Instrument;

use super::intake::Item;
use super::line::flood;
use super::session::{Failure, MAX_FRAMES, Session};
use crate::codec::Frame;
use crate::protocol::{Command, Malformed, Reply, ReplyError, Status};
use crate::{Error, Window};

/// Fences sent before a line counts as lost; and fewer where the sensor may be
/// found at another speed, to which it goes when it restarts.
const FENCES: usize = 6;
const FENCES_AT_A_SPEED: usize = 3;

impl Session {
    /// Sends single-step `G`s until the latest of them is answered, and gives
    /// the status of that answer.
    pub(crate) async fn fence(&mut self) -> Result<Status, Failure> {
        let mut failure = Failure::Silent(Error::disconnected(None));
        let adjustable = self.is_adjustable() && self.baud_rate().is_some();
        for _ in 0..if adjustable { FENCES_AT_A_SPEED } else { FENCES } {
            match self.fence_once(self.latency(&Command::Distances(Window::single(0)))).await {
                Err(Failure::Command(error)) => failure = Failure::Silent(error),
                outcome => return outcome,
            }
        }
        Err(failure)
    }

    /// One fence, answered within `latency`.
    pub(crate) async fn fence_once(&mut self, latency: Duration) -> Result<Status, Failure> {
        let command = Command::Distances(self.unique_requests.fence());
        self.dirty = true;
        self.telemetry.stats().fences += 1;
        let deadline = self.deadline(&command, latency);
        let span = tracing::trace_span!("fence", %command);
        let answer = self.exchange_fence(&command, deadline).instrument(span).await;
        match &answer {
            Ok(_) => {
                self.dirty = false;
                self.unique_requests.clear();
            }
            Err(Failure::Command(Error::Timeout { .. } | Error::Malformed { .. })) => {
                self.telemetry.stats().fence_timeouts += 1;
            }
            Err(_) => {}
        }
        answer
    }

    /// Sends a fence and waits for its answer, whatever comes before.
    async fn exchange_fence(
        &mut self,
        command: &Command,
        deadline: Instant,
    ) -> Result<Status, Failure> {
        let after = deadline - Instant::now();
        let mut sent = BytesMut::with_capacity(16);
        if self.interrupted {
            // Ends a command that the sensor may have in part.
            sent.put_u8(b'\n');
        }
        sent.extend_from_slice(&command.bytes());
        sent.put_u8(b'\n');
        let mut failure = Failure::Command(Error::Timeout { command: *command, after });
        if !self.send(command, deadline).await? {
            return Err(failure);
        }
        for _ in 0..MAX_FRAMES {
            let Some(item) = self.receive(deadline).await? else {
                return Err(self.explain_silence(&sent, command).unwrap_or(failure));
            };
            let frame = match item {
                Item::Scan => return Ok(Status::OK),
                Item::Frame(frame) => frame,
            };
            if let Frame::Reply(bytes) = &frame {
                self.framed.get_ref().hear(None, bytes);
                match Reply::parse_end(command, bytes) {
                    Ok(_) if is_echoed(&sent, command, bytes) => {
                        return Err(Failure::Line(Error::Loopback));
                    }
                    Ok(reply) => return Ok(reply.status()),
                    Err(ReplyError::Scip2 { status }) => {
                        return Err(Failure::Command(Error::WrongProtocol { status }));
                    }
                    Err(error) => {
                        self.telemetry.stats().malformed.count(&error);
                        if let ReplyError::Malformed(source) = error {
                            let command = *command;
                            failure = Failure::Command(Error::Malformed { command, source });
                        }
                    }
                }
            }
            self.skip(&frame);
        }
        Err(flood().into())
    }

    /// What the unfinished frame tells when nothing else came in answer to
    /// `sent`.
    fn explain_silence(&self, sent: &[u8], command: &Command) -> Option<Failure> {
        let pending = self.framed.read_buffer();
        if pending.starts_with(b"\n") && *pending == sent {
            return Some(Failure::Line(Error::Loopback));
        }
        // At a wrong speed any bytes may come, so only a line that cannot have
        // one counts as telnet.
        let telnet = !self.is_adjustable() && self.framed.get_ref().began_as_telnet();
        let echo = [&command.bytes(), &b"\r\n"[..]].concat();
        let translated = pending.windows(echo.len()).any(|part| part == echo);
        (telnet || translated).then(|| {
            let (command, source) = (*command, Malformed::NotRaw);
            Failure::Command(Error::Malformed { command, source })
        })
    }
}

/// Whether `frame` is what was sent, and then a reply to it.
fn is_echoed(sent: &[u8], command: &Command, frame: &[u8]) -> bool {
    frame.strip_prefix(sent).is_some_and(|rest| rest.starts_with(&command.bytes()))
}
