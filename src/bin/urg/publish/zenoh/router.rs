//! The probe that shows that the router answers, and the count of scans that it may not
//! have received: zenoh itself closes the link to a silent router only after 10 s, and does
//! not report the messages that were lost with it.

use std::sync::Arc;
use std::time::Duration;

use zenoh::qos::Priority;
use zenoh::{Session, Wait};

use crate::publish::counts::ScanCounts;

/// A key that nobody has: `**` of other programs does not match it.
const PROBE_KEY: &str = "@urg/probe";

/// A router that answers later counts as lost.
const PROBE_TIMEOUT: Duration = Duration::from_secs(2);

/// Returns true if the router answers. Blocks until it does, at most for the timeout.
pub(super) fn answers(session: &Session) -> bool {
    // With a priority of its own, so that it does not wait behind scans.
    let query = session.get(PROBE_KEY).priority(Priority::InteractiveHigh).timeout(PROBE_TIMEOUT);
    let Ok(replies) = query.wait() else { return false };
    // An answer is the end of all replies. The only reply that there can be is the
    // timeout's error. Without a connection, too, there is none.
    replies.recv().is_err() && session.info().routers_zid().wait().next().is_some()
}

/// The scans of one node that the router may not have received yet.
pub(super) struct InTransit {
    counts: Arc<ScanCounts>,
    /// The number of scans that the router has received.
    arrived: u64,
    /// The number of scans that were published at the last answer.
    sent: u64,
}

impl InTransit {
    /// Starts with what is published from now on.
    pub(super) fn new(counts: Arc<ScanCounts>) -> Self {
        let published = counts.published();
        Self { counts, arrived: published, sent: published }
    }

    /// Notes an answer of the router: it has received all scans that were published before
    /// the previous answer. A probe may overtake those that were published since.
    pub(super) fn confirm(&mut self) {
        self.arrived = self.sent;
        self.sent = self.counts.published();
    }

    /// Counts what is in transit as possibly lost.
    pub(super) fn lose(&mut self) {
        let published = self.counts.published();
        self.counts.add_possibly_lost(published.saturating_sub(self.arrived));
        (self.arrived, self.sent) = (published, published);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn publish(counts: &ScanCounts, scans: usize) {
        (0..scans).for_each(|_| counts.add_published());
    }

    #[test]
    fn what_was_published_since_the_answer_before_the_last_is_possibly_lost_once() {
        let counts = Arc::new(ScanCounts::default());
        publish(&counts, 100);
        let mut transit = InTransit::new(Arc::clone(&counts));
        publish(&counts, 10);
        transit.confirm();
        publish(&counts, 5);
        transit.confirm();
        publish(&counts, 3);
        transit.lose();
        assert_eq!(counts.possibly_lost(), 8);
        transit.lose();
        assert_eq!(counts.possibly_lost(), 8);
        publish(&counts, 2);
        transit.lose();
        assert_eq!(counts.possibly_lost(), 10);
    }
}
