//! [`Laser`]: switches the laser as wished and confirms it, and switches it on again if
//! something else switched it off. Never trusts a status alone.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use super::backoff::Backoff;
use super::failure::ExchangeError;
use super::session::Session;
use crate::protocol::{Command, Status};
use crate::state::Telemetry;
use crate::{ErrorChain, ErrorKind, Window};

/// Shortest and longest delay between attempts to switch a laser that stays as it is.
const RETRY: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(30));

/// Laser of the sensor: what is known of it, and when to try again what the sensor refused.
pub(crate) struct Laser {
    /// True if the sensor has confirmed that its laser is off, as the service wished. Nothing is
    /// polled then.
    is_off: bool,
    /// When to switch it as wished again, because it did not follow the last time.
    retry_at: Option<Instant>,
    backoff: Backoff,
    /// True if the log has told that the laser is not as wished.
    is_reported: bool,
    /// Windows that the sensor refuses to measure.
    refused: Vec<RefusedWindow>,
    seed: u64,
    telemetry: Arc<Telemetry>,
}

/// Window that the sensor refuses to measure. Another window may be fine: each backs off for
/// itself.
struct RefusedWindow {
    window: Window,
    backoff: Backoff,
    /// `Some`: the laser stays off. `None`: the sensor refuses the window although its laser is
    /// on.
    error: Option<ErrorKind>,
    retry_at: Instant,
}

impl Laser {
    pub(crate) fn new(seed: u64, telemetry: Arc<Telemetry>) -> Self {
        Self {
            is_off: false,
            retry_at: None,
            backoff: Backoff::new(RETRY, seed),
            is_reported: false,
            refused: Vec::new(),
            seed,
            telemetry,
        }
    }

    /// Returns true if the laser is off, as wished and confirmed.
    pub(crate) fn is_off(&self) -> bool {
        self.is_off
    }

    /// When [`retry`](Self::retry) is due, if the laser did not follow a wish.
    pub(crate) fn retry_at(&self) -> Option<Instant> {
        self.retry_at
    }

    /// Returns true if the laser should be switched as wished now.
    pub(crate) fn is_due(&self, wish: Option<bool>) -> bool {
        match self.retry_at {
            Some(retry_at) => wish.is_some() && retry_at <= Instant::now(),
            // The wish is younger than the session.
            None => wish == Some(self.is_off),
        }
    }

    /// Switches the laser as wished, and confirms it.
    pub(crate) async fn switch(
        &mut self,
        session: &mut Session,
        on: bool,
    ) -> Result<(), ExchangeError> {
        let outcome = set_laser(session, on).await;
        match &outcome {
            Ok(()) => {
                self.set_off(!on);
                self.retry_at = None;
                self.backoff.restart();
                self.is_reported = false;
            }
            Err(ExchangeError::Command(_)) => {
                self.set_off(false);
                self.retry_at = Some(Instant::now() + self.backoff.next());
            }
            // The next session switches it.
            Err(ExchangeError::Link(_)) => {}
        }
        outcome
    }

    /// Switches the laser as wished, without a caller who would learn that it does not follow.
    pub(crate) async fn retry(
        &mut self,
        session: &mut Session,
        on: bool,
    ) -> Result<(), ExchangeError> {
        match self.switch(session, on).await {
            Err(ExchangeError::Command(error)) => {
                if !std::mem::replace(&mut self.is_reported, true) {
                    let error = ErrorChain(&error);
                    tracing::warn!(%error, "the laser is not as it was set: trying again");
                }
                Ok(())
            }
            outcome => outcome,
        }
    }

    /// Switches the laser of a sensor that was just found.
    pub(crate) async fn restore(
        &mut self,
        session: &mut Session,
        wish: Option<bool>,
    ) -> Result<(), ExchangeError> {
        self.refused.clear();
        match wish {
            Some(on) => self.retry(session, on).await,
            None => Ok(()),
        }
    }

    fn set_off(&mut self, is_off: bool) {
        self.is_off = is_off;
        self.telemetry.set_laser_off(is_off);
    }

