//! [`Identity`]: which sensor answers, by its replies to `V`. No checksum protects them: one flipped
//! bit must neither reject a sensor, nor become the expected number, nor move the times of a session.

use std::time::Duration;

use tokio::time::Instant;

use super::failure::{ExchangeError, LinkError};
use super::session::Session;
use crate::ErrorKind;
use crate::protocol::{Text, Version};
use crate::state::{Telemetry, VersionReply};

/// One revolution of a URG's motor, and the revolutions a minute.
const REVOLUTION: Duration = Duration::from_millis(100);
const NOMINAL_SPEED: u16 = 600;
/// Number of times to ask a sensor for its version until two replies agree. If no two do, the last
/// serial number counts, and no motor speed.
const TRIES: usize = 4;
/// When to ask the first sensor of a driver again: after the first scan of a service that polls at once.
const CONFIRMATION_DELAY: Duration = Duration::from_secs(1);

/// Identity of the sensor: what is expected, what is known, and what it replied.
#[derive(Default)]
pub(crate) struct Identity {
    /// Expected sensor: the one asked for, or the first one found.
    expected: Option<Text>,
    accepts_any: bool,
    /// Serial number of the sensor that was last found and confirmed.
    pub(crate) known: Option<Text>,
    /// Motor speed on which two replies have agreed, which may be that the sensor tells none.
    motor_speed: Option<Option<u16>>,
    /// Time of one revolution of the motor.
    pub(crate) scan_time: Duration,
    /// Replies of this session, until they are accepted.
    replies: Vec<VersionReply>,
    tries: usize,
    /// When to [`confirm`](Self::confirm) the sensor that is polled, unless it is known.
    pub(crate) confirm_at: Option<Instant>,
}

impl Identity {
    pub(crate) fn new(expected: Option<Text>, accepts_any: bool) -> Self {
        Self { expected, accepts_any, scan_time: REVOLUTION, ..Self::default() }
    }

    /// Reads the version of a sensor that was just found until the sensor is known. Fails if it is
    /// another sensor. The first sensor of a driver can be no other, so one reply will do for its
    /// first scan, and it is confirmed later.
    pub(crate) async fn find(&mut self, session: &mut Session) -> Result<(), ExchangeError> {
        (self.tries, self.confirm_at) = (0, None);
        self.replies.clear();
        let is_first = self.expected.is_none() && self.known.is_none();
        while !self.is_decided() {
            self.ask(session).await?;
            let speed = self.replies.last().and_then(|reply| motor_speed(&reply.version));
            // The speed that counts until it is known.
            if is_first && [None, Some(NOMINAL_SPEED)].contains(&speed) {
                break;
            }
        }
        let found = self.settled().or(self.replies.last());
        let found = found.map(|reply| reply.version.serial_number.clone()).unwrap_or_default();
        match self.expected.clone().filter(|expected| *expected != found) {
            Some(expected) => {
                Err(LinkError::Lost(ErrorKind::AnotherSensor { expected, found }).into())
            }
            None => Ok(()),
        }
    }

    /// Reads the version of a polled sensor until the sensor is known.
    pub(crate) async fn confirm(&mut self, session: &mut Session) -> Result<(), ExchangeError> {
        loop {
            match self.ask(session).await {
                Ok(()) | Err(ExchangeError::Command(_)) => self.accept(&session.telemetry),
                failure => return failure,
            }
            if self.confirm_at.is_none() || session.is_closing() {
                return Ok(());
            }
        }
    }

    async fn ask(&mut self, session: &mut Session) -> Result<(), ExchangeError> {
        self.tries += 1;
        self.replies.push(session.version().await?);
        Ok(())
    }

    /// Returns true if no further reply is needed.
    fn is_decided(&self) -> bool {
        let is_settled = self.settled().is_some() && self.settled_speed().is_some();
        is_settled || self.tries >= TRIES
    }

    /// Returns a reply whose serial number is known or repeats.
    fn settled(&self) -> Option<&VersionReply> {
        self.replies.iter().find(|reply| {
            let number = &reply.version.serial_number;
            // An empty serial number never confirms an expected one. A serial number with
            // unprintable bytes is malformed, even if it repeats.
            let counts = number.is_printable() && (self.expected.is_none() || !number.is_empty());
            let same = self.replies.iter().filter(|one| one.version.serial_number == *number);
            let is_known = self.known.as_ref() == Some(number);
            self.expected.as_ref() == Some(number) || counts && (is_known || same.count() > 1)
        })
    }

    /// Returns the motor speed that is known or repeats.
    fn settled_speed(&self) -> Option<Option<u16>> {
        let speeds = || self.replies.iter().map(|reply| motor_speed(&reply.version));
        speeds().find(|speed| {
            // A flipped bit in another speed hardly ever makes the nominal one.
            [self.motor_speed, Some(Some(NOMINAL_SPEED))].contains(&Some(*speed))
                || speeds().filter(|one| one == speed).count() > 1
        })
    }

    /// Accepts the sensor, now that it has the service's settings. If it is known, expects no other
    /// sensor from now on.
    pub(crate) fn accept(&mut self, telemetry: &Telemetry) {
        if !self.is_decided() {
            self.confirm_at = Some(Instant::now() + CONFIRMATION_DELAY);
            return;
        }
        self.confirm_at = None;
        let (settled, speed) = (self.settled().cloned(), self.settled_speed());
        let is_settled = settled.is_some();
        let Some(reply) = settled.or_else(|| self.replies.pop()) else { return };
        self.replies = Vec::new();
        let now = &reply.version.serial_number;
        if is_settled && !now.is_empty() && !self.accepts_any {
            self.expected.get_or_insert_with(|| now.clone());
        }
        let before = self.known.replace(now.clone());
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
        telemetry.set_version(reply);
    }
}

fn motor_speed(version: &Version) -> Option<u16> {
    version.specification.as_ref().and_then(|specification| specification.motor_speed)
}
