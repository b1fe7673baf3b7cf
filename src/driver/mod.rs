//! The task that owns the port. Handles send it requests and get one answer
//! each; streams read the rings that it fills.
//!
//! The way of a scan, up: `transport` (bytes, frames), `session` (the answer to
//! its command, or an error), `serve`, `schedule`, which pushes it into a ring.
//! The way of a request, down: [`Client::ask`], `request` (the queue), `serve`,
//! `session`, or `laser` and `baud_rate` on top of it; its answer returns through
//! the request's own oneshot channel. `fence` proves that no older reply can be taken for a new one;
//! `supervisor` and `open` keep a session open.

mod backoff;
mod baud_rate;
mod config;
mod exchange;
mod fence;
mod laser;
mod open;
mod poll_timer;
mod rate_meter;
mod request;
mod schedule;
mod serve;
mod session;
mod supervisor;
mod transport;

use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::sync::{mpsc, oneshot};
use tokio::time::Instant;
use tracing::Instrument;

pub(crate) use self::config::{Config, IdleProbe};
use self::request::{QueuedRequest, RequestQueue};
pub(crate) use self::request::{Request, Responder};
use self::supervisor::Supervisor;
use crate::Error;
use crate::port::AnyConnect;
use crate::state::Telemetry;

/// Requests that the queue holds before the callers have to wait.
const QUEUE_CAPACITY: usize = 16;

/// The driver of one sensor: a future that has to be spawned or polled for its
/// [`Sensor`](crate::Sensor) handles and streams to get anything done.
///
/// It returns `Ok` when the last handle and stream are gone or after
/// [`Sensor::close`](crate::Sensor::close), and the cause when the link is lost
/// for good. Dropping it closes the port; handles and streams then end with
/// [`Error::Closed`]. If it panics they end with [`Error::Panicked`].
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

/// The handles' end of the queue. The driver runs while one is left.
#[derive(Debug, Clone)]
pub(crate) struct Client {
    sender: mpsc::Sender<Box<QueuedRequest>>,
    telemetry: Arc<Telemetry>,
    request_timeout: Duration,
    ring_depth: usize,
}

impl Client {
    /// Sends a request and waits for its answer. If this future is dropped the
    /// request is skipped, or, when it is on the wire already, its answer is
    /// read and dropped.
    pub(crate) async fn ask<T>(
        &self,
        request: impl FnOnce(Responder<T>) -> Request,
    ) -> Result<T, Error> {
        let (responder, answer) = oneshot::channel();
        let expires = Instant::now() + self.request_timeout;
        let queued = Box::new(QueuedRequest { request: request(responder), expires });
        if self.sender.send(queued).await.is_err() {
            return Err(self.telemetry.cause());
        }
        self.wait_for(answer).await
    }

    /// Waits for the answer to a request that is in the queue, or for the driver's end: a
    /// request that another thread sends while the queue is dropped stays in it, unanswered,
    /// for as long as there is a handle.
    async fn wait_for<T>(
        &self,
        mut answer: oneshot::Receiver<Result<T, Error>>,
    ) -> Result<T, Error> {
        let outcome = tokio::select! {
            biased;
            outcome = &mut answer => outcome.ok(),
            () = self.sender.closed() => answer.try_recv().ok(),
        };
        outcome.unwrap_or_else(|| Err(self.telemetry.cause()))
    }

    /// Returns the depth of streams that set none.
    pub(crate) fn ring_depth(&self) -> usize {
        self.ring_depth
    }

    pub(crate) fn telemetry(&self) -> &Telemetry {
        &self.telemetry
    }
}

/// Returns a driver that does not run yet, and the first handle to it.
pub(crate) fn new(connect: Box<dyn AnyConnect>, config: Config) -> (Client, Driver) {
    let name = config.name.clone().or_else(|| connect.name().map(Arc::from));
    // Enabled wherever anything is: a warning without a name is of little use.
    let span = tracing::error_span!("sensor", name = name.as_deref().map(tracing::field::display));
    let (sender, receiver) = mpsc::channel(QUEUE_CAPACITY);
    let telemetry = Arc::new(Telemetry::new(name.clone()));
    let (request_timeout, ring_depth) = (config.open_timeout, config.ring_depth);
    let supervisor =
        Supervisor::new(connect, config, RequestQueue::new(receiver, name), Arc::clone(&telemetry));
    let client = Client { sender, telemetry, request_timeout, ring_depth };
    (client, Driver { run: Box::pin(supervisor.run().instrument(span)) })
}

#[cfg(test)]
mod tests {
    use tokio::sync::oneshot;
    use tokio::time::{Instant, timeout};

    use super::*;
    use crate::port::{Connect, Port};

    struct NoSensor;

    impl Connect for NoSensor {
        type Port = Box<dyn Port>;

        async fn connect(&mut self) -> Result<Self::Port, Error> {
            std::future::pending().await
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_request_that_is_sent_while_the_queue_is_dropped_ends() {
        let (client, driver) = new(Box::new(NoSensor), Config::default());
        let place = client.sender.clone().reserve_owned().await.unwrap();
        drop(driver);
        let (responder, answer) = oneshot::channel();
        let request = Request::Version(responder);
        place.send(Box::new(QueuedRequest { request, expires: Instant::now() }));

        let outcome = timeout(Duration::from_secs(60), client.wait_for(answer)).await;
        assert!(matches!(outcome, Ok(Err(Error::Closed))), "{outcome:?}");
    }
}
