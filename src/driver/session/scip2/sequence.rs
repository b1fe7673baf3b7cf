//! [`Sequence`]: tells from the sensor's clock which scans of a stream are new, and how many are lost.

use std::time::Duration;

use tokio::time::Instant;

use super::super::super::transport::ReplyTimes;
use crate::protocol::scip2::Stamp;

/// Milliseconds after which the sensor's clock begins anew: 24 bits (p. 12).
const CLOCK: u32 = 1 << 24;
pub(super) const WRAP: Duration = Duration::from_millis(CLOCK as u64);
/// By how much a scan may be older than the latest one: with a larger step back the clock has likely jumped.
const OLDEST: Duration = Duration::from_secs(10);
/// How much more than the arrivals the sensor's clock may have moved on between two scans, because the
/// first was late. With a larger step it has more likely jumped.
const LONGEST_DELAY: Duration = Duration::from_secs(1);

/// Scans of all streams so far.
#[derive(Debug, Default)]
pub(super) struct Sequence {
    /// Clock and arrival of the latest scan, and how many are left out after it (`None`: any).
    latest: Option<(Stamp, Instant, Option<u8>)>,
    /// True if the latest has the stamp of the one before: it is a copy, or the clock stands still.
    pub(super) repeats: bool,
}

impl Sequence {
    /// Adds a scan. After each one, the sensor leaves out `skipped`. Returns the number of scans lost
    /// since the one before, or `None` for a copy and for a scan older than the latest.
    pub(super) fn add(
        &mut self,
        stamp: Stamp,
        times: &ReplyTimes,
        revolution: Duration,
        skipped: u8,
    ) -> Option<u64> {
        let before = self.latest.replace((stamp, times.received, Some(skipped)));
        let is_same = before.is_some_and(|(latest, ..)| latest == stamp);
        // One copy may come late. More than one are scans of a clock that stands still.
        let may_be_copy = !std::mem::replace(&mut self.repeats, is_same);
        let Some((latest, received, was_skipped)) = before else { return Some(0) };
        let since = times.began.duration_since(received);
        let is_soon = since < revolution / 2;
        // At its own time, it is the first scan after a jump of the clock.
        let is_old = is_soon && between(stamp, latest) < OLDEST;
        if is_old || is_same && (is_soon || may_be_copy) {
            self.latest = Some((latest, times.received, was_skipped));
            return None;
        }
        let passed = between(latest, stamp);
        if was_skipped != Some(skipped) || passed >= since + LONGEST_DELAY {
            return Some(0);
        }
        // Of the scans that the sensor has left out, none is lost.
        let period = revolution * (u32::from(skipped) + 1);
        let periods = (passed + period / 2).as_nanos() / period.as_nanos().max(1);
        Some((periods as u64).saturating_sub(1))
    }

    /// Counts no scan as lost before the next one.
    pub(super) fn allow_gap(&mut self) {
        self.latest = self.latest.map(|(stamp, received, _)| (stamp, received, None));
    }
}

/// Time from one stamp to a later one. [`WRAP`] or less if it is not later.
fn between(one: Stamp, later: Stamp) -> Duration {
    match (one, later) {
        (Stamp::Milliseconds(one), Stamp::Milliseconds(later)) => {
            Duration::from_millis((later.wrapping_sub(one) % CLOCK).into())
        }
        (one, later) => later.since_zero().checked_sub(one.since_zero()).unwrap_or(WRAP),
    }
}
