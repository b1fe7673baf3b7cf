//! Opens a port, finds the sensor behind it, and applies the settings of the service.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, sleep_until, timeout};

use super::baud_rate;
use super::config::Config;
use super::failure::{ExchangeError, LinkError};
use super::laser::set_laser;
use super::session::{Session, UniqueRequests};
use crate::port::{AnyConnect, Port};
use crate::protocol::Text;
use crate::state::{Telemetry, VersionReply};
use crate::{BaudRate, Error, ErrorChain, ErrorKind};

/// One revolution of a URG's motor at 600 rpm.
const REVOLUTION: Duration = Duration::from_millis(100);
/// Number of candidates to try before backing off. No machine has as many ports, but a
/// [`Connect`](crate::port::Connect) may always promise another one.
const MAX_CANDIDATES: usize = 64;
/// Least time per candidate, for a very short open timeout. A search retries busy ports for 2 s:
/// [`MAX_CANDIDATES`] times this is longer.
const CANDIDATE_TIME: Duration = Duration::from_millis(40);
/// Number of times to ask a sensor for its serial number until two answers in a row agree.
/// If they never do, the last answer counts.
const IDENTITY_TRIES: usize = 4;

/// Opens the port, and restores the settings of the sensor behind it.
pub(crate) struct Opener {
    connect: Box<dyn AnyConnect>,
    config: Config,
    telemetry: Arc<Telemetry>,
    desired: DesiredSettings,
    /// Baud rate of the sensor when it was last found.
    found: Option<BaudRate>,
    /// Expected sensor: the one asked for, or the first one found.
    identity: Option<Text>,
    /// Serial number of the sensor that was last found.
    serial_number: Option<Text>,
    /// Requests of earlier sessions. The system keeps bytes that arrive while a port is
    /// closed, so the next session may read replies to them.
    unique_requests: UniqueRequests,
    opened: bool,
    scan_time: Duration,
}

/// Settings that the service asked for, restored whenever the sensor may have lost them.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DesiredSettings {
    pub(crate) laser: Option<bool>,
    pub(crate) baud_rate: Option<BaudRate>,
}

impl Opener {
    pub(crate) fn new(
        mut connect: Box<dyn AnyConnect>,
        config: Config,
        telemetry: Arc<Telemetry>,
    ) -> Self {
        let asked = connect.hints().and_then(|hints| hints.expected_serial_number());
        let asked = asked.map(Text::from);
        Self {
            desired: DesiredSettings { laser: None, baud_rate: config.baud_rate },
            found: None,
            serial_number: None,
            identity: config.serial_number.clone().or(asked),
            unique_requests: UniqueRequests::starting(config.seed()),
            opened: false,
            scan_time: REVOLUTION,
            connect,
            config,
            telemetry,
        }
    }

    pub(crate) fn desired(&mut self) -> &mut DesiredSettings {
        &mut self.desired
    }

    pub(crate) fn serial_number(&self) -> Text {
        self.serial_number.clone().unwrap_or_default()
    }

    /// Time of one revolution of the motor, from the sensor's version.
    pub(crate) fn scan_time(&self) -> Duration {
        self.scan_time
    }

