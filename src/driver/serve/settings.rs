//! Sets the laser and the baud rate as the service wants them: on request, and after a link was lost.

use tokio::time::Instant;

use super::super::failure::{ExchangeError, LinkError};
use super::super::session::Session;
use super::{Service, Stop, ignore_command_errors};
use crate::{BaudRate, ErrorChain, ErrorKind};

/// Number of attempts at a baud rate that the sensor neither confirms nor refuses. At a baud rate
/// that the cable cannot carry, each costs the link.
const BAUD_RATE_ATTEMPTS: u8 = 3;

impl Service<'_> {
    /// Lets the baud rate be restored if the session is not at it: the sensor may have restarted while
    /// its baud rate was restored.
    pub(super) fn check_baud_rate(&mut self, now: Option<BaudRate>) {
        let desired = &mut self.queue.desired;
        if let Some(now) = now
            && desired.baud_rate.is_none()
            && desired.attempts < BAUD_RATE_ATTEMPTS
        {
            desired.baud_rate = self.baud_rate.filter(|baud_rate| *baud_rate != now);
        }
    }

    /// Returns true if a setting is to be applied.
    pub(super) fn has_setting(&self) -> bool {
        let desired = &self.queue.desired;
        desired.baud_rate.is_some() || self.laser.is_due(desired.laser)
    }

    /// Returns true if there was a setting to apply.
    pub(super) async fn apply_setting(&mut self, session: &mut Session) -> Result<bool, Stop> {
        if self.apply_laser(session).await? {
            return Ok(true);
        }
        let Some(baud_rate) = self.queue.desired.baud_rate else { return Ok(false) };
        Box::pin(self.apply_baud_rate(session, baud_rate)).await?;
        Ok(true)
    }

    pub(super) async fn apply_laser(&mut self, session: &mut Session) -> Result<bool, Stop> {
        let desired = self.queue.desired.laser;
        let Some(on) = desired.filter(|_| self.laser.is_due(desired)) else { return Ok(false) };
        // The request does it next.
        if self.queue.begins_with_laser() {
            return Ok(false);
        }
        let outcome = Box::pin(self.switch_laser(session, on, true)).await;
        ignore_command_errors(outcome)?;
        Ok(true)
    }

    /// Switches the laser. Polls only while it is not switched off.
    pub(super) async fn switch_laser(
        &mut self,
        session: &mut Session,
        on: bool,
        is_retry: bool,
    ) -> Result<(), ExchangeError> {
        let was_off = self.laser.is_off;
        let outcome = match is_retry {
            true => self.laser.retry(session, on).await,
            false => self.laser.switch(session, on).await,
        };
        match self.laser.is_off {
            is_off if is_off == was_off => {}
            true => self.schedules.pause(),
            false => self.schedules.resume(Instant::now()),
        }
        outcome
    }

    /// Changes the baud rate. From now on it is restored, unless the sensor refuses it.
    pub(super) async fn change_baud_rate(
        &mut self,
        session: &mut Session,
        baud_rate: BaudRate,
    ) -> Result<(), ExchangeError> {
        let before = session.baud_rate();
        let mut outcome = session.set_baud_rate(baud_rate).await;
        if outcome.is_ok() {
            *self.baud_rate = Some(baud_rate);
            if self.laser.is_off {
                // The sensor may have restarted unnoticed.
                outcome = self.switch_laser(session, false, true).await;
            }
        }
        if session.baud_rate() != before {
            self.shared.link.set_baud_rate(session.baud_rate());
        }
        outcome
    }

    /// Changes the baud rate as a handle asked while there was no link. No caller waits for it.
    async fn apply_baud_rate(
        &mut self,
        session: &mut Session,
        baud_rate: BaudRate,
    ) -> Result<(), Stop> {
        let outcome = self.change_baud_rate(session, baud_rate).await;
        let desired = &mut self.queue.desired;
        desired.attempts += u8::from(!is_unplugged(&outcome));
        let error = outcome.as_ref().err().map(ExchangeError::kind);
        let is_final = match error {
            Some(ErrorKind::Refused { .. } | ErrorKind::UnsupportedBaudRate { .. }) | None => true,
            // The sensor may have restarted at that moment.
            Some(_) => desired.attempts >= BAUD_RATE_ATTEMPTS,
        };
        if is_final {
            desired.baud_rate = None;
            match error {
                Some(error) => {
                    let error = ErrorChain(error);
                    tracing::warn!(%error, %baud_rate, "the baud rate is not changed");
                }
                None => desired.attempts = 0,
            }
        }
        ignore_command_errors(outcome)
    }
}

/// Returns true if the port is gone: nothing tells whether the sensor would have obeyed.
pub(super) fn is_unplugged<T>(outcome: &Result<T, ExchangeError>) -> bool {
    matches!(outcome, Err(ExchangeError::Link(LinkError::Lost(_))))
}
