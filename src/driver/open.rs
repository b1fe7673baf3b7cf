//! Opens a port, finds the sensor behind it, and applies the settings of the service.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, sleep, sleep_until, timeout};

use super::baud_rate;
use super::config::Config;
use super::failure::{ExchangeError, LinkError};
use super::laser::Laser;
use super::session::{Leftovers, Session, UniqueRequests};
use crate::port::{AnyConnect, Port};
use crate::protocol::{Text, Version};
use crate::state::{Telemetry, VersionReply};
use crate::{BaudRate, Error, ErrorChain, ErrorKind};

/// One revolution of a URG's motor, and the revolutions a minute.
const REVOLUTION: Duration = Duration::from_millis(100);
const NOMINAL_SPEED: u16 = 600;
/// Number of candidates to try before backing off. No machine has as many ports, but a
/// [`Connect`](crate::port::Connect) may always promise another one.
const MAX_CANDIDATES: usize = 64;
/// Least time per candidate, for a very short open timeout. A search retries busy ports for 2 s:
/// [`MAX_CANDIDATES`] times this is longer.
const CANDIDATE_TIME: Duration = Duration::from_millis(40);
/// Number of times to ask a sensor for its version until two replies agree. If no two do, the last
/// serial number counts, and no motor speed.
const IDENTITY_TRIES: usize = 4;

/// Opens the port, and restores the settings of the sensor behind it.
pub(crate) struct Opener {
    connect: Box<dyn AnyConnect>,
    config: Config,
    telemetry: Arc<Telemetry>,
    laser: Laser,
    /// Baud rate to restore whenever the sensor may have lost it: the builder's, or the latest
    /// that the sensor has confirmed.
    baud_rate: Option<BaudRate>,
    /// True if the log has told that the baud rate is not restored.
    is_reported: bool,
    /// Baud rate of the sensor when it was last found.
    found: Option<BaudRate>,
    /// Expected sensor: the one asked for, or the first one found.
    identity: Option<Text>,
    /// Serial number of the sensor that was last found.
    serial_number: Option<Text>,
    leftovers: Leftovers,
    opened: bool,
    /// Motor speed on which two replies have agreed, which may be that the sensor tells none.
    motor_speed: Option<Option<u16>>,
    scan_time: Duration,
}

