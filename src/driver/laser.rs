//! Switches the laser and confirms it. Switches it on again if something else switched it
//! off. Never trusts a status alone.

use std::time::Duration;

use tokio::time::Instant;

use super::backoff::Backoff;
use super::failure::ExchangeError;
use super::session::Session;
use crate::ErrorKind;
use crate::protocol::{Command, Status};

/// Shortest and longest delay between attempts to switch on a laser that stays off.
const RETRY: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(30));

/// Switches the laser and confirms it with a fence: the sensor refuses a `G` if and only
/// if the laser is off.
pub(crate) async fn set_laser(session: &mut Session, on: bool) -> Result<(), ExchangeError> {
    let command = if on { Command::LaserOn } else { Command::LaserOff };
    let mut tries = 2;
    loop {
        tries -= 1;
        let (reply, _) = session.command_twice(command).await?;
        // The caller asked for `command` and knows nothing of fences.
        let measured = session.fence().await.map_err(|error| error.on_behalf_of(command))?;
        if measured.is_ok() == on {
            return Ok(());
        }
        if tries == 0 {
            let (status, refusal) = (Some(reply.status()), Some(measured).filter(|_| on));
            return Err(ExchangeError::Command(ErrorKind::NotConfirmed {
                command,
                status,
                refusal,
            }));
        }
    }
}

/// Switches the laser back on if this driver did not switch it off. Backs off, because a
/// laser that stays off would otherwise cost two commands for each poll.
pub(crate) struct LaserRecovery {
    backoff: Backoff,
    /// Result of the last attempt, and time of the next one. `Some(error)`: the laser
    /// stays off. `None`: the sensor refuses to measure although its laser is on.
    failed: Option<(Option<ErrorKind>, Instant)>,
}

impl LaserRecovery {
    pub(crate) fn new(seed: u64) -> Self {
        Self { backoff: Backoff::new(RETRY, seed), failed: None }
    }

    /// Records that the laser is on, because a scan was received.
    pub(crate) fn record_scan(&mut self) {
        if self.failed.take().is_some() {
            self.backoff.restart();
        }
    }

    /// Switches the laser on after the sensor refused a poll. Ignores which status it
    /// refused with: sources disagree on the status of a `G` while the laser is off.
    ///
    /// # Errors
    ///
    /// [`ErrorKind::NotConfirmed`] with both statuses if the laser stays off. Before the next
    /// attempt is due, the last error again, or `refusal` if the laser was on.
    pub(crate) async fn switch_on(
        &mut self,
        session: &mut Session,
        refusal: Refusal,
    ) -> Result<(), ExchangeError> {
        if let Some((error, retry_at)) = &self.failed
            && Instant::now() < *retry_at
        {
            let error = error.clone().unwrap_or_else(|| refusal.into());
            return Err(ExchangeError::Command(error));
        }
        let error = match set_laser(session, true).await {
            Ok(()) => {
                let status = refusal.status;
                tracing::info!(%status, "the sensor refused a poll: switched its laser on");
                return Ok(());
            }
            Err(ExchangeError::Command(ErrorKind::Refused { command, status, .. })) => {
                let (status, refusal) = (Some(status), Some(refusal.status));
                ErrorKind::NotConfirmed { command, status, refusal }
            }
            Err(ExchangeError::Command(error @ ErrorKind::NotConfirmed { .. })) => error,
            // The laser's state is unknown.
            Err(error) => return Err(error),
        };
        self.failed = Some((Some(error.clone()), Instant::now() + self.backoff.next()));
        Err(ExchangeError::Command(error))
    }

    /// Records that the sensor refuses to measure although its laser is on.
    pub(crate) fn record_refusal(&mut self) {
        self.failed = Some((None, Instant::now() + self.backoff.next()));
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

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use tokio::time::advance;

    use super::*;
    use crate::Window;
    use crate::driver::session::UniqueRequests;
    use crate::port::StreamPort;
    use crate::state::Telemetry;

    #[tokio::test(start_paused = true)]
    async fn the_laser_is_tried_again_at_the_instant_that_is_due_and_not_before() {
        let (near, _silent) = tokio::io::duplex(4096);
        let mut session = Session::new(
            Box::new(StreamPort(near)),
            None,
            UniqueRequests::default(),
            Arc::default(),
            Arc::new(Telemetry::new(None)),
        );
        let refusal =
            Refusal { command: Command::Distances(Window::FULL), status: Status::new(b'6') };
        let mut recovery = LaserRecovery::new(7);
        recovery.failed = Some((None, Instant::now() + Duration::from_nanos(1)));
        let early = recovery.switch_on(&mut session, refusal).await;
        assert!(
            matches!(early, Err(ExchangeError::Command(ErrorKind::Refused { .. }))),
            "{early:?}"
        );
        advance(Duration::from_nanos(1)).await;
        let tried = recovery.switch_on(&mut session, refusal).await;
        assert!(
            !matches!(tried, Err(ExchangeError::Command(ErrorKind::Refused { .. }))),
            "{tried:?}"
        );
    }
}
