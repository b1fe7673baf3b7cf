//! Finds the sensor's baud rate and changes it. A status alone proves nothing: the sensor
//! has to answer a fence at the new baud rate.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::super::super::failure::{ExchangeError, LinkError};
use super::errors::{not_confirmed, on_behalf_of};
use super::exchange::accepted;
use super::{ANY_SCAN, Session};
use crate::protocol::{Command, MalformedError};
use crate::{BaudRate, ErrorKind};

/// Time limit of a fence during the baud rate search, in addition to the wire time of its
/// bytes.
const SEARCH_LATENCY: Duration = Duration::from_millis(400);
/// Time from the reply to `S` until the new baud rate applies. Most sensors take one
/// revolution, some take two.
const CHANGE_TIME: Duration = Duration::from_millis(200);

impl Session {
    /// Looks for the sensor at each of `baud_rates`, repeatedly until `deadline`. If the port
    /// cannot change its baud rate, tries only the current one.
    pub(crate) async fn find(
        &mut self,
        baud_rates: &[BaudRate],
        deadline: Instant,
    ) -> Result<(), ExchangeError> {
        let before = self.transport.received();
        let mut malformed = None;
        loop {
            let mut usable = false;
            for &baud_rate in baud_rates {
                let mut latency = self.latency(&ANY_SCAN);
                if self.baud_rate().is_some() {
                    match self.set_port_baud_rate(baud_rate).await {
                        Ok(()) => latency = SEARCH_LATENCY,
                        Err(error) if error.kind() == io::ErrorKind::Unsupported => {}
                        // The adapter may not support this baud rate.
                        Err(_) => continue,
                    }
                }
                usable = true;
                // The system may have buffered more bytes than the flood limit of one
                // exchange allows.
                self.discard_pending().await?;
                match self.fence_once(latency).await {
                    Ok(_) => return Ok(()),
                    Err(ExchangeError::Command(ErrorKind::Timeout { .. })) => {}
                    // One malformed answer may be noise. Report it only if no attempt does
                    // better.
                    Err(ExchangeError::Command(error @ ErrorKind::Malformed { .. }))
                        if !is_not_raw(&error) =>
                    {
                        malformed = Some(error);
                    }
                    // Something other than a SCIP 1.1 sensor answers.
                    Err(ExchangeError::Command(error)) => {
                        return Err(LinkError::Silent(self.name_model(error).await).into());
                    }
                    Err(lost) => return Err(lost),
                }
                if Instant::now() >= deadline {
                    let silence = ErrorKind::NoAnswer {
                        baud_rate: self.baud_rate().filter(|_| !self.is_searchable()),
                        searched: self.is_searchable(),
                        bytes: self.transport.received() - before,
                        words: self.transport.words(),
                    };
                    return Err(LinkError::Silent(malformed.unwrap_or(silence)).into());
                }
            }
            if !usable {
                let text = "the port supports none of the six baud rates";
                let error = io::Error::new(io::ErrorKind::InvalidInput, text);
                return Err(lost(error));
            }
        }
    }

    /// Moves the sensor and the port to another baud rate. On failure either both are back at
    /// the old baud rate, or the result is a [`LinkError`]: after `Silent` the caller has to search.
    pub(crate) async fn set_baud_rate(&mut self, baud_rate: BaudRate) -> Result<(), ExchangeError> {
        let command = Command::BaudRate(baud_rate);
        let old = self.baud_rate();
        if old == Some(baud_rate) {
            // The sensor may have restarted unnoticed.
            return self.fence().await.map(drop).map_err(on_behalf_of(command));
        }
        // Try the port first: the sensor must not move to a baud rate that the port lacks.
        if let Err(error) = self.set_port_baud_rate(baud_rate).await {
            let is_adjustable = self.transport.is_adjustable();
            if let Some(old) = old.filter(|_| is_adjustable) {
                self.set_port_baud_rate(old).await.map_err(lost)?;
            }
            let source = is_adjustable.then(|| Arc::new(error));
            return Err(ExchangeError::Command(ErrorKind::UnsupportedBaudRate {
                baud_rate,
                source,
            }));
        }
        let Some(old) = old else {
            // Over USB the sensor accepts `S` without effect (C-42-3320-A p. 5).
            return accepted(&command, self.command_twice(command).await?).map(drop);
        };
        self.set_port_baud_rate(old).await.map_err(lost)?;
        let status = match self.command(command).await {
            Ok(answer) => Some(accepted(&command, answer)?.reply.status()),
            // Without a reply, nothing tells whether the sensor has changed.
            Err(ExchangeError::Command(
                ErrorKind::Timeout { .. } | ErrorKind::Malformed { .. },
            )) => None,
            Err(error) => return Err(error),
        };
        let not_confirmed = not_confirmed(&command, status, None);
        if status.is_none() && self.is_closing() {
            return Err(LinkError::Silent(not_confirmed).into());
        }
        sleep(CHANGE_TIME).await;
        self.set_port_baud_rate(baud_rate).await.map_err(lost)?;
        if self.answers(3).await? {
            return Ok(());
        }
        self.set_port_baud_rate(old).await.map_err(lost)?;
        if !self.is_closing() && self.answers(3).await? {
            return Err(ExchangeError::Command(not_confirmed));
        }
        Err(LinkError::Silent(not_confirmed).into())
    }

    /// Checks whether the sensor answers one of `tries` fences. Sends only one while the
    /// driver is closing.
    async fn answers(&mut self, tries: usize) -> Result<bool, ExchangeError> {
        for _ in 0..tries {
            match self.fence_once(SEARCH_LATENCY).await {
                Ok(_) => return Ok(true),
                Err(ExchangeError::Command(_)) if self.is_closing() => break,
                Err(ExchangeError::Command(_)) => {}
                Err(failure) => return Err(failure),
            }
        }
        Ok(false)
    }
}

fn is_not_raw(error: &ErrorKind) -> bool {
    matches!(error, ErrorKind::Malformed { source: MalformedError::NotRaw, .. })
}

fn lost(error: io::Error) -> ExchangeError {
    LinkError::Lost(ErrorKind::disconnected(Some(error))).into()
}
