//! [`Shared`]: what a driver and its handles share.

use std::sync::Arc;

use super::counters::Counters;
use super::link_state::LinkState;
use super::{Freshness, State};
use crate::{Error, ErrorKind};

/// Written by the driver and read by its handles, but for `closing`.
#[derive(Debug)]
pub(crate) struct Shared {
    pub(crate) link: LinkState,
    pub(crate) counters: Counters,
    /// Held by each handle that waits for the driver to close. If its caller drops that future, the
    /// driver continues, so a `CancellationToken` does not fit: it stays cancelled.
    closing: Arc<()>,
}

impl Shared {
    pub(crate) fn new(name: Option<Arc<str>>) -> Self {
        Self { link: LinkState::new(name), counters: Counters::default(), closing: Arc::default() }
    }

    /// Tells the driver that a handle waits for its end, until the guard is dropped.
    #[must_use]
    pub(crate) fn announce_closing(&self) -> Arc<()> {
        Arc::clone(&self.closing)
    }

    /// Returns true while the driver is closing. A silent sensor then gets no second try.
    pub(crate) fn is_closing(&self) -> bool {
        Arc::strong_count(&self.closing) > 1
    }

    /// Enters a state. Its error is also why there is no scan.
    pub(crate) fn enter(&self, state: State) {
        self.link.enter(state);
        if let Some(error) = self.link.trouble() {
            self.counters.fail(error);
        }
    }

    pub(crate) fn freshness(&self) -> Freshness {
        let reason = self.pause_reason();
        let counted = self.counters.lock();
        Freshness::new(counted.last_scan, reason.or_else(|| counted.error.clone()))
    }

    /// Why nothing is polled now, if so.
    pub(crate) fn pause_reason(&self) -> Option<Error> {
        let is_laser_off = self.counters.lock().is_laser_off;
        let laser_off = || is_laser_off.then(|| self.link.error(ErrorKind::LaserOff));
        self.link.trouble().or_else(laser_off)
    }
}
