//! Finds the sensor's baud rate and its protocol, and changes the baud rate. A status alone proves
//! nothing: the sensor has to answer at the new baud rate.

use std::collections::BTreeSet;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::super::failure::{ExchangeError, LinkError};
use super::Session;
use crate::protocol::MalformedError;
use crate::{BaudRate, ErrorKind};

/// How long the sensor may take to answer in the baud rate search, beside the bytes' time on the wire.
const SEARCH_LATENCY: Duration = Duration::from_millis(400);
/// Time from the reply until the new baud rate applies: one revolution of most sensors, two of some.
const CHANGE_TIME: Duration = Duration::from_millis(200);

impl Session {
    /// Looks for the sensor at each of `baud_rates`, repeatedly until `deadline`. If the port
    /// cannot change its baud rate, tries only the current one. Also finds the protocol: a fence of
    /// SCIP 1.1 harms no sensor, and one of SCIP 2 refuses it in its own way.
    pub(crate) async fn find(
        &mut self,
        baud_rates: &[BaudRate],
        deadline: Instant,
    ) -> Result<(), ExchangeError> {
        self.scip2 = None;
        let before = self.scip1.line.transport.received;
        let (mut malformed, mut refused) = (None, BTreeSet::new());
        while refused.len() < baud_rates.len() {
            for &baud_rate in baud_rates {
                let mut latency = self.scip1.usual_latency();
                if self.baud_rate().is_some() {
                    match self.set_port_baud_rate(baud_rate).await {
                        Ok(()) => {
                            refused.remove(&baud_rate);
                            latency = SEARCH_LATENCY;
                        }
                        Err(error) if error.kind() == io::ErrorKind::Unsupported => {}
                        // The adapter may not support this baud rate.
                        Err(_) => {
                            refused.insert(baud_rate);
                            continue;
                        }
                    }
                }
                // The system may have buffered more bytes than one exchange may skip.
                self.scip1.line.discard_pending().await?;
                match self.scip1.fence_once(latency).await {
                    Ok(_) => return self.begin_in_scip1().await,
                    Err(ExchangeError::Command(ErrorKind::Timeout { .. })) => {}
                    // One malformed answer may be noise. Report it only if no attempt does better.
                    Err(ExchangeError::Command(error @ ErrorKind::Malformed { .. }))
                        if !is_not_raw(&error) =>
                    {
                        malformed = Some(error);
                    }
                    Err(ExchangeError::Command(error @ ErrorKind::WrongProtocol { .. })) => {
                        match self.begin_in_scip2(error).await {
                            // The rest of a stream, which the port has kept, was taken for an answer.
                            Err(ExchangeError::Link(LinkError::Silent(
                                error @ (ErrorKind::Timeout { .. } | ErrorKind::Malformed { .. }),
                            ))) if self.is_searchable() => {
                                (malformed, self.scip2) = (Some(error), None);
                            }
                            outcome => return outcome,
                        }
                    }
                    // Something other than a sensor answers.
                    Err(ExchangeError::Command(error)) => {
                        return Err(LinkError::Silent(error).into());
                    }
                    // A stream that is read at another baud rate may be many LFs.
                    Err(ExchangeError::Link(LinkError::Lost(error)))
                        if self.is_searchable() && is_flood(&error) =>
                    {
                        malformed = Some(error);
                    }
                    Err(lost) => return Err(lost),
                }
                if Instant::now() >= deadline {
                    let silence = ErrorKind::NoAnswer {
                        baud_rate: self.baud_rate().filter(|_| !self.is_searchable()),
                        searched: self.is_searchable(),
                        refused: refused.into_iter().collect(),
                        bytes: self.scip1.line.transport.received - before,
                        words: self.scip1.line.transport.words(),
                    };
                    return Err(LinkError::Silent(malformed.unwrap_or(silence)).into());
                }
            }
        }
        Err(lost(io::Error::other("the port supports none of the six baud rates")))
    }

    /// Moves the sensor and the port to another baud rate. On failure either both are back at
    /// the old baud rate, or the result is a [`LinkError`]: after `Silent` the caller has to search.
    pub(crate) async fn set_baud_rate(&mut self, baud_rate: BaudRate) -> Result<(), ExchangeError> {
        let old = self.baud_rate();
        if old == Some(baud_rate) {
            // The sensor may have restarted unnoticed.
            return self.confirm_baud_rate(baud_rate).await;
        }
        // Try the port first: the sensor must not move to a baud rate that the port lacks.
        if let Err(error) = self.set_port_baud_rate(baud_rate).await {
            let is_adjustable = self.scip1.line.transport.adjustable;
            if let Some(old) = old.filter(|_| is_adjustable) {
                self.set_port_baud_rate(old).await.map_err(lost)?;
            }
            let source = is_adjustable.then(|| Arc::new(error));
            let unsupported = ErrorKind::UnsupportedBaudRate { baud_rate, source };
            return Err(ExchangeError::Command(unsupported));
        }
        let Some(old) = old else {
            return self.send_baud_rate_over_usb(baud_rate).await;
        };
        self.set_port_baud_rate(old).await.map_err(lost)?;
        let status = match self.send_baud_rate(baud_rate).await {
            Ok(status) => Some(status),
            // Without a reply, nothing tells whether the sensor has changed.
            Err(failure) if failure.is_lost_reply() => None,
            Err(error) => return Err(error),
        };
        let is_silent = status.is_none();
        let not_confirmed = self.baud_rate_not_confirmed(baud_rate, status);
        if is_silent && self.scip1.line.shared.is_closing() {
            return Err(LinkError::Silent(not_confirmed).into());
        }
        sleep(CHANGE_TIME).await;
        self.set_port_baud_rate(baud_rate).await.map_err(lost)?;
        if self.answers(3).await? {
            return Ok(());
        }
        self.set_port_baud_rate(old).await.map_err(lost)?;
        if !self.scip1.line.shared.is_closing() && self.answers(3).await? {
            return Err(ExchangeError::Command(not_confirmed));
        }
        Err(LinkError::Silent(not_confirmed).into())
    }

    /// Checks whether the sensor answers one of `tries` commands. Sends only one while closing.
    async fn answers(&mut self, tries: usize) -> Result<bool, ExchangeError> {
        for _ in 0..tries {
            match self.probe_once(SEARCH_LATENCY).await {
                Ok(()) => return Ok(true),
                Err(ExchangeError::Command(_)) if self.scip1.line.shared.is_closing() => break,
                Err(ExchangeError::Command(_)) => {}
                Err(failure) => return Err(failure),
            }
        }
        Ok(false)
    }

    async fn set_port_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        self.scip1.line.is_settled = false;
        self.scip1.line.set_baud_rate(baud_rate).await
    }
}

fn is_not_raw(error: &ErrorKind) -> bool {
    matches!(error, ErrorKind::Malformed { source: MalformedError::NotRaw, .. })
}

fn is_flood(error: &ErrorKind) -> bool {
    let (ErrorKind::Disconnected { source } | ErrorKind::Rejected { source, .. }) = error else {
        return false;
    };
    source.as_ref().is_some_and(|source| source.kind() == io::ErrorKind::InvalidData)
}

fn lost(error: io::Error) -> ExchangeError {
    LinkError::Lost(ErrorKind::disconnected(Some(error))).into()
}