/// Reply to `V`, and what of it is certain: known before, or the same twice.
struct Identified {
    reply: VersionReply,
    serial_is_certain: bool,
    /// Motor speed, if it is certain: perhaps that the sensor tells none.
    speed: Option<Option<u16>>,
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
            laser: Laser::new(config.seed(), Arc::clone(&telemetry)),
            baud_rate: config.baud_rate,
            is_reported: false,
            found: None,
            serial_number: None,
            identity: config.serial_number.clone().or(asked),
            leftovers: Leftovers {
                unique_requests: UniqueRequests::starting(config.seed()),
                interrupted: false,
            },
            opened: false,
            motor_speed: None,
            scan_time: REVOLUTION,
            connect,
            config,
            telemetry,
        }
    }

    /// Returns the laser, and the baud rate to restore.
    pub(crate) fn settings(&mut self) -> (&mut Laser, &mut Option<BaudRate>) {
        (&mut self.laser, &mut self.baud_rate)
    }

    pub(crate) fn serial_number(&self) -> Text {
        self.serial_number.clone().unwrap_or_default()
    }

    /// Time of one revolution of the motor, from the sensor's version.
    pub(crate) fn scan_time(&self) -> Duration {
        self.scan_time
    }

    /// Opens the port and finds the sensor. If there are several ports, tries one after
    /// another. Switches the laser as `laser` wishes.
    pub(crate) async fn open(&mut self, laser: Option<bool>) -> Result<Session, LinkError> {
        let mut candidates = 1;
        loop {
            let started = Instant::now();
            let error = match timeout(self.config.open_timeout, self.connect.connect()).await {
                Ok(Ok(port)) => match self.open_on(port, laser).await {
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
        let leftovers = std::mem::take(&mut self.leftovers);
        let reply_latency = self.config.reply_latency;
        let observers = Arc::clone(&self.config.observers);
        let telemetry = Arc::clone(&self.telemetry);
        let mut session = Session::new(port, reply_latency, leftovers, observers, telemetry);
        match self.find(&mut session, laser, self.config.open_timeout).await {
            Ok(()) => Ok(session),
            Err(mut failure) => {
                if let LinkError::Silent(ErrorKind::WrongProtocol { model, .. }) = &mut failure {
                    *model = session.scip2_model().await;
                }
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
        // One pass over the baud rates; then the port is reopened. Without baud rates to search,
        // half the time: twice as many fences went unanswered before.
        let searchable =
            session.transport.is_adjustable() && session.transport.baud_rate().is_some();
        let share = if searchable { 1 } else { 2 };
        self.find(session, laser, self.config.recovery_timeout / share).await
    }

    async fn find(
        &mut self,
        session: &mut Session,
        laser: Option<bool>,
        limit: Duration,
    ) -> Result<(), LinkError> {
        baud_rate::find(session, &self.baud_rates(), Instant::now() + limit).await?;
        let identified = self.identify(session).await?;
        self.restore_baud_rate(session).await?;
        self.laser.restore(session, laser).await?;
        self.accept(identified);
        self.found = session.transport.baud_rate();
        Ok(())
    }

    /// Accepts the sensor, now that it has the service's settings. From now on expects no
    /// other sensor.
    fn accept(&mut self, identified: Identified) {
        let Identified { reply, serial_is_certain, speed } = identified;
        let now = &reply.version.serial_number;
        if serial_is_certain && !self.config.any_sensor {
            self.identity.get_or_insert_with(|| now.clone());
        }
        let before = self.serial_number.replace(now.clone());
        let is_another = before.as_ref().is_some_and(|before| before != now);
        if let Some(before) = before.filter(|_| is_another) {
            tracing::warn!(%before, %now, "another sensor has taken its place");
        }
        // A flipped bit changes the motor speed of no sensor.
        if speed.is_some() || is_another {
            self.motor_speed = speed;
            self.scan_time = speed.flatten().map_or(REVOLUTION, |revolutions_per_minute| {
                Duration::from_secs(60) / u32::from(revolutions_per_minute.max(1))
            });
        }
        self.telemetry.set_version(reply);
        if let Some(hints) = self.connect.hints() {
            hints.found();
        }
        self.opened = true;
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

    /// Reads the sensor's version, and fails if it is another sensor.
    async fn identify(&mut self, session: &mut Session) -> Result<Identified, ExchangeError> {
        let identified = self.confirm_identity(session).await?;
        let found = &identified.reply.version.serial_number;
        if let Some(expected) = self.identity.as_ref().filter(|expected| *expected != found) {
            let (expected, found) = (expected.clone(), found.clone());
            let error = ErrorKind::AnotherSensor { expected, found };
            return Err(LinkError::Lost(error).into());
        }
        Ok(identified)
    }

    /// Reads the version until its serial number and motor speed are known or repeat, up to
    /// [`IDENTITY_TRIES`] times, unless the port delivers all bytes intact. No checksum of SCIP
    /// protects them: one flipped bit must neither reject a sensor, nor become the expected number,
    /// nor move the times of a session.
    async fn confirm_identity(
        &mut self,
        session: &mut Session,
    ) -> Result<Identified, ExchangeError> {
        let mut replies: Vec<VersionReply> = Vec::new();
        let enough = if session.transport.delivers_intact() { 1 } else { 2 };
        loop {
            let latest = session.version().await?;
            replies.push(latest.clone());
            let settled = replies.iter().find(|reply| {
                let number = &reply.version.serial_number;
                // An empty serial number never confirms an expected one. A serial number with
                // unprintable bytes is malformed, even if it repeats.
                let counts =
                    number.is_printable() && (self.identity.is_none() || !number.is_empty());
                let same = replies.iter().filter(|one| one.version.serial_number == *number);
                self.identity.as_ref() == Some(number) || counts && same.count() >= enough
            });
            let speeds = || replies.iter().map(|reply| motor_speed(&reply.version));
            let speed = speeds().find(|speed| {
                // A flipped bit in another speed hardly ever makes the nominal one.
                [self.motor_speed, Some(Some(NOMINAL_SPEED))].contains(&Some(*speed))
                    || speeds().filter(|one| one == speed).count() >= enough
            });
            if settled.is_some() && speed.is_some() || replies.len() == IDENTITY_TRIES {
                let is_certain = settled.is_some_and(|it| !it.version.serial_number.is_empty());
                let reply = settled.cloned().unwrap_or(latest);
                return Ok(Identified { reply, serial_is_certain: is_certain, speed });
            }
        }
    }

    async fn restore_baud_rate(&mut self, session: &mut Session) -> Result<(), ExchangeError> {
        if let Some(baud_rate) = self.baud_rate
            && session.transport.baud_rate().is_some_and(|now| now != baud_rate)
        {
            match baud_rate::change(session, baud_rate).await {
                // Scans at another baud rate are better than no scans.
                Err(ExchangeError::Command(error)) if self.opened => {
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

fn motor_speed(version: &Version) -> Option<u16> {
    version.specification.as_ref().and_then(|specification| specification.motor_speed)
}

/// Logs the error of an attempt, at trace: the default back-off makes one attempt a
/// second, and the state logs each reason once.
fn fail(error: ErrorKind) -> LinkError {
    tracing::trace!(error = %ErrorChain(&error), "opening failed");
    LinkError::Lost(error)
}
