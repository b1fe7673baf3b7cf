//! [`Laser`]: switches the laser as the service asks, and on again if something else switched it off.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use super::backoff::Backoff;
use super::failure::ExchangeError;
use super::session::Session;
use crate::state::Shared;
use crate::{ErrorChain, ErrorKind, Window};

/// Shortest and longest delay between attempts to switch a laser that stays as it is.
const RETRY: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(30));

/// Laser of the sensor: what is known of it, and when to try again what the sensor refused.
pub(crate) struct Laser {
    /// True if the sensor has confirmed that its laser is off, as asked. Nothing is polled then.
    pub(crate) is_off: bool,
    /// When to switch it again, because it did not follow the last time.
    pub(crate) retry_at: Option<Instant>,
    backoff: Backoff,
    /// True if the log has told that the laser is not as it was set.
    is_reported: bool,
    /// Windows that the sensor refuses to measure.
    refused: Vec<RefusedWindow>,
    shared: Arc<Shared>,
}

/// Window that the sensor refuses to measure. Another window may be fine: each backs off for itself.
struct RefusedWindow {
    window: Window,
    backoff: Backoff,
    /// `Some`: the laser stays off. `None`: the sensor refuses the window although its laser is on.
    error: Option<ErrorKind>,
    retry_at: Instant,
}

impl Laser {
    pub(crate) fn new(shared: Arc<Shared>) -> Self {
        Self {
            is_off: false,
            retry_at: None,
            backoff: Backoff::new(RETRY),
            is_reported: false,
            refused: Vec::new(),
            shared,
        }
    }

    /// Returns true if the laser should be switched now.
    pub(crate) fn is_due(&self, desired: Option<bool>) -> bool {
        match self.retry_at {
            Some(retry_at) => desired.is_some() && retry_at <= Instant::now(),
            // The setting is younger than the session.
            None => desired == Some(self.is_off),
        }
    }

    pub(crate) async fn switch(
        &mut self,
        session: &mut Session,
        on: bool,
    ) -> Result<(), ExchangeError> {
        let outcome = session.set_laser(on).await;
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

    /// Switches the laser without a caller who would learn that it does not follow.
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
        desired: Option<bool>,
    ) -> Result<(), ExchangeError> {
        self.refused.clear();
        match desired {
            Some(on) => self.retry(session, on).await,
            None => Ok(()),
        }
    }

    fn set_off(&mut self, is_off: bool) {
        self.is_off = is_off;
        self.shared.counters.lock().is_laser_off = is_off;
    }

    /// Records that the sensor measured `window`.
    pub(crate) fn record_scan(&mut self, window: Window) {
        self.refused.retain(|refused| refused.window != window);
    }

    /// Switches the laser on after a poll was refused, whatever the status: sources disagree on that.
    ///
    /// # Errors
    ///
    /// [`ErrorKind::NotConfirmed`] with both statuses if the laser stays off. Until the next
    /// attempt for this window is due, returns the last error, or `refusal` if the laser was on.
    pub(crate) async fn switch_on(
        &mut self,
        session: &mut Session,
        window: Window,
        refusal: ErrorKind,
    ) -> Result<(), ExchangeError> {
        if let Some(refused) = self.refused.iter().find(|refused| refused.window == window)
            && Instant::now() < refused.retry_at
        {
            return Err(ExchangeError::Command(refused.error.clone().unwrap_or(refusal)));
        }
        let outcome = session.set_laser(true).await;
        match &outcome {
            Ok(()) => self.retry_at = None,
            Err(ExchangeError::Command(error)) => self.record_refusal(window, Some(error.clone())),
            // The laser's state is unknown.
            Err(ExchangeError::Link(_)) => {}
        }
        outcome
    }

    /// Records that the sensor refuses to measure `window`: because of `error`, or with its laser on.
    pub(crate) fn record_refusal(&mut self, window: Window, error: Option<ErrorKind>) {
        let now = Instant::now();
        let (longest, known) = (RETRY.1, |refused: &RefusedWindow| refused.window == window);
        // Nobody has asked for these for a while.
        self.refused.retain(|refused| known(refused) || now < refused.retry_at + longest);
        let mut refused = match self.refused.iter().position(known) {
            Some(place) => self.refused.swap_remove(place),
            None => {
                let backoff = Backoff::new(RETRY);
                RefusedWindow { window, backoff, error: None, retry_at: now }
            }
        };
        (refused.error, refused.retry_at) = (error, now + refused.backoff.next());
        self.refused.push(refused);
    }
}
