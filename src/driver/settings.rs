//! What a sensor can be told, laser and baud rate, and how to find out at
//! which speed it listens. A single status `0` is never believed: the sensor's
//! behaviour has to confirm it.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::session::{Failure, Session};
use crate::protocol::{Command, Malformed};
use crate::{BaudRate, Error, Window};

/// How long a fence may take while the speed is looked for, its bytes on the
/// line not counted.
const SEARCH_LATENCY: Duration = Duration::from_millis(400);
/// After `S` is accepted the new speed applies one revolution later; some
/// sensors take two.
const CHANGE_TIME: Duration = Duration::from_millis(200);

impl Session {
    /// Looks for the sensor at each of `speeds`, over and over until
    /// `deadline`; or just listens where the port cannot change its speed or
    /// has none.
    pub(crate) async fn find(
        &mut self,
        baud_rates: &[BaudRate],
        deadline: Instant,
    ) -> Result<(), Failure> {
        let before = self.received();
        let mut damaged = None;
        loop {
            let mut usable = false;
            for &baud_rate in baud_rates {
                let mut latency = SEARCH_LATENCY;
                if self.baud_rate().is_some() {
                    match self.set_baud_rate(baud_rate) {
                        Ok(()) => {}
                        Err(error) if error.kind() == io::ErrorKind::Unsupported => {
                            latency = self.latency(&Command::Distances(Window::FULL));
                        }
                        // The adapter may not know this one.
                        Err(_) => continue,
                    }
                } else {
                    latency = self.latency(&Command::Distances(Window::FULL));
                }
                usable = true;
                // The system may have kept more than any answer is worth.
                self.discard_pending().await?;
                match self.fence_once(latency).await {
                    Ok(_) => return Ok(()),
                    Err(Failure::Command(Error::Timeout { .. })) => {}
                    // One damaged answer is none; always the same is a reason.
                    Err(Failure::Command(error @ Error::Malformed { .. }))
                        if !is_not_raw(&error) =>
                    {
                        damaged = Some(error);
                    }
                    // Something answers, and it is not what it should be.
                    Err(Failure::Command(error)) => return Err(Failure::Silent(error)),
                    Err(lost) => return Err(lost),
                }
                if Instant::now() >= deadline {
                    let searched = self.is_adjustable() && self.baud_rate().is_some();
                    let baud_rate = self.baud_rate().filter(|_| !searched);
                    let bytes = self.received() - before;
                    let silence = Error::NoAnswer { baud_rate, searched, bytes };
                    return Err(Failure::Silent(damaged.unwrap_or(silence)));
                }
            }
            if !usable {
                let text = "the port takes none of the six baud rates";
                return Err(io::Error::new(io::ErrorKind::InvalidInput, text).into());
            }
        }
    }

    /// Switches the laser, and confirms it: `G` is refused if and only if the
    /// laser is off.
    pub(crate) async fn set_laser(&mut self, on: bool) -> Result<(), Failure> {
        let command = if on { Command::LaserOn } else { Command::LaserOff };
        for _ in 0..2 {
            self.command_twice(command, |_| ()).await?;
            if self.fence().await?.is_ok() == on {
                return Ok(());
            }
        }
        Err(Failure::Command(Error::NotConfirmed { command }))
    }

    /// Moves sensor and port to another speed. If that fails both are at the
    /// old one again, or the sensor has to be looked for.
    pub(crate) async fn change_baud_rate(&mut self, baud_rate: BaudRate) -> Result<(), Failure> {
        let old = self.baud_rate();
        if old == Some(baud_rate) {
            // The sensor may have restarted unseen.
            return self.fence().await.map(drop);
        }
        // The sensor must not go where the port cannot follow.
        if let Err(error) = self.set_baud_rate(baud_rate) {
            let source = self.is_adjustable().then(|| Arc::new(error));
            if let Some(old) = old.filter(|_| self.is_adjustable()) {
                self.set_baud_rate(old)?;
            }
            return Err(Failure::Command(Error::UnsupportedBaudRate { baud_rate, source }));
        }
        let command = Command::BaudRate(baud_rate);
        let Some(old) = old else {
            // USB: accepted without effect (C-42-3320-A p. 5).
            return self.command_twice(command, |_| ()).await.map(drop);
        };
        self.set_baud_rate(old)?;
        match self.command(command, |_| ()).await {
            // Without a reply the sensor may or may not have changed.
            Ok(_) | Err(Failure::Command(Error::Timeout { .. } | Error::Malformed { .. })) => {}
            Err(failure) => return Err(failure),
        }
        sleep(CHANGE_TIME).await;
        self.set_baud_rate(baud_rate)?;
        if self.answers(3).await? {
            return Ok(());
        }
        self.set_baud_rate(old)?;
        if self.answers(3).await? {
            return Err(Failure::Command(Error::NotConfirmed { command }));
        }
        Err(Failure::Silent(Error::NotConfirmed { command }))
    }

    /// Whether the sensor answers one of `tries` fences.
    async fn answers(&mut self, tries: usize) -> Result<bool, Failure> {
        for _ in 0..tries {
            match self.fence_once(SEARCH_LATENCY).await {
                Ok(_) => return Ok(true),
                Err(Failure::Command(_)) => {}
                Err(failure) => return Err(failure),
            }
        }
        Ok(false)
    }
}

fn is_not_raw(error: &Error) -> bool {
    matches!(error, Error::Malformed { source: Malformed::NotRaw, .. })
}
