//! From a port's name to a sensor that is set as the service wants it.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, timeout};

use super::Config;
use super::session::{Failure, Session};
use crate::port::Connect;
use crate::protocol::{Command, Text, Version};
use crate::state::Telemetry;
use crate::{BaudRate, Error};

/// A turn of a URG's motor at 600 rpm.
const TURN: Duration = Duration::from_millis(100);

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
    /// Whether a sensor was ever opened.
    opened: bool,
    scan_time: Duration,
}

/// What the service has asked for, to be restored whenever the sensor may have
/// forgotten it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted {
    pub(crate) laser: Option<bool>,
    pub(crate) speed: Option<BaudRate>,
}

impl<C: Connect> Opener<C> {
    pub(crate) fn new(connect: C, config: Config, telemetry: Arc<Telemetry>) -> Self {
        let asked = connect.expected_serial_number().map(Text::from);
        Self {
            wanted: Wanted { laser: None, speed: config.baud_rate },
            found: None,
            identity: config.serial_number.clone().or(asked),
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
            let outcome = self.open_one().await;
            match outcome {
                Err(
                    Error::AnotherSensor { .. }
                    | Error::NoAnswer { .. }
                    | Error::WrongProtocol { .. }
                    | Error::Loopback
                    | Error::Disconnected { .. },
                ) if self.connect.has_more() => {}
                outcome => return outcome,
            }
        }
    }

    async fn open_one(&mut self) -> Result<Session, Error> {
        let limit = self.config.open_timeout;
        let port = match timeout(limit, self.connect.connect()).await {
            Ok(port) => port?,
            Err(_) => {
                let source = Arc::new(io::ErrorKind::TimedOut.into());
                return Err(Error::Open { port: "the port".to_owned(), source });
            }
        };
        let telemetry = Arc::clone(&self.telemetry);
        let mut session = Session::new(Box::new(port), &self.config, telemetry);
        self.find(&mut session, limit).await?;
        Ok(session)
    }

    /// Finds the sensor again on a port that is still open.
    pub(crate) async fn find_again(&mut self, session: &mut Session) -> Result<(), Error> {
        // One pass over the speeds; a port that brings nothing is reopened.
        self.find(session, self.config.open_timeout / 2).await
    }

    async fn find(&mut self, session: &mut Session, limit: Duration) -> Result<(), Error> {
        let outcome = async {
            session.find(&self.speeds(session), Instant::now() + limit).await?;
            self.identify(session).await?;
            self.restore(session).await
        };
        outcome.await.map_err(|failure| match failure {
            Failure::Command(error) | Failure::Silent(error) | Failure::Line(error) => error,
        })?;
        self.connect.found();
        self.found = session.line_speed();
        self.opened = true;
        Ok(())
    }

    /// All six, the likeliest first.
    fn speeds(&self, session: &Session) -> Vec<BaudRate> {
        let mut speeds = Vec::with_capacity(9);
        speeds.extend(self.found);
        speeds.extend(self.wanted.speed);
        speeds.push(BaudRate::B19200);
        speeds.extend(BaudRate::ALL);
        // Where the port's speed is fixed there is but one.
        speeds.extend(session.line_speed());
        let mut seen = Vec::with_capacity(speeds.len());
        speeds.retain(|speed| {
            !seen.contains(speed) && {
                seen.push(*speed);
                true
            }
        });
        speeds
    }

    /// Asks who the sensor is.
    async fn identify(&mut self, session: &mut Session) -> Result<(), Failure> {
        let mut version = ask_version(session).await?;
        if let Some(expected) = &self.identity {
            // A flipped bit must not turn a sensor away.
            if version.serial_number != *expected {
                version = ask_version(session).await?;
            }
            if version.serial_number != *expected {
                let (expected, found) = (expected.clone(), version.serial_number);
                return Err(Failure::Line(Error::AnotherSensor { expected, found }));
            }
        } else if !version.serial_number.is_empty() {
            self.identity = Some(version.serial_number.clone());
        }
        let speed =
            version.specification.as_ref().and_then(|specification| specification.motor_speed);
        if let Some(turns_a_minute) = speed {
            self.scan_time = Duration::from_secs(60) / u32::from(turns_a_minute.max(1));
        }
        self.telemetry.set_version(version);
        Ok(())
    }

    /// Sets the sensor as the service has asked for.
    async fn restore(&mut self, session: &mut Session) -> Result<(), Failure> {
        if let Some(speed) = self.wanted.speed
            && session.line_speed().is_some()
        {
            match session.change_speed(speed).await {
                // Scans at another speed are better than none.
                Err(Failure::Command(error)) if self.opened => {
                    tracing::warn!(%error, "the line speed is not restored");
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
