//! The task that owns the port. Handles send it requests and get an answer
//! each; streams read the rings that it fills.
//!
//! The way of a request: [`Client::ask`], `request` (the queue), `serve`,
//! `session` (one exchange; what the sensor is told is in `settings`), and back by
//! its promise. The way of a scan: `line` (bytes), `intake` (a reply), `session`
//! (is it the answer?), `serve`, `schedule`, which puts it into a ring. `fence` and
//! `unique_requests` see to it that no other reply is taken for it; `supervisor` and
//! `open` see to it that there is a session.

mod deadline;
mod fence;
mod intake;
mod line;
mod open;
mod rate_meter;
mod request;
mod schedule;
mod serve;
mod session;
mod settings;
mod supervisor;
mod unique_requests;

use std::fmt;
use std::future::Future;
use std::hash::{BuildHasher, RandomState};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::sync::{mpsc, oneshot};
use tokio::time::Instant;

pub(crate) use self::request::{Promise, Request};
use self::request::{QueuedRequest, RequestQueue};
use self::supervisor::Supervisor;
use crate::observer::ReplyObserver;
use crate::port::Connect;
use crate::protocol::Text;
use crate::state::Telemetry;
use crate::{BaudRate, Error};

/// How many requests wait in the queue before those who ask have to.
const QUEUE: usize = 16;

/// How a driver is to behave.
#[derive(Debug, Clone)]
pub(crate) struct Config {
    pub(crate) baud_rate: Option<BaudRate>,
    pub(crate) open_timeout: Duration,
    pub(crate) wait_for_sensor: bool,
    pub(crate) reconnect: bool,
    pub(crate) backoff: (Duration, Duration),
    pub(crate) jitter_seed: Option<u64>,
    pub(crate) serial_number: Option<Text>,
    pub(crate) ring_depth: usize,
    pub(crate) reply_latency: Option<Duration>,
    pub(crate) observer: ReplyObserver,
}

impl Config {
    /// What is random begins here.
    fn seed(&self) -> u64 {
        let random = || RandomState::new().hash_one(Instant::now().into_std());
        self.jitter_seed.unwrap_or_else(random)
    }
}

impl Default for Config {
    fn default() -> Self {
        Self {
            baud_rate: None,
            open_timeout: Duration::from_secs(5),
            wait_for_sensor: false,
            reconnect: true,
            backoff: (Duration::from_millis(100), Duration::from_secs(1)),
            jitter_seed: None,
            serial_number: None,
            ring_depth: 1,
            reply_latency: None,
            observer: ReplyObserver::default(),
        }
    }
}

/// The driver of one sensor: a future that has to be spawned or polled for its
/// [`Sensor`](crate::Sensor) handles and streams to get anything done.
///
/// It ends with `Ok` when the last handle and stream are gone or one was told
/// to [`close`](crate::Sensor::close), and with the cause when the link is lost
/// for good. Dropping it closes the port; handles and streams then end with
/// [`Error::Closed`].
///
/// It needs tokio's timer; without it, tokio panics when it is first polled.
#[must_use = "a driver does nothing unless it is spawned or polled"]
pub struct Driver {
    run: Pin<Box<dyn Future<Output = Result<(), Error>> + Send>>,
}

impl Future for Driver {
    type Output = Result<(), Error>;

    fn poll(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Self::Output> {
        self.run.as_mut().poll(cx)
    }
}

impl fmt::Debug for Driver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Driver").finish_non_exhaustive()
    }
}

/// The handles' end of the queue. The driver goes on while one is left.
#[derive(Debug, Clone)]
pub(crate) struct Client {
    sender: mpsc::Sender<QueuedRequest>,
    telemetry: Arc<Telemetry>,
    request_timeout: Duration,
}

impl Client {
    /// Sends a request and waits for its answer. If this future is dropped the
    /// request is skipped, or, when it is on the wire already, its answer is
    /// read and dropped.
    pub(crate) async fn ask<T>(
        &self,
        request: impl FnOnce(Promise<T>) -> Request,
    ) -> Result<T, Error> {
        let (promise, answer) = oneshot::channel();
        let expires = Instant::now() + self.request_timeout;
        let letter = QueuedRequest { request: request(promise), expires };
        if self.sender.send(letter).await.is_err() {
            return Err(self.telemetry.cause());
        }
        answer.await.unwrap_or_else(|_| Err(self.telemetry.cause()))
    }

    pub(crate) fn telemetry(&self) -> &Telemetry {
        &self.telemetry
    }
}

/// A driver, not running yet, and the first handle to it.
pub(crate) fn new<C: Connect>(connect: C, config: Config) -> (Client, Driver) {
    let (sender, receiver) = mpsc::channel(QUEUE);
    let telemetry = Arc::new(Telemetry::new());
    let request_timeout = config.open_timeout;
    let supervisor =
        Supervisor::new(connect, config, RequestQueue::new(receiver), Arc::clone(&telemetry));
    let client = Client { sender, telemetry, request_timeout };
    (client, Driver { run: Box::pin(supervisor.run()) })
}
