//! Connections: how many there may be, how long they may take, and which one is
//! closed to make room for a new one.

use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;
use tokio::task::JoinSet;

use crate::interrupt::Interrupt;

/// So many connections may be open at a time. A new one takes the place of one that
/// serves no stream of scans.
const MAX_CONNECTIONS: usize = 128;
/// The longest time for the head of a request, and between two requests.
const HEAD_TIMEOUT: Duration = Duration::from_secs(30);
/// The size of the buffers for the head of a request, and for the part of a
/// response that the system does not take yet.
const BUFFER_BYTES: usize = 16 * 1024;
/// The pause after a connection could not be accepted, as with too many open
/// files.
const ACCEPT_BACKOFF: Duration = Duration::from_millis(100);

/// A connection, as its handlers and the server see it.
#[derive(Debug)]
pub(super) struct Connection {
    pub(super) address: IpAddr,
    /// Set while it serves a stream of scans.
    is_viewer: AtomicBool,
    closed: Notify,
}

impl Connection {
    fn new(address: IpAddr) -> Arc<Self> {
        Arc::new(Self { address, is_viewer: AtomicBool::new(false), closed: Notify::new() })
    }

    /// Marks the connection as one that serves a stream of scans, or not.
    pub(super) fn set_viewer(&self, is_viewer: bool) {
        self.is_viewer.store(is_viewer, Ordering::Relaxed);
    }

    fn is_viewer(&self) -> bool {
        self.is_viewer.load(Ordering::Relaxed)
    }

    /// Closes the connection, whatever it is doing.
    pub(super) fn close(&self) {
        self.closed.notify_one();
    }
}

/// Serves until the user stops the program, and then until all connections have
/// ended.
pub(super) async fn serve(listener: TcpListener, router: Router, interrupt: &Interrupt) {
    let mut connections = Connections::default();
    loop {
        let stream = tokio::select! {
            _ = interrupt.requested() => break,
            Some(_) = connections.tasks.join_next() => continue,
            accepted = listener.accept() => match accepted {
                Ok((stream, _)) => stream,
                Err(error) => {
                    tracing::warn!(%error, "cannot accept a connection");
                    tokio::time::sleep(ACCEPT_BACKOFF).await;
                    continue;
                }
            },
        };
        let Ok(address) = stream.peer_addr() else { continue };
        if connections.make_room() {
            let connection = Connection::new(address.ip().to_canonical());
            connections.open.push(Arc::downgrade(&connection));
            connections.tasks.spawn(run(stream, router.clone(), connection, interrupt.clone()));
        }
    }
    drop(listener);
    while connections.tasks.join_next().await.is_some() {}
}

/// The open connections.
#[derive(Default)]
struct Connections {
    tasks: JoinSet<()>,
    /// In the order in which they were opened.
    open: Vec<Weak<Connection>>,
}

impl Connections {
    /// Closes a connection without a viewer if there are too many. Returns whether
    /// there is room now; viewers alone never take all of it.
    fn make_room(&mut self) -> bool {
        self.open.retain(|connection| connection.strong_count() > 0);
        if self.open.len() < MAX_CONNECTIONS {
            return true;
        }
        let idle = |connection: &Weak<Connection>| {
            connection.upgrade().filter(|open| !open.is_viewer()).map(|open| open.address)
        };
        let idle: Vec<_> = self.open.iter().map(idle).collect();
        let Some(place) = to_close(&idle) else { return false };
        if let Some(connection) = self.open.remove(place).upgrade() {
            connection.close();
        }
        true
    }
}

/// Returns the place of the connection that makes room: of the address with the most
/// connections that serve no viewer, the oldest. A client that sends its request at
/// once has its response by then, and one that does not is no loss. In a burst of
/// connections from one address no request is served at once, and another address must
/// not pay for that. `idle` has the address of each connection, or `None` for one that
/// serves a viewer, in the order in which they were opened.
fn to_close(idle: &[Option<IpAddr>]) -> Option<usize> {
    let of_same_address = |place: &usize| {
        let address = idle.get(*place);
        idle.iter().filter(|other| Some(*other) == address).count()
    };
    let places = (0..idle.len()).filter(|place| idle.get(*place).is_some_and(Option::is_some));
    // The last one of those with the greatest count, so reversed.
    places.rev().max_by_key(of_same_address)
}

async fn run(stream: TcpStream, router: Router, connection: Arc<Connection>, interrupt: Interrupt) {
    // A scan is worth a packet of its own at once. Without it, all else works.
    let _ = stream.set_nodelay(true);
    // Handlers may ask which connection a request came on.
    let service = TowerToHyperService::new(router.layer(Extension(Arc::clone(&connection))));
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEAD_TIMEOUT).max_buf_size(BUFFER_BYTES);
    let served = http.serve_connection(TokioIo::new(stream), service);
    tokio::pin!(served);
    let outcome = tokio::select! {
        outcome = &mut served => outcome,
        () = connection.closed.notified() => return,
        _ = interrupt.requested() => {
            // Streams of scans end by themselves.
            served.as_mut().graceful_shutdown();
            served.await
        }
    };
    if let Err(error) = outcome {
        tracing::debug!(%error, "a connection ended early");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(last: u8) -> Option<IpAddr> {
        Some(IpAddr::from([192, 168, 0, last]))
    }

    #[test]
    fn the_oldest_of_the_address_with_the_most_idle_connections_makes_room() {
        let [a, b] = [address(1), address(2)];
        assert_eq!(to_close(&[a, a, a]), Some(0));
        assert_eq!(to_close(&[b, a, b, a, a]), Some(1), "b is older, and has fewer");
        assert_eq!(to_close(&[None, None, None, b, a]), Some(3), "as many: the oldest");
        assert_eq!(to_close(&[None, None]), None, "viewers stay");
    }
}
