//! From a port's name to a sensor that is set as the service wants it.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, timeout};

use super::baud_rate;
use super::config::Config;
use super::exchange::ExchangeError;
use super::fence::UniqueRequests;
use super::laser::set_laser;
use super::session::Session;
use crate::port::{AnyConnect, Port};
use crate::protocol::{Text, Version};
use crate::state::Telemetry;
use crate::{BaudRate, Error};

/// A revolution of a URG's motor at 600 rpm.
const REVOLUTION: Duration = Duration::from_millis(100);
/// The number of times a sensor is asked for its serial number, if no two answers
/// in a row agree. The last answer then counts.
const IDENTITY_TRIES: usize = 4;

/// Opens the port, and restores how the sensor behind it was set.
pub(crate) struct Opener {
    connect: Box<dyn AnyConnect>,
    config: Config,
    telemetry: Arc<Telemetry>,
    wanted: Wanted,
    /// The baud rate at which the sensor was found last.
    found: Option<BaudRate>,
    /// The sensor that is expected: the one asked for, or the first one found.
    identity: Option<Text>,
    /// The serial number of the sensor that was found last.
    serial_number: Option<Text>,
    /// The requests of earlier sessions: the system keeps bytes that arrive while a
    /// port is closed, so the next session may read replies to them.
    unique_requests: UniqueRequests,
    /// True after a sensor was opened once.
    opened: bool,
    scan_time: Duration,
}

/// The settings that the service has asked for, restored whenever the sensor may
/// have lost them.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted {
    pub(crate) laser: Option<bool>,
    pub(crate) baud_rate: Option<BaudRate>,
}

impl Opener {
    pub(crate) fn new(
        connect: Box<dyn AnyConnect>,
        config: Config,
        telemetry: Arc<Telemetry>,
    ) -> Self {
        let asked = connect.expected_serial_number().map(Text::from);
        Self {
            wanted: Wanted { laser: None, baud_rate: config.baud_rate },
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

    pub(crate) fn wanted(&mut self) -> &mut Wanted {
        &mut self.wanted
    }

    /// The serial number of the sensor that was found last.
    pub(crate) fn serial_number(&self) -> Text {
        self.serial_number.clone().unwrap_or_default()
    }

    /// The time of a revolution of the motor, as the sensor's version reports it.
    pub(crate) fn scan_time(&self) -> Duration {
        self.scan_time
    }

    /// Opens the port and finds the sensor, trying one port after another where
    /// there are several.
    pub(crate) async fn open(&mut self) -> Result<Session, Error> {
        loop {
            let outcome = match timeout(self.config.open_timeout, self.connect.connect()).await {
                Ok(Ok(port)) => self.open_on(port).await,
                Ok(Err(error)) => return Err(self.fail(error)),
                Err(_) => {
                    let port = self.connect.name().unwrap_or("the port");
                    Err(Error::open(port, io::ErrorKind::TimedOut.into()))
                }
            };
            match outcome {
                Err(error) if self.connect.has_more() => {
                    tracing::trace!(error = %error.chain(), "port skipped");
                }
                outcome => return outcome.map_err(|error| self.fail(error)),
            }
        }
    }

    /// Logs the error of an attempt, and returns it with the name of the sensor. At
    /// trace: a driver that waits for its sensor tries once a second, and the state logs
    /// each reason once.
    fn fail(&self, error: Error) -> Error {
        tracing::trace!(error = %error.chain(), "opening failed");
        error.named(self.telemetry.name())
    }

    async fn open_on(&mut self, port: Box<dyn Port>) -> Result<Session, Error> {
        let telemetry = Arc::clone(&self.telemetry);
        let unique_requests = std::mem::take(&mut self.unique_requests);
        let Config { observer, reply_latency, .. } = &self.config;
        let observer = observer.clone();
        let mut session = Session::new(port, *reply_latency, observer, unique_requests, telemetry);
        match self.find(&mut session, self.config.open_timeout).await {
            Ok(()) => Ok(session),
            Err(error) => {
                self.close(session);
                Err(error)
            }
        }
    }

    /// Closes the port of a session.
    pub(crate) fn close(&mut self, session: Session) {
        self.unique_requests = session.close();
    }

    /// Finds the sensor again on a port that is still open.
    pub(crate) async fn find_again(&mut self, session: &mut Session) -> Result<(), Error> {
        // One pass over the baud rates; a port that brings nothing is reopened.
        self.find(session, self.config.open_timeout / 2).await
    }

    async fn find(&mut self, session: &mut Session, limit: Duration) -> Result<(), Error> {
        let outcome = async {
            baud_rate::find(session, &self.baud_rates(), Instant::now() + limit).await?;
            let version = self.identify(session).await?;
            self.restore(session).await?;
            Ok(version)
        };
        let version = outcome.await.map_err(ExchangeError::into_error)?;
        let before = self.serial_number.replace(version.serial_number.clone());
        if let Some(before) = before.filter(|before| *before != version.serial_number) {
            tracing::warn!(%before, now = %version.serial_number, "another sensor has taken its place");
        }
        self.telemetry.set_version(version);
        self.connect.found();
        self.found = session.baud_rate();
        self.opened = true;
        Ok(())
    }

    /// Returns all six, the likeliest first.
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

    /// Reads the sensor's version, and fails if it is another sensor.
    async fn identify(&mut self, session: &mut Session) -> Result<Version, ExchangeError> {
        let version = self.confirm_identity(session).await?;
        let found = &version.serial_number;
        if let Some(expected) = self.identity.as_ref().filter(|expected| *expected != found) {
            let (expected, found) = (expected.clone(), found.clone());
            return Err(ExchangeError::Lost(Error::AnotherSensor {
                sensor: None,
                expected,
                found,
            }));
        }
        let motor_speed =
            version.specification.as_ref().and_then(|specification| specification.motor_speed);
        if let Some(revolutions_per_minute) = motor_speed {
            self.scan_time = Duration::from_secs(60) / u32::from(revolutions_per_minute.max(1));
        }
        Ok(version)
    }

    /// Reads the version until its serial number is the expected one or comes
    /// twice in a row, [`IDENTITY_TRIES`] times at most. No checksum protects it:
    /// one flipped bit must neither reject a sensor nor be expected ever after.
    async fn confirm_identity(&mut self, session: &mut Session) -> Result<Version, ExchangeError> {
        let mut version = session.version().await?;
        for _ in 1..IDENTITY_TRIES {
            if self.identity.as_ref() == Some(&version.serial_number) {
                break;
            }
            let before = version.serial_number;
            version = session.version().await?;
            // An empty serial number never counts as confirmed where one is expected, and one
            // with a byte that no text has is malformed, even if it comes twice.
            let counts = before.is_printable() && (self.identity.is_none() || !before.is_empty());
            if counts && version.serial_number == before {
                if !before.is_empty() && !self.config.any_sensor {
                    self.identity.get_or_insert(before);
                }
                break;
            }
        }
        Ok(version)
    }

    /// Restores the settings that the service has asked for.
    async fn restore(&mut self, session: &mut Session) -> Result<(), ExchangeError> {
        if let Some(baud_rate) = self.wanted.baud_rate
            && session.baud_rate().is_some_and(|now| now != baud_rate)
        {
            match baud_rate::change(session, baud_rate).await {
                // Scans at another baud rate are better than none.
                Err(ExchangeError::Command(error)) if self.opened => {
                    tracing::warn!(error = %error.chain(), "the baud rate is not restored");
                }
                outcome => outcome?,
            }
        }
        if let Some(on) = self.wanted.laser {
            set_laser(session, on).await?;
        }
        Ok(())
    }
}