    /// Records that the sensor measured `window`.
    pub(crate) fn record_scan(&mut self, window: Window) {
        self.refused.retain(|refused| refused.window != window);
    }

    /// Switches the laser on after the sensor refused a poll. Ignores which status it
    /// refused with: sources disagree on the status of a `G` while the laser is off.
    ///
    /// # Errors
    ///
    /// [`ErrorKind::NotConfirmed`] with both statuses if the laser stays off. Until the next
    /// attempt for this window is due, returns the last error, or `refusal` if the laser was on.
    pub(crate) async fn switch_on(
        &mut self,
        session: &mut Session,
        window: Window,
        refusal: Refusal,
    ) -> Result<(), ExchangeError> {
        if let Some(refused) = self.refused.iter().find(|refused| refused.window == window)
            && Instant::now() < refused.retry_at
        {
            let error = refused.error.clone().unwrap_or_else(|| refusal.into());
            return Err(ExchangeError::Command(error));
        }
        let outcome = set_laser(session, true).await;
        match &outcome {
            Ok(()) => self.retry_at = None,
            Err(ExchangeError::Command(error)) => self.record_refusal(window, Some(error.clone())),
            // The laser's state is unknown.
            Err(ExchangeError::Link(_)) => {}
        }
        outcome
    }

    /// Records that the sensor refuses to measure `window`: because of `error`, or although its
    /// laser is on.
    pub(crate) fn record_refusal(&mut self, window: Window, error: Option<ErrorKind>) {
        let now = Instant::now();
        let (longest, known) = (RETRY.1, |refused: &RefusedWindow| refused.window == window);
        // Nobody has asked for these for a while.
        self.refused.retain(|refused| known(refused) || now < refused.retry_at + longest);
        let mut refused = match self.refused.iter().position(known) {
            Some(place) => self.refused.swap_remove(place),
            None => {
                let backoff = Backoff::new(RETRY, self.seed);
                RefusedWindow { window, backoff, error: None, retry_at: now }
            }
        };
        (refused.error, refused.retry_at) = (error, now + refused.backoff.next());
        self.refused.push(refused);
    }
}

/// Switches the laser, and confirms it with a fence: the sensor refuses a `G` if and only
/// if the laser is off.
///
/// # Errors
///
/// [`ErrorKind::NotConfirmed`] if it stays as it is. [`ErrorKind::Refused`] if the sensor refuses
/// both `L0` and to measure: then nothing tells whether the laser is off.
async fn set_laser(session: &mut Session, on: bool) -> Result<(), ExchangeError> {
    let command = if on { Command::LaserOn } else { Command::LaserOff };
    let mut tries = 2;
    loop {
        tries -= 1;
        let status = match session.command_twice(command).await {
            Ok(reply) => Some(reply.status()),
            Err(ExchangeError::Command(ErrorKind::Refused { status, .. })) => Some(status),
            Err(ExchangeError::Command(_)) => None,
            Err(lost) => return Err(lost),
        };
        // The caller asked for `command` and knows nothing of fences.
        let measured = session.fence().await.map_err(|error| error.on_behalf_of(command))?;
        let refused = status.filter(|status| !status.is_ok_for(&command));
        if measured.is_ok() == on {
            match (status, refused) {
                // One refused `G` without an answer to `L0` proves little: its status may have
                // been another one. A driver that is closing has no time to ask again.
                (None, _) if !on && tries > 0 && !session.is_closing() => continue,
                (_, Some(status)) if !on => {
                    return Err(ExchangeError::Command(ErrorKind::Refused { command, status }));
                }
                _ => return Ok(()),
            }
        }
        // Only a status that means success may have been another one.
        if tries == 0 || refused.is_some() || status.is_none() {
            let refusal = Some(measured).filter(|_| on);
            return Err(ExchangeError::Command(ErrorKind::NotConfirmed {
                command,
                status,
                refusal,
            }));
        }
    }
}

/// A `G` that the sensor refused.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Refusal {
    pub(crate) command: Command,
    pub(crate) status: Status,
}

impl From<Refusal> for ErrorKind {
    fn from(Refusal { command, status }: Refusal) -> Self {
        Self::Refused { command, status }
    }
}
