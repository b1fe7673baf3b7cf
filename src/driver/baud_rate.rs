//! Finds the sensor's baud rate and changes it. A status alone proves nothing: the sensor
//! has to answer a fence at the new baud rate.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::failure::{ExchangeError, LinkError};
use super::session::Session;
use crate::protocol::{Command, MalformedError};
use crate::{BaudRate, ErrorKind, Window};

/// Time limit of a fence during the baud rate search, in addition to the wire time of its
/// bytes.
const SEARCH_LATENCY: Duration = Duration::from_millis(400);
/// Time from the reply to `S` until the new baud rate applies. Most sensors take one
/// revolution, some take two.
const CHANGE_TIME: Duration = Duration::from_millis(200);

/// Looks for the sensor at each of `baud_rates`, repeatedly until `deadline`. If the port
/// cannot change its baud rate, tries only the current one.
pub(crate) async fn find(
    session: &mut Session,
    baud_rates: &[BaudRate],
    deadline: Instant,
) -> Result<(), ExchangeError> {
    let before = session.transport.received();
    let mut malformed = None;
    loop {
        let mut usable = false;
        for &baud_rate in baud_rates {
            let mut latency = SEARCH_LATENCY;
            if session.transport.baud_rate().is_some() {
                match session.set_baud_rate(baud_rate).await {
                    Ok(()) => {}
                    Err(error) if error.kind() == io::ErrorKind::Unsupported => {
                        latency = session.transport.latency(&Command::Distances(Window::FULL));
                    }
                    // The adapter may not support this baud rate.
                    Err(_) => continue,
                }
            } else {
                latency = session.transport.latency(&Command::Distances(Window::FULL));
            }
            usable = true;
            // The system may have buffered more bytes than the flood limit of one
            // exchange allows.
            session.discard_pending().await?;
            match session.fence_once(latency).await {
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
                Err(ExchangeError::Command(error)) => return Err(LinkError::Silent(error).into()),
                Err(lost) => return Err(lost),
            }
            if Instant::now() >= deadline {
                let searched =
                    session.transport.is_adjustable() && session.transport.baud_rate().is_some();
                let baud_rate = session.transport.baud_rate().filter(|_| !searched);
                let bytes = session.transport.received() - before;
                let words = session.transport.words();
                let silence = ErrorKind::NoAnswer { baud_rate, searched, bytes, words };
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
pub(crate) async fn change(
    session: &mut Session,
    baud_rate: BaudRate,
) -> Result<(), ExchangeError> {
    let command = Command::BaudRate(baud_rate);
    let old = session.transport.baud_rate();
    if old == Some(baud_rate) {
        // The sensor may have restarted unnoticed.
        return session.fence().await.map(drop).map_err(|error| error.on_behalf_of(command));
    }
    // Try the port first: the sensor must not move to a baud rate that the port lacks.
    if let Err(error) = session.set_baud_rate(baud_rate).await {
        let source = session.transport.is_adjustable().then(|| Arc::new(error));
        if let Some(old) = old.filter(|_| session.transport.is_adjustable()) {
            session.set_baud_rate(old).await.map_err(lost)?;
        }
        return Err(ExchangeError::Command(ErrorKind::UnsupportedBaudRate { baud_rate, source }));
    }
    let Some(old) = old else {
        // Over USB the sensor accepts `S` without effect (C-42-3320-A p. 5).
        return session.command_twice(command).await.map(drop);
    };
    session.set_baud_rate(old).await.map_err(lost)?;
    let status = match session.command(command).await {
        Ok(reply) => Some(reply.status()),
        // Without a reply, nothing tells whether the sensor has changed.
        Err(ExchangeError::Command(ErrorKind::Timeout { .. } | ErrorKind::Malformed { .. })) => {
            None
        }
        Err(error) => return Err(error),
    };
    let not_confirmed = ErrorKind::NotConfirmed { command, status, refusal: None };
    if status.is_none() && session.is_closing() {
        return Err(LinkError::Silent(not_confirmed).into());
    }
    sleep(CHANGE_TIME).await;
    session.set_baud_rate(baud_rate).await.map_err(lost)?;
    if answers(session, 3).await? {
        return Ok(());
    }
    session.set_baud_rate(old).await.map_err(lost)?;
    if !session.is_closing() && answers(session, 3).await? {
        return Err(ExchangeError::Command(not_confirmed));
    }
    Err(LinkError::Silent(not_confirmed).into())
}

/// Checks whether the sensor answers one of `tries` fences. Sends only one while the
/// driver is closing.
async fn answers(session: &mut Session, tries: usize) -> Result<bool, ExchangeError> {
    for _ in 0..tries {
        match session.fence_once(SEARCH_LATENCY).await {
            Ok(_) => return Ok(true),
            Err(ExchangeError::Command(_)) if session.is_closing() => break,
            Err(ExchangeError::Command(_)) => {}
            Err(failure) => return Err(failure),
        }
    }
    Ok(false)
}

fn is_not_raw(error: &ErrorKind) -> bool {
    matches!(error, ErrorKind::Malformed { source: MalformedError::NotRaw, .. })
}

fn lost(error: io::Error) -> ExchangeError {
    LinkError::Lost(ErrorKind::disconnected(Some(error))).into()
}
