//! [`LinkLog`]: decides which losses of the link are worth a warning.

use std::mem::{Discriminant, discriminant};
use std::time::Duration;

use tokio::time::Instant;

use crate::{Error, ErrorKind};

/// Least time between two logged losses of a link that flaps. It doubles with each.
const INTERVAL: (Duration, Duration) = (Duration::from_secs(10), Duration::from_secs(3600));
/// A link that lasted this long does not flap.
const STEADY: Duration = Duration::from_secs(600);

/// What was logged of the link. Each loss is logged, with each of its reasons, unless the link
/// flaps: then ever fewer are, with the number of losses.
#[derive(Debug, Default)]
pub(super) struct LinkLog {
    /// Kinds of reasons logged since the link was lost, each with the time of its last log line.
    reasons: Vec<(Discriminant<ErrorKind>, Instant)>,
    up_since: Option<Instant>,
    /// Number of losses since the latest logged one.
    losses: u32,
    /// When the latest loss was logged, and for how long no other one is.
    logged: Option<(Instant, Duration)>,
    /// True if the present loss is not logged.
    is_muted: bool,
}

impl LinkLog {
    /// Records a link. Returns true if it is worth a line.
    pub(super) fn connect(&mut self) -> bool {
        self.reasons.clear();
        self.up_since = Some(Instant::now());
        !std::mem::take(&mut self.is_muted)
    }

    /// Records that the link is lost, or still is. Returns true if that is worth a line.
    pub(super) fn lose(&mut self) -> bool {
        let now = Instant::now();
        if let Some(since) = self.up_since.take() {
            self.losses += 1;
            self.is_muted = true;
            self.logged = self.logged.filter(|_| now - since < STEADY);
        }
        let is_due = self.logged.is_none_or(|(at, interval)| now - at >= interval);
        if self.is_muted && is_due {
            self.is_muted = false;
            self.reasons.clear();
            let next = self.logged.map_or(INTERVAL.0, |(_, interval)| interval * 2);
            self.logged = Some((now, next.min(INTERVAL.1)));
        }
        !self.is_muted
    }

    /// Number of losses since the latest logged one, if there is more than the present one.
    pub(super) fn losses(&mut self) -> Option<u32> {
        Some(std::mem::take(&mut self.losses)).filter(|losses| *losses > 1)
    }

    /// Returns true once for each kind of reason, and again after `interval`.
    pub(super) fn is_due(&mut self, error: &Error, interval: Duration) -> bool {
        let (kind, now) = (discriminant(error.kind()), Instant::now());
        match self.reasons.iter_mut().find(|(known, _)| *known == kind) {
            Some((_, at)) if now - *at < interval => return false,
            Some((_, at)) => *at = now,
            None => self.reasons.push((kind, now)),
        }
        true
    }
}
