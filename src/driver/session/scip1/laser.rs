//! Switches the laser by `L`, and confirms it with a fence. A status alone proves nothing.

use super::super::super::failure::ExchangeError;
use super::errors::{not_confirmed, on_behalf_of};
use super::Session;
use super::exchange::refusal;
use crate::protocol::Command;

impl Session {
    /// Switches the laser, and checks whether the sensor measures: it refuses a `G` if and only if
    /// its laser is off.
    ///
    /// # Errors
    ///
    /// [`NotConfirmed`](crate::ErrorKind::NotConfirmed) if it stays as it is. [`Refused`](crate::ErrorKind::Refused) if
    /// the sensor refuses both `L0` and to measure: then nothing tells whether the laser is off.
    pub(crate) async fn set_laser(&mut self, on: bool) -> Result<(), ExchangeError> {
        let command = if on { Command::LaserOn } else { Command::LaserOff };
        let mut is_last = false;
        loop {
            let status = match self.command_twice(command).await {
                Ok(answer) => Some(answer.reply.status()),
                Err(ExchangeError::Command(_)) => None,
                Err(lost) => return Err(lost),
            };
            let refused = status.filter(|status| !status.is_ok_for(&command));
            // The caller asked for `command` and knows nothing of fences.
            let fence = self.fence().await.map_err(on_behalf_of(command))?;
            if fence.is_ok() == on {
                if let Some(status) = refused.filter(|_| !on) {
                    return Err(refusal(&command, status));
                }
                // One refused `G` without an answer to `L0` proves little: its status may have
                // been another one. A driver that is closing has no time to ask again.
                let is_proved = on || status.is_some();
                if is_proved || is_last || self.is_closing() {
                    return Ok(());
                }
            } else if is_last || refused.is_some() || status.is_none() {
                let refusal = Some(fence).filter(|_| on);
                return Err(ExchangeError::Command(not_confirmed(&command, status, refusal)));
            }
            // A status of success may have been another one, too.
            is_last = true;
        }
    }
}
