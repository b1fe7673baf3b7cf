//! [`Shared`]: what a driver and its handles share.

use std::sync::Arc;

use super::closing::Closing;
use super::counters::Counters;
use super::link_state::LinkState;
use super::{Freshness, State};
use crate::{Error, ErrorKind};

/// Written by the driver and read by its handles, but for `closing`.
#[derive(Debug)]
pub(crate) struct Shared {
    pub(crate) link: LinkState,
    pub(crate) counters: Counters,
    pub(crate) closing: Closing,
}

impl Shared {
    pub(crate) fn new(name: Option<Arc<str>>) -> Self {
        let (counters, closing) = (Counters::default(), Closing::default());
        Self { link: LinkState::new(name), counters, closing }
    }

    /// Enters a state. Its error is also why there is no scan.
    pub(crate) fn enter(&self, state: State) {
        self.link.enter(state);
        if let Some(error) = self.link.trouble() {
            self.counters.fail(error);
        }
    }

    /// Freshness of all scans.
    pub(crate) fn freshness(&self) -> Freshness {
        let reason = self.pause_reason();
        let counted = self.counters.stats();
        Freshness::new(counted.last_scan, reason.or_else(|| counted.error.clone()))
    }

    /// Why nothing is polled now, if so.
    pub(crate) fn pause_reason(&self) -> Option<Error> {
        let is_laser_off = self.counters.stats().is_laser_off;
        let laser_off = || is_laser_off.then(|| self.link.error(ErrorKind::LaserOff));
        self.link.trouble().or_else(laser_off)
    }
}