    /// Opens the port and finds the sensor. If there are several ports, tries one after
    /// another.
    pub(crate) async fn open(&mut self) -> Result<Session, LinkError> {
        let mut candidates = 1;
        loop {
            let started = Instant::now();
            let error = match timeout(self.config.open_timeout, self.connect.connect()).await {
                Ok(Ok(port)) => match self.open_on(port).await {
                    Ok(session) => return Ok(session),
                    Err(ended @ LinkError::Ended(_)) => {
                        return Err(ended);
                    }
                    Err(failure) => failure.into_kind(),
                },
                Ok(Err(error)) => return Err(fail(error.into_kind())),
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
            candidates += 1;
            sleep_until(started + CANDIDATE_TIME).await;
        }
    }

    async fn open_on(&mut self, port: Box<dyn Port>) -> Result<Session, LinkError> {
        let unique_requests = std::mem::take(&mut self.unique_requests);
        let reply_latency = self.config.reply_latency;
        let observers = Arc::clone(&self.config.observers);
        let telemetry = Arc::clone(&self.telemetry);
        let mut session = Session::new(port, reply_latency, unique_requests, observers, telemetry);
        match self.find(&mut session, self.config.open_timeout).await {
            Ok(()) => Ok(session),
            Err(failure) => {
                self.close(session);
                Err(failure)
            }
        }
    }

    pub(crate) fn close(&mut self, session: Session) {
        self.unique_requests = session.close();
    }

    /// Finds the sensor again on a port that is still open.
    pub(crate) async fn find_again(&mut self, session: &mut Session) -> Result<(), LinkError> {
        // One pass over the baud rates; then the port is reopened. Without baud rates to search,
        // half the time: twice as many fences went unanswered before.
        let searchable =
            session.transport.is_adjustable() && session.transport.baud_rate().is_some();
        let share = if searchable { 1 } else { 2 };
        self.find(session, self.config.recovery_timeout / share).await
    }

    async fn find(&mut self, session: &mut Session, limit: Duration) -> Result<(), LinkError> {
        baud_rate::find(session, &self.baud_rates(), Instant::now() + limit).await?;
        let (reply, is_confirmed) = self.identify(session).await?;
        self.restore(session).await?;
        self.accept(reply, is_confirmed);
        self.found = session.transport.baud_rate();
        Ok(())
    }

    /// Accepts the sensor, now that it has the service's settings. From now on expects no
    /// other sensor.
    fn accept(&mut self, reply: VersionReply, is_confirmed: bool) {
        let version = &reply.version;
        let now = &version.serial_number;
        if is_confirmed && !self.config.any_sensor {
            self.identity.get_or_insert_with(|| now.clone());
        }
        let before = self.serial_number.replace(now.clone());
        let is_another = before.as_ref().is_some_and(|before| before != now);
        if let Some(before) = before.filter(|_| is_another) {
            tracing::warn!(%before, %now, "another sensor has taken its place");
        }
        // A flipped bit that spoils a version does not change the motor speed of a known
        // sensor.
        let motor_speed = version.specification.as_ref().and_then(|it| it.motor_speed);
        match motor_speed {
            Some(revolutions_per_minute) => {
                let revolutions_per_minute = u32::from(revolutions_per_minute.max(1));
                self.scan_time = Duration::from_secs(60) / revolutions_per_minute;
            }
            None if is_another => self.scan_time = REVOLUTION,
            None => {}
        }
        self.telemetry.set_version(reply);
        if let Some(hints) = self.connect.hints() {
            hints.found();
        }
        self.opened = true;
    }

    /// Lists all six baud rates, likeliest first.
    fn baud_rates(&self) -> Vec<BaudRate> {
        let likely = self.found.into_iter().chain(self.desired.baud_rate).chain([BaudRate::B19200]);
        let mut baud_rates = Vec::with_capacity(BaudRate::ALL.len());
        for baud_rate in likely.chain(BaudRate::ALL) {
            if !baud_rates.contains(&baud_rate) {
                baud_rates.push(baud_rate);
            }
        }
        baud_rates
    }

    /// Reads the sensor's version, and fails if it is another sensor. Also returns whether the
    /// serial number is certain.
    async fn identify(
        &mut self,
        session: &mut Session,
    ) -> Result<(VersionReply, bool), ExchangeError> {
        let (reply, is_confirmed) = self.confirm_identity(session).await?;
        let found = &reply.version.serial_number;
        if let Some(expected) = self.identity.as_ref().filter(|expected| *expected != found) {
            let (expected, found) = (expected.clone(), found.clone());
            let error = ErrorKind::AnotherSensor { expected, found };
            return Err(LinkError::Lost(error).into());
        }
        Ok((reply, is_confirmed))
    }

    /// Reads the version until its serial number is the expected one or repeats, up to
    /// [`IDENTITY_TRIES`] times. No checksum protects it: one flipped bit must neither reject
    /// a sensor nor become the expected number.
    async fn confirm_identity(
        &mut self,
        session: &mut Session,
    ) -> Result<(VersionReply, bool), ExchangeError> {
        let mut reply = session.version().await?;
        for _ in 1..IDENTITY_TRIES {
            if self.identity.as_ref() == Some(&reply.version.serial_number) {
                return Ok((reply, true));
            }
            let before = reply.version.serial_number;
            reply = session.version().await?;
            // An empty serial number never confirms an expected one. A serial number with
            // unprintable bytes is malformed, even if it repeats.
            let counts = before.is_printable() && (self.identity.is_none() || !before.is_empty());
            if counts && reply.version.serial_number == before {
                return Ok((reply, !before.is_empty()));
            }
        }
        Ok((reply, false))
    }

    /// Restores the settings that the service asked for.
    async fn restore(&mut self, session: &mut Session) -> Result<(), ExchangeError> {
        if let Some(baud_rate) = self.desired.baud_rate
            && session.transport.baud_rate().is_some_and(|now| now != baud_rate)
        {
            match baud_rate::change(session, baud_rate).await {
                // Scans at another baud rate are better than no scans.
                Err(ExchangeError::Command(error)) if self.opened => {
                    let error = ErrorChain(&error);
                    tracing::warn!(%error, "the baud rate is not restored");
                }
                outcome => outcome?,
            }
        }
        if let Some(on) = self.desired.laser {
            set_laser(session, on).await?;
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
