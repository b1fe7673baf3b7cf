//! Server behind `urg serve`: the page, the streams and their routes.

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

pub(crate) use self::server::serve;
pub(crate) use self::source::SiteSource;
use crate::interrupt::Interrupt;

#[derive(Debug)]
pub(crate) struct Site {
    sources: Vec<Arc<SiteSource>>,
    /// True if only this machine can reach the address.
    is_loopback: bool,
    interrupt: Interrupt,
    /// Each open stream of scans holds a clone.
    viewers: Arc<()>,
}

impl Site {
    pub(crate) fn new(
        sources: Vec<Arc<SiteSource>>,
        is_loopback: bool,
        interrupt: &Interrupt,
    ) -> Arc<Self> {
        let (interrupt, viewers) = (interrupt.clone(), Arc::default());
        Arc::new(Self { sources, is_loopback, interrupt, viewers })
    }

    fn viewers(&self) -> usize {
        Arc::strong_count(&self.viewers) - 1
    }
}
