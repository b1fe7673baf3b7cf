//! Identifies the sensor. No checksum protects a reply to `V`, and one of `VV` does not see every bit:
//! one flipped bit must neither reject a sensor nor change its number, directions or times.

use std::sync::Arc;

use super::super::failure::ExchangeError;
use super::{Identity, Session};
use crate::Geometry;
use crate::protocol::{Specification, Text};
use crate::state::VersionReply;

/// Number of times to ask a sensor for its version until two replies agree. If no two do, the last
/// serial number counts, and no geometry.
const TRIES: usize = 4;
/// Bracket of almost all firmware lines. A flipped bit in another one hardly ever makes this one.
const USUAL: Specification = Specification {
    range: Some(20..=4095),
    aperture: Some(240),
    steps: Some(44..=725),
    motor_speed: Some(600),
};

impl Session {
    /// Reads the version until its serial number and geometry are the expected ones, or the same in
    /// two replies. One reply is enough on a port that delivers all bytes intact.
    pub(crate) async fn identify(
        &mut self,
        expected_number: Option<&Text>,
        expected_geometry: Option<Geometry>,
    ) -> Result<Identity, ExchangeError> {
        let enough = if self.delivers_intact() { 1 } else { 2 };
        let told = match self.scip2() {
            Some(mut scip2) => Some(scip2.parameters().await?),
            None => None,
        };
        let parameters = told.map(Arc::new);
        let told = parameters.as_ref().map(|reply| reply.parameters.geometry());
        let mut replies = Vec::new();
        loop {
            let latest = self.version().await?;
            replies.push(latest.clone());
            let confirmed = find_number(&replies, enough, expected_number);
            let geometry = told.or_else(|| find_geometry(&replies, enough, expected_geometry));
            if confirmed.is_some() && geometry.is_some() || replies.len() == TRIES {
                let reply = confirmed.cloned();
                let is_serial_number_confirmed =
                    reply.as_ref().is_some_and(|reply| !reply.version.serial_number.is_empty());
                let reply = VersionReply { parameters, ..reply.unwrap_or(latest) };
                return Ok(Identity { reply, is_serial_number_confirmed, geometry });
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
        // An empty serial number never replaces an expected one. An unprintable one is malformed.
        let can_be_new = number.is_printable() && (expected.is_none() || !number.is_empty());
        let same = replies.iter().filter(|other| other.version.serial_number == *number);
        expected == Some(number) || can_be_new && same.count() >= enough
    })
}

/// Finds the geometry that is the expected one, the usual one, or the same in `enough` replies.
fn find_geometry(
    replies: &[VersionReply],
    enough: usize,
    expected: Option<Geometry>,
) -> Option<Geometry> {
    // Older firmware has no bracket.
    let brackets =
        || replies.iter().map(|reply| reply.version.specification.clone().unwrap_or_default());
    let found = brackets().find(|bracket| {
        let same = brackets().filter(|other| other == bracket);
        *bracket == USUAL || expected == Some(Geometry::in_scip1(bracket)) || same.count() >= enough
    });
    found.as_ref().map(Geometry::in_scip1)
}
