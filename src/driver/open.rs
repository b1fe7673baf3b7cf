//! From a port's name to a sensor that is set as the service wants it.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, timeout};

use super::Config;
use super::line;
use super::session::{Failure, Session};
use super::unique_requests::UniqueRequests;
use crate::port::Connect;
use crate::protocol::{Command, Text, Version};
use crate::state::Telemetry;
use crate::{BaudRate, Error};

/// A turn of a URG's motor at 600 rpm.
const TURN: Duration = Duration::from_millis(100);
/// How often a sensor is asked for its serial number before the last answer
/// counts.
const INTRODUCTIONS: usize = 4;

/// Opens the port, and brings the sensor behind it to where it was.
pub(crate) struct Opener<C> {
    connect: C,
    config: Config,
    telemetry: Arc<Telemetry>,
    wanted: Wanted,
    /// The speed at which the sensor was found last.
    found: Option<BaudRate>,
    /// The sensor that is expected: the one asked for, or the first one found.
    identity: Option<Text>,
    /// What earlier sessions asked for: the system keeps what arrives while a
    /// port is closed, so that the next session may get answers to it.
    unique_requests: UniqueRequests,
    /// Whether a sensor was ever opened.
    opened: bool,
    scan_time: Duration,
}

/// What the service has asked for, to be restored whenever the sensor may have
/// forgotten it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted {
    pub(crate) laser: Option<bool>,
    pub(crate) baud_rate: Option<BaudRate>,
}

impl<C: Connect> Opener<C> {
    pub(crate) fn new(connect: C, config: Config, telemetry: Arc<Telemetry>) -> Self {
        let asked = connect.expected_serial_number().map(Text::from);
        Self {
            wanted: Wanted { laser: None, baud_rate: config.baud_rate },
            found: None,
            identity: config.serial_number.clone().or(asked),
            unique_requests: UniqueRequests::starting(config.seed()),
            opened: false,
            scan_time: TURN,
            connect,
            config,
            telemetry,
        }
    }

    pub(crate) fn wanted(&mut self) -> &mut Wanted {
        &mut self.wanted
    }

    /// A turn of the motor, as the sensor says.
    pub(crate) fn scan_time(&self) -> Duration {
        self.scan_time
    }

    /// Opens the port and finds the sensor, trying one port after another where
    /// there are several.
    pub(crate) async fn open(&mut self) -> Result<Session, Error> {
        loop {
            let outcome = match timeout(self.config.open_timeout, self.connect.connect()).await {
                Ok(port) => self.open_on(port?).await,
                Err(_) => {
                    let source = Arc::new(io::ErrorKind::TimedOut.into());
                    Err(Error::Open { port: "the port".to_owned(), source })
                }
            };
            match outcome {
                Err(error) if self.connect.has_more() => {
                    tracing::debug!(%error, "not this port");
                }
                outcome => return outcome,
            }
        }
    }

    async fn open_on(&mut self, port: C::Port) -> Result<Session, Error> {
        let telemetry = Arc::clone(&self.telemetry);
        let unique_requests = std::mem::take(&mut self.unique_requests);
        let framed = line::framed(Box::new(port), self.config.observer.clone());
        let mut session =
            Session::new(framed, self.config.reply_latency, unique_requests, telemetry);
        match self.find(&mut session, self.config.open_timeout).await {
            Ok(()) => Ok(session),
            Err(error) => {
                self.close(session);
                Err(error)
            }
        }
    }

    /// Closes the port of a session that is of no use any more.
    pub(crate) fn close(&mut self, session: Session) {
        self.unique_requests = session.close();
    }

    /// Finds the sensor again on a port that is still open.
    pub(crate) async fn find_again(&mut self, session: &mut Session) -> Result<(), Error> {
        // One pass over the speeds; a port that brings nothing is reopened.
        self.find(session, self.config.open_timeout / 2).await
    }

    async fn find(&mut self, session: &mut Session, limit: Duration) -> Result<(), Error> {
        let outcome = async {
            session.find(&self.baud_rates(), Instant::now() + limit).await?;
            let version = self.identify(session).await?;
            self.restore(session).await?;
            Ok(version)
        };
        let version = outcome.await.map_err(|failure| match failure {
            Failure::Command(error) | Failure::Silent(error) | Failure::Line(error) => error,
        })?;
        self.telemetry.set_version(version);
        self.connect.found();
        self.found = session.baud_rate();
        self.opened = true;
        Ok(())
    }

    /// All six, the likeliest first.
    fn baud_rates(&self) -> Vec<BaudRate> {
        let likely = self.found.into_iter().chain(self.wanted.baud_rate).chain([BaudRate::B19200]);
        let mut baud_rates = Vec::with_capacity(BaudRate::ALL.len());
        for baud_rate in likely.chain(BaudRate::ALL) {
            if !baud_rates.contains(&baud_rate) {
                baud_rates.push(baud_rate);
            }
        }
        baud_rates
    }

    /// Asks who the sensor is, and makes sure that it is the right one.
    async fn identify(&mut self, session: &mut Session) -> Result<Version, Failure> {
        let version = self.confirm_identity(session).await?;
        let found = &version.serial_number;
        if let Some(expected) = self.identity.as_ref().filter(|expected| *expected != found) {
            let (expected, found) = (expected.clone(), found.clone());
            return Err(Failure::Line(Error::AnotherSensor { expected, found }));
        }
        let motor_speed =
            version.specification.as_ref().and_then(|specification| specification.motor_speed);
        if let Some(revolutions_per_minute) = motor_speed {
            self.scan_time = Duration::from_secs(60) / u32::from(revolutions_per_minute.max(1));
        }
        Ok(version)
    }

    /// Asks until the serial number can be believed, for a while: it is the
    /// expected one, or comes twice in a row. Nothing else protects it, and one
    /// flipped bit must neither turn a sensor away nor be expected ever after.
    async fn confirm_identity(&mut self, session: &mut Session) -> Result<Version, Failure> {
        let mut version = ask_version(session).await?;
        for _ in 1..INTRODUCTIONS {
            if self.identity.as_ref() == Some(&version.serial_number) {
                break;
            }
            let before = version.serial_number;
            version = ask_version(session).await?;
            // None at all where one is expected is damage, even twice.
            let counts = self.identity.is_none() || !before.is_empty();
            if counts && version.serial_number == before {
                if !before.is_empty() {
                    self.identity.get_or_insert(before);
                }
                break;
            }
        }
        Ok(version)
    }

    /// Sets the sensor as the service has asked for.
    async fn restore(&mut self, session: &mut Session) -> Result<(), Failure> {
        if let Some(baud_rate) = self.wanted.baud_rate
            && session.baud_rate().is_some_and(|now| now != baud_rate)
        {
            match session.change_baud_rate(baud_rate).await {
                // Scans at another speed are better than none.
                Err(Failure::Command(error)) if self.opened => {
                    tracing::warn!(%error, "the baud rate is not restored");
                }
                outcome => outcome?,
            }
        }
        if let Some(on) = self.wanted.laser {
            session.set_laser(on).await?;
        }
        Ok(())
    }
}

async fn ask_version(session: &mut Session) -> Result<Version, Failure> {
    let (version, _) = session.command_twice(Command::Version, Version::from_reply).await?;
    Ok(version)
}
