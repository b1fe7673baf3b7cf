//! Connections: how many there may be, how long they may take, and which one is
//! closed to make room for a new one.

use std::fmt::Debug;
use std::io::{self, Cursor};
use std::net::IpAddr;
use std::sync::{Arc, Mutex, OnceLock, PoisonError, Weak};
use std::time::Duration;

use axum::Router;
use axum::extract::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::TokioIo;
use hyper_util::service::TowerToHyperService;
use tokio::io::AsyncReadExt;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore};
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};

use super::head;
use crate::interrupt::Interrupt;

/// So many connections may be open at a time. A new one takes the place of one that
/// serves no stream of scans.
const MAX_CONNECTIONS: usize = 128;
/// So many requests are handled at a time. Each takes HTTP's buffers of 16 KiB, and the
/// others wait without them.
const MAX_REQUESTS: usize = 8;
/// The longest time for a response that is no stream of scans. It fits into the system's
/// buffer, so that it needs no client that reads.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(10);
/// The longest time for the head of a request, and its turn.
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
    closed: Notify,
    /// Held while its request is handled.
    turn: Mutex<Option<OwnedSemaphorePermit>>,
    /// Set once it serves a stream of scans: the viewer's seat, which is free again when
    /// the connection is dropped.
    seat: OnceLock<Box<dyn Debug + Send + Sync>>,
}

impl Connection {
    fn new(address: IpAddr) -> Arc<Self> {
        let (turn, seat) = (Mutex::default(), OnceLock::new());
        Arc::new(Self { address, closed: Notify::new(), turn, seat })
    }

    fn turn(&self, turn: Option<OwnedSemaphorePermit>) {
        // Nothing panics while it is held.
        *self.turn.lock().unwrap_or_else(PoisonError::into_inner) = turn;
    }

    /// Marks the connection as one that serves a stream of scans until it ends, and lets
    /// the next request have its turn: viewers are limited by their seats.
    pub(super) fn become_viewer(&self, seat: impl Debug + Send + Sync + 'static) {
        // It has none: it serves one request.
        let _ = self.seat.set(Box::new(seat));
        self.turn(None);
    }

    fn is_viewer(&self) -> bool {
        self.seat.get().is_some()
    }

    /// Waits until a response has taken too long. A stream of scans never does.
    async fn overdue(&self) {
        sleep(RESPONSE_TIMEOUT).await;
        if self.is_viewer() {
            std::future::pending().await
        }
    }

    /// Closes the connection, whatever it is doing.
    pub(super) fn close(&self) {
        self.closed.notify_one();
    }
}

/// Serves until the user stops the program, and then until all connections have
/// ended.
pub(super) async fn serve(listener: TcpListener, router: Router, interrupt: &Interrupt) {
    let mut connections = Connections {
        tasks: JoinSet::new(),
        turns: Arc::new(Semaphore::new(MAX_REQUESTS)),
        open: Vec::new(),
    };
    loop {
        let stream = tokio::select! {
            _ = interrupt.requested() => break,
            Some(_) = connections.tasks.join_next() => continue,
            accepted = listener.accept() => match accepted {
                Ok((stream, _)) => stream,
                Err(error) => {
                    tracing::warn!(%error, "cannot accept a connection");
                    sleep(ACCEPT_BACKOFF).await;
                    continue;
                }
            },
        };
        let Ok(address) = stream.peer_addr() else { continue };
        if connections.make_room() {
            let connection = Connection::new(address.ip().to_canonical());
            connections.open.push(Arc::downgrade(&connection));
            let turns = Arc::clone(&connections.turns);
            let (router, interrupt) = (router.clone(), interrupt.clone());
            connections.tasks.spawn(run(stream, router, turns, connection, interrupt));
        }
    }
    drop(listener);
    while connections.tasks.join_next().await.is_some() {}
}

/// The open connections.
struct Connections {
    tasks: JoinSet<()>,
    turns: Arc<Semaphore>,
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

async fn run(
    stream: TcpStream,
    router: Router,
    turns: Arc<Semaphore>,
    connection: Arc<Connection>,
    interrupt: Interrupt,
) {
    let ready = async {
        let ready = prepare(stream, turns, &connection);
        timeout(HEAD_TIMEOUT, ready).await.ok()?.ok()?
    };
    let ready = tokio::select! {
        ready = ready => ready,
        () = connection.closed.notified() => return,
        _ = interrupt.requested() => return,
    };
    let Some((head, stream)) = ready else { return };
    tokio::select! {
        () = respond(head, stream, router, Arc::clone(&connection), &interrupt) => {}
        () = connection.closed.notified() => {}
        () = connection.overdue() => {}
    }
}

/// Waits until a request has arrived, and it is its turn.
async fn prepare(
    mut stream: TcpStream,
    turns: Arc<Semaphore>,
    connection: &Connection,
) -> io::Result<Option<(Vec<u8>, TcpStream)>> {
    let Some(head) = head::read(&mut stream, BUFFER_BYTES).await? else { return Ok(None) };
    // Nobody closes the semaphore.
    connection.turn(turns.acquire_owned().await.ok());
    Ok(Some((head, stream)))
}

/// Responds to one request, and closes the connection: between two requests it would hold
/// HTTP's buffers.
async fn respond(
    head: Vec<u8>,
    stream: TcpStream,
    router: Router,
    connection: Arc<Connection>,
    interrupt: &Interrupt,
) {
    // A scan is worth a packet of its own at once. Without it, all else works.
    let _ = stream.set_nodelay(true);
    let (reader, writer) = stream.into_split();
    let stream = tokio::io::join(Cursor::new(head).chain(reader), writer);
    let router = TowerToHyperService::new(router);
    let service = service_fn(move |mut request: Request<Incoming>| {
        // Handlers may ask which connection a request came on.
        request.extensions_mut().insert(Arc::clone(&connection));
        router.call(request)
    });
    let mut http = http1::Builder::new();
    http.max_buf_size(BUFFER_BYTES).keep_alive(false);
    // Boxed: the task of a client that has not sent a request stays small.
    let mut served = Box::pin(http.serve_connection(TokioIo::new(stream), service));
    let outcome = tokio::select! {
        outcome = &mut served => outcome,
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
