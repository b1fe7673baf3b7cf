//! Identifies the sensor. No checksum protects a reply to `V`, and one of `VV` does not see every
//! bit: one flipped bit must neither reject a sensor, nor become the expected number, nor move the
//! times of a session.

use std::sync::Arc;

use super::super::failure::ExchangeError;
use super::{Identity, MotorSpeed, Session};
use crate::Geometry;
use crate::protocol::scip2::Parameters;
use crate::protocol::{Text, Version};
use crate::state::VersionReply;

/// Number of times to ask a sensor for its version until two replies agree. If no two do, the last
/// serial number counts, and no motor speed.
const TRIES: usize = 4;
/// Speed of almost all motors. A flipped bit in another speed hardly ever makes this one.
const NOMINAL_SPEED: MotorSpeed = MotorSpeed::RevolutionsPerMinute(600);

impl Session {
    /// Reads the version until its serial number and motor speed are the expected ones, or the same
    /// in two replies. One reply is enough on a port that delivers all bytes intact.
    pub(crate) async fn identify(
        &mut self,
        expected_number: Option<&Text>,
        expected_speed: Option<MotorSpeed>,
    ) -> Result<Identity, ExchangeError> {
        let enough = if self.delivers_intact() { 1 } else { 2 };
        let told = match self.scip2() {
            Some(mut scip2) => Some(scip2.parameters().await?),
            None => None,
        };
        let parameters = told.map(Arc::new);
        let told = parameters.as_ref().map(|reply| &reply.parameters);
        let geometry = told.map_or(Geometry::URG_04LX, Parameters::geometry);
        let told = told.map(|told| MotorSpeed::RevolutionsPerMinute(told.motor_speed));
        let mut replies = Vec::new();
        loop {
            let latest = self.version().await?;
            replies.push(latest.clone());
            let confirmed = find_number(&replies, enough, expected_number);
            let motor_speed = told.or_else(|| find_speed(&replies, enough, expected_speed));
            if confirmed.is_some() && motor_speed.is_some() || replies.len() == TRIES {
                let reply = confirmed.cloned();
                let is_serial_number_confirmed =
                    reply.as_ref().is_some_and(|reply| !reply.version.serial_number.is_empty());
                let reply = VersionReply { parameters, ..reply.unwrap_or(latest) };
                return Ok(Identity { reply, is_serial_number_confirmed, motor_speed, geometry });
            }
        }
    }

    /// Reads the version once.
    async fn version(&mut self) -> Result<VersionReply, ExchangeError> {
        match self.scip2() {
            Some(mut scip2) => scip2.version().await,
            None => self.scip1.version().await,
        }
    }
}

/// Finds the reply whose serial number is the expected one, or the same in `enough` replies.
fn find_number<'a>(
    replies: &'a [VersionReply],
    enough: usize,
    expected: Option<&Text>,
) -> Option<&'a VersionReply> {
    replies.iter().find(|reply| {
        let number = &reply.version.serial_number;
        // An empty serial number never replaces an expected one. One with unprintable bytes is
        // malformed, even if it repeats.
        let can_be_new = number.is_printable() && (expected.is_none() || !number.is_empty());
        let same = replies.iter().filter(|other| other.version.serial_number == *number);
        expected == Some(number) || can_be_new && same.count() >= enough
    })
}

/// Finds the motor speed that is the expected one, the nominal one, or the same in `enough` replies.
fn find_speed(
    replies: &[VersionReply],
    enough: usize,
    expected: Option<MotorSpeed>,
) -> Option<MotorSpeed> {
    let speeds = || replies.iter().map(|reply| motor_speed(&reply.version));
    speeds().find(|speed| {
        let same = speeds().filter(|other| other == speed);
        *speed == NOMINAL_SPEED || expected == Some(*speed) || same.count() >= enough
    })
}

fn motor_speed(version: &Version) -> MotorSpeed {
    let speed = version.specification.as_ref().and_then(|specification| specification.motor_speed);
    speed.map_or(MotorSpeed::Untold, MotorSpeed::RevolutionsPerMinute)
}
