//! Switches the laser by `L`, and confirms it with a fence. A status alone proves nothing.

use super::super::super::failure::ExchangeError;
use super::super::errors::{not_confirmed, on_behalf_of};
use super::Scip1;
use super::exchange::refusal;
use crate::protocol::{Command, Status, Text};

impl Scip1 {
    /// Switches the laser, and checks it by a `G`, which the sensor refuses only while it is off.
    pub(in super::super) async fn set_laser(&mut self, on: bool) -> Result<(), ExchangeError> {
        let command = if on { Command::LaserOn } else { Command::LaserOff };
        let (mut status, mut fence) = self.switch(command).await?;
        let is_doubtful = match status {
            // A refused `G` without an answer to `L0` proves little: its status may have been another
            // one. A driver that is closing has no time to ask again.
            None => !on && !fence.is_ok() && !self.line.shared.is_closing(),
            // A status of success may have been another one, too.
            Some(status) => status.is_ok_for(&command) && fence.is_ok() != on,
        };
        if is_doubtful {
            (status, fence) = self.switch(command).await?;
        }
        match status {
            _ if fence.is_ok() != on => {
                let refusal = on.then_some(fence);
                Err(ExchangeError::Command(not_confirmed(
                    &command,
                    status.map(Text::from),
                    refusal.map(Text::from),
                )))
            }
            Some(status) if !on && !status.is_ok_for(&command) => Err(refusal(&command, status)),
            _ => Ok(()),
        }
    }

    /// Sends `command` and a fence. Returns the status of each, or `None` if the command has none.
    async fn switch(
        &mut self,
        command: Command,
    ) -> Result<(Option<Status>, Status), ExchangeError> {
        let status = match self.command_twice(command).await {
            Ok(answer) => Some(answer.reply.status),
            Err(ExchangeError::Command(_)) => None,
            Err(lost) => return Err(lost),
        };
        // The caller asked for `command` and knows nothing of fences.
        let fence = self.fence().await.map_err(on_behalf_of(command))?;
        Ok((status, fence))
    }
}
