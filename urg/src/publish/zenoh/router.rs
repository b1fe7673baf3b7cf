//! Probes a router that can fail silently, and counts scans that it may not have received. Zenoh itself
//! closes the link to a silent router only after 10 s, and does not tell which messages were lost.

use std::net::{IpAddr, ToSocketAddrs, UdpSocket};
use std::sync::Arc;
use std::time::Duration;

use zenoh::qos::Priority;
use zenoh::{Session, Wait};

use crate::publish::topic::Counts;

/// Key that no program serves. Other programs' `**` does not match keys that start with `@`.
const PROBE_KEY: &str = "@urg/probe";

/// Time that the router has to answer.
const PROBE_TIMEOUT: Duration = Duration::from_secs(2);

/// Checks whether the router answers. Blocks for at most [`PROBE_TIMEOUT`].
pub(super) fn answers(session: &Session) -> bool {
    // A higher priority than scans, so that the probe does not wait behind them.
    let query = session.get(PROBE_KEY).priority(Priority::InteractiveHigh).timeout(PROBE_TIMEOUT);
    let Ok(replies) = query.wait() else { return false };
    // The router answers by closing the channel without a reply. A reply can only be the
    // timeout's error. Without a connection, the channel closes as well.
    replies.recv().is_err() && session.info().routers_zid().wait().next().is_some()
}

/// Local address that a new link to the router would have. Blocks while it looks up a name.
pub(super) fn local_address(locator: &str) -> Option<IpAddr> {
    let address = locator.strip_prefix("tcp/")?.split(['#', '?']).next()?;
    let router = address.to_socket_addrs().ok()?.next()?;
    let socket = UdpSocket::bind(if router.is_ipv6() { "[::]:0" } else { "0.0.0.0:0" }).ok()?;
    // Sends nothing: UDP has no connections.
    socket.connect(router).ok()?;
    Some(socket.local_addr().ok()?.ip())
}

/// Messages of one topic that the router may not have received yet.
pub(super) struct InTransit {
    counts: Arc<Counts>,
    /// Number of messages that the router has received for certain.
    arrived: u64,
    /// Number of messages published before the last answer.
    sent: u64,
}

impl InTransit {
    /// Counts from the next published message.
    pub(super) fn new(counts: &Arc<Counts>) -> Self {
        let published = counts.lock().published;
        Self { counts: Arc::clone(counts), arrived: published, sent: published }
    }

    /// Notes an answer of the router. It confirms all messages published before the previous
    /// answer. The probe may overtake later ones.
    pub(super) fn confirm(&mut self) {
        self.arrived = self.sent;
        self.sent = self.counts.lock().published;
    }

    pub(super) fn lose(&mut self) {
        let mut counted = self.counts.lock();
        counted.possibly_lost += counted.published.saturating_sub(self.arrived);
        (self.arrived, self.sent) = (counted.published, counted.published);
    }
}

impl Drop for InTransit {
    /// No answer confirms the last scans.
    fn drop(&mut self) {
        self.lose();
    }
}
