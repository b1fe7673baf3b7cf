//! Server behind `urg serve`: the page, the streams and their routes.

mod codes;
mod figures;
mod hosts;
mod hub;
mod line;
mod metrics;
mod page;
mod playback;
mod response;
mod routes;
mod scans;
mod server;
mod source;
mod state;

use std::sync::Arc;

use tokio::sync::Semaphore;

pub(crate) use self::hosts::Hosts;
pub(crate) use self::server::serve;
pub(crate) use self::source::SiteSource;
use crate::interrupt::Interrupt;

/// Maximum number of open connections. Each takes at most 40 KiB. A further connection takes the
/// place of the oldest one that has not sent its request, or waits for a place.
const MAX_CONNECTIONS: usize = 512;
/// Maximum number of open streams of scans: they last, and short requests need connections, too.
const MAX_STREAMS: usize = MAX_CONNECTIONS - 64;

#[derive(Debug)]
pub(crate) struct Site {
    sources: Vec<Arc<SiteSource>>,
    hosts: Hosts,
    interrupt: Interrupt,
    /// Each open stream of scans holds a permit.
    streams: Arc<Semaphore>,
}

impl Site {
    pub(crate) fn new(
        sources: Vec<Arc<SiteSource>>,
        hosts: Hosts,
        interrupt: &Interrupt,
    ) -> Arc<Self> {
        let streams = Arc::new(Semaphore::new(MAX_STREAMS));
        Arc::new(Self { sources, hosts, interrupt: interrupt.clone(), streams })
    }

    fn viewers(&self) -> usize {
        MAX_STREAMS - self.streams.available_permits()
    }
}
