//! The baud rate: how the sensor is found at the one that it has, and moved to
//! another one. A status alone is no proof: a fence has to be answered at
//! the new baud rate.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::exchange::ExchangeError;
use super::session::Session;
use crate::protocol::{Command, Malformed};
use crate::{BaudRate, Error, Window};

/// The time limit of a fence during the search for the baud rate, without the time
/// that its bytes take on the line.
const SEARCH_LATENCY: Duration = Duration::from_millis(400);
/// After `S` is accepted the new baud rate applies one revolution later; some
/// sensors take two.
const CHANGE_TIME: Duration = Duration::from_millis(200);

/// Looks for the sensor at each of `baud_rates`, over and over until `deadline`;
/// at the one that the port has where it cannot change it.
pub(crate) async fn find(
    session: &mut Session,
    baud_rates: &[BaudRate],
    deadline: Instant,
) -> Result<(), ExchangeError> {
    let before = session.received();
    let mut malformed = None;
    loop {
        let mut usable = false;
        for &baud_rate in baud_rates {
            let mut latency = SEARCH_LATENCY;
            if session.baud_rate().is_some() {
                match session.set_baud_rate(baud_rate) {
                    Ok(()) => {}
                    Err(error) if error.kind() == io::ErrorKind::Unsupported => {
                        latency = session.latency(&Command::Distances(Window::FULL));
                    }
                    // The adapter may not know this one.
                    Err(_) => continue,
                }
            } else {
                latency = session.latency(&Command::Distances(Window::FULL));
            }
            usable = true;
            // The system may hold more than one exchange may bring.
            session.discard_pending().await?;
            match session.fence_once(latency).await {
                Ok(_) => return Ok(()),
                Err(ExchangeError::Command(Error::Timeout { .. })) => {}
                // One malformed answer may be noise; if none is better, it is
                // the cause.
                Err(ExchangeError::Command(error @ Error::Malformed { .. }))
                    if !is_not_raw(&error) =>
                {
                    malformed = Some(error);
                }
                // Something else than a sensor in SCIP 1.1 answers.
                Err(ExchangeError::Command(error)) => return Err(ExchangeError::Silent(error)),
                Err(lost) => return Err(lost),
            }
            if Instant::now() >= deadline {
                let searched = session.is_adjustable() && session.baud_rate().is_some();
                let baud_rate = session.baud_rate().filter(|_| !searched);
                let bytes = session.received() - before;
                let silence = Error::NoAnswer { sensor: None, baud_rate, searched, bytes };
                return Err(ExchangeError::Silent(malformed.unwrap_or(silence)));
            }
        }
        if !usable {
            let text = "the port takes none of the six baud rates";
            let error = io::Error::new(io::ErrorKind::InvalidInput, text);
            return Err(lost(error));
        }
    }
}

/// Moves sensor and port to another baud rate. If that fails both are at the old
/// one again, or the sensor has to be looked for.
pub(crate) async fn change(
    session: &mut Session,
    baud_rate: BaudRate,
) -> Result<(), ExchangeError> {
    let command = Command::BaudRate(baud_rate);
    let old = session.baud_rate();
    if old == Some(baud_rate) {
        // The sensor may have restarted unseen.
        return session.fence().await.map(drop).map_err(|error| error.of(command));
    }
    // The sensor must not go where the port cannot follow.
    if let Err(error) = session.set_baud_rate(baud_rate) {
        let source = session.is_adjustable().then(|| Arc::new(error));
        if let Some(old) = old.filter(|_| session.is_adjustable()) {
            session.set_baud_rate(old).map_err(lost)?;
        }
        return Err(ExchangeError::Command(Error::UnsupportedBaudRate { baud_rate, source }));
    }
    let Some(old) = old else {
        // USB: accepted without effect (C-42-3320-A p. 5).
        return session.command_twice(command, &mut |_| ()).await.map(drop);
    };
    session.set_baud_rate(old).map_err(lost)?;
    let status = match session.command(command, &mut |_| ()).await {
        Ok(status) => Some(status),
        // Without a reply the sensor may or may not have changed.
        Err(ExchangeError::Command(Error::Timeout { .. } | Error::Malformed { .. })) => None,
        Err(error) => return Err(error),
    };
    sleep(CHANGE_TIME).await;
    session.set_baud_rate(baud_rate).map_err(lost)?;
    if answers(session, 3).await? {
        return Ok(());
    }
    session.set_baud_rate(old).map_err(lost)?;
    let not_confirmed = Error::NotConfirmed { command, status, refusal: None };
    if answers(session, 3).await? {
        return Err(ExchangeError::Command(not_confirmed));
    }
    Err(ExchangeError::Silent(not_confirmed))
}

/// Returns whether the sensor answers one of `tries` fences.
async fn answers(session: &mut Session, tries: usize) -> Result<bool, ExchangeError> {
    for _ in 0..tries {
        match session.fence_once(SEARCH_LATENCY).await {
            Ok(_) => return Ok(true),
            Err(ExchangeError::Command(_)) => {}
            Err(failure) => return Err(failure),
        }
    }
    Ok(false)
}

fn is_not_raw(error: &Error) -> bool {
    matches!(error, Error::Malformed { source: Malformed::NotRaw, .. })
}

fn lost(error: io::Error) -> ExchangeError {
    ExchangeError::Lost(Error::disconnected(Some(error)))
}
