//! Opens a port, finds the sensor behind it, and applies the settings of the service.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, sleep, sleep_until, timeout};

use super::config::Config;
use super::failure::{ExchangeError, LinkError};
use super::laser::Laser;
use super::session::{Identity, Leftovers, Session};
use crate::port::{AnyConnect, Port};
use crate::protocol::Text;
use crate::state::Shared;
use crate::{BaudRate, Error, ErrorChain, ErrorKind, Geometry};

/// Number of candidates to try before backing off. No machine has as many ports, but a
/// [`Connect`](crate::port::Connect) may always promise another one.
const MAX_CANDIDATES: usize = 64;
/// Least time per candidate, for a very short open timeout. A search retries busy ports for 2 s:
/// [`MAX_CANDIDATES`] times this is longer.
const CANDIDATE_TIME: Duration = Duration::from_millis(40);
/// Time limit for finding a silent sensor again: one pass over the baud rates.
const RECOVERY_TIMEOUT: Duration = Duration::from_millis(2500);

/// Opens the port, and restores the settings of the sensor behind it.
pub(crate) struct Opener {
    connect: Box<dyn AnyConnect>,
    config: Config,
    shared: Arc<Shared>,
    pub(crate) laser: Laser,
    /// Baud rate to restore whenever the sensor may have lost it: the builder's, or the last confirmed.
    pub(crate) baud_rate: Option<BaudRate>,
    /// True if the log has told that the baud rate is not restored.
    is_reported: bool,
    /// Baud rate of the sensor when it was last found.
    found: Option<BaudRate>,
    /// Expected sensor: the one asked for, or the first one found.
    identity: Option<Text>,
    /// Serial number of the sensor that was last found.
    pub(crate) serial_number: Option<Text>,
    leftovers: Leftovers,
    /// What the sensor measures, once that is confirmed.
    geometry: Option<Geometry>,
}

impl Opener {
    pub(crate) fn new(
        mut connect: Box<dyn AnyConnect>,
        config: Config,
        shared: Arc<Shared>,
    ) -> Self {
        let asked = connect.hints().and_then(|hints| hints.expected_serial_number());
        let asked = asked.map(Text::from);
        Self {
            laser: Laser::new(Arc::clone(&shared)),
            baud_rate: config.baud_rate,
            is_reported: false,
            found: None,
            serial_number: None,
            identity: config.serial_number.clone().or(asked),
            leftovers: Leftovers::unknown(),
            geometry: None,
            connect,
            config,
            shared,
        }
    }

    pub(crate) fn geometry(&self) -> Geometry {
        self.geometry.unwrap_or(Geometry::URG_04LX)
    }

    /// Opens the port and finds the sensor. If there are several ports, tries one after
    /// another. Switches the laser as `laser` desired.
    pub(crate) async fn open(&mut self, laser: Option<bool>) -> Result<Session, LinkError> {
        let (mut candidates, mut others) = (1, Vec::new());
        loop {
            let started = Instant::now();
            let error = match timeout(self.config.open_timeout, self.connect.connect()).await {
                Ok(Ok(port)) => match self.open_on(port, laser).await {
                    Ok(session) => return Ok(session),
                    Err(ended @ LinkError::Ended(_)) => return Err(ended),
                    Err(failure) => failure.kind().clone(),
                },
                Ok(Err(error)) => {
                    let mut error = error.into_kind();
                    if let ErrorKind::NoSuchSensor { found, .. } = &mut error {
                        found.append(&mut others);
                    }
                    return Err(fail(error));
                }
                Err(_) => {
                    let port = self.connect.name().unwrap_or("the port");
                    Error::open(port, io::ErrorKind::TimedOut.into()).into_kind()
                }
            };
            let has_more = self.connect.hints().is_some_and(|hints| hints.has_more());
            if candidates == MAX_CANDIDATES || !has_more {
                return Err(fail(error));
            }
            tracing::trace!(error = %ErrorChain(&error), "port skipped");
            if let ErrorKind::AnotherSensor { found, .. } = error {
                others.push(found);
            }
            candidates += 1;
            sleep_until(started + CANDIDATE_TIME).await;
        }
    }

    /// Waits before the next [`open`](Self::open): until a port appears, at most for `time`.
    pub(crate) async fn back_off(&mut self, time: Duration) {
        match self.connect.hints().and_then(|hints| hints.port_appears()) {
            Some(port_appears) => timeout(time, port_appears).await.unwrap_or_default(),
            None => sleep(time).await,
        }
    }

