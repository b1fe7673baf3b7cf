//! The laser: switched, and confirmed. A status alone is never believed.

use super::exchange::ExchangeError;
use super::session::Session;
use crate::Error;
use crate::protocol::Command;

/// Switches the laser, and confirms it by a fence: a `G` is refused if and only
/// if the laser is off.
pub(crate) async fn set_laser(session: &mut Session, on: bool) -> Result<(), ExchangeError> {
    let command = if on { Command::LaserOn } else { Command::LaserOff };
    for _ in 0..2 {
        session.command_twice(command, |_| ()).await?;
        if session.fence().await?.is_ok() == on {
            return Ok(());
        }
    }
    Err(ExchangeError::Command(Error::NotConfirmed { command }))
}