    async fn open_on(
        &mut self,
        port: Box<dyn Port>,
        laser: Option<bool>,
    ) -> Result<Session, LinkError> {
        let leftovers = std::mem::replace(&mut self.leftovers, Leftovers::unknown());
        let shared = Arc::clone(&self.shared);
        let mut session = Session::new(port, &self.config, leftovers, shared);
        match self.find(&mut session, laser, self.config.open_timeout).await {
            Ok(()) => Ok(session),
            Err(failure) => {
                self.close(session);
                Err(failure)
            }
        }
    }

    pub(crate) fn close(&mut self, session: Session) {
        self.leftovers = session.close();
    }

    /// Finds the sensor again on a port that is still open.
    pub(crate) async fn find_again(
        &mut self,
        session: &mut Session,
        laser: Option<bool>,
    ) -> Result<(), LinkError> {
        // Then the port is reopened. Without baud rates to search, half the time is enough.
        let share = if session.is_searchable() { 1 } else { 2 };
        self.find(session, laser, RECOVERY_TIMEOUT / share).await
    }

    async fn find(
        &mut self,
        session: &mut Session,
        laser: Option<bool>,
        limit: Duration,
    ) -> Result<(), LinkError> {
        let (end, mut was_found) = (Instant::now() + limit, false);
        let identity = loop {
            session.find(&self.baud_rates(), end).await?;
            match self.identify(session).await {
                // It answered a moment ago: no back-off is needed.
                Err(failure) if !was_found && failure.is_lost_reply() => was_found = true,
                // It may refuse while it boots.
                Err(ExchangeError::Command(ErrorKind::Refused { .. })) if Instant::now() < end => {
                    sleep(CANDIDATE_TIME).await;
                }
                outcome => break outcome?,
            }
        };
        self.restore_baud_rate(session).await?;
        self.laser.restore(session, laser).await?;
        self.accept(identity);
        self.found = session.baud_rate();
        Ok(())
    }

    /// Accepts the sensor, now that it has the service's settings. From now on expects no other sensor.
    fn accept(&mut self, identity: Identity) {
        let Identity { reply, is_serial_number_confirmed, geometry } = identity;
        let now = &reply.version.serial_number;
        if is_serial_number_confirmed && !self.config.any_sensor {
            self.identity.get_or_insert_with(|| now.clone());
        }
        let before = self.serial_number.replace(now.clone());
        let is_another = before.as_ref().is_some_and(|before| before != now);
        if let Some(before) = before.filter(|_| is_another) {
            tracing::warn!(%before, %now, "another sensor has taken its place");
        }
        // A flipped bit changes the geometry of no sensor.
        if geometry.is_some() || is_another {
            self.geometry = geometry;
        }
        self.shared.link.set_identity(reply, self.geometry());
        if let Some(hints) = self.connect.hints() {
            hints.found();
        }
    }

    /// Lists all six baud rates, likeliest first.
    fn baud_rates(&self) -> Vec<BaudRate> {
        let likely = self.found.into_iter().chain(self.baud_rate).chain([BaudRate::B19200]);
        let mut baud_rates = Vec::with_capacity(BaudRate::ALL.len());
        for baud_rate in likely.chain(BaudRate::ALL) {
            if !baud_rates.contains(&baud_rate) {
                baud_rates.push(baud_rate);
            }
        }
        baud_rates
    }

    /// Identifies the sensor, and fails if it is another one than expected.
    async fn identify(&mut self, session: &mut Session) -> Result<Identity, ExchangeError> {
        let identity = session.identify(self.identity.as_ref(), self.geometry).await?;
        let found = &identity.reply.version.serial_number;
        if let Some(expected) = self.identity.as_ref().filter(|expected| *expected != found) {
            let (expected, found) = (expected.clone(), found.clone());
            let error = ErrorKind::AnotherSensor { expected, found };
            return Err(LinkError::Lost(error).into());
        }
        Ok(identity)
    }

    async fn restore_baud_rate(&mut self, session: &mut Session) -> Result<(), ExchangeError> {
        if let Some(baud_rate) = self.baud_rate
            && session.baud_rate().is_some_and(|now| now != baud_rate)
        {
            match session.set_baud_rate(baud_rate).await {
                // Scans at another baud rate are better than no scans.
                Err(ExchangeError::Command(error)) if self.serial_number.is_some() => {
                    let error = ErrorChain(&error);
                    if !std::mem::replace(&mut self.is_reported, true) {
                        tracing::warn!(%error, "the baud rate is not restored");
                    }
                }
                outcome => {
                    outcome?;
                    self.is_reported = false;
                }
            }
        }
        Ok(())
    }
}

/// Logs the error of an attempt, at trace: the default back-off makes one attempt a
/// second, and the state logs each reason once.
fn fail(error: ErrorKind) -> LinkError {
    tracing::trace!(error = %ErrorChain(&error), "opening failed");
    LinkError::Lost(error)
}
