//! Driver task, which owns the port. Handles send it requests and receive one answer for each;
//! streams read the rings that it fills.
//!
//! `src/guide/design.md` follows a scan and a request through these files. `supervisor` and `open`
//! keep a session open, and `serve` uses it. `session` is the line below
//! which a protocol confirms what the driver asks for.

mod backoff;
mod config;
mod failure;
mod fit;
mod laser;
mod motor_clock;
mod observers;
mod open;
mod rarely;
mod rate_meter;
mod ray_order;
mod request;
mod schedule;
mod sensor_clock;
mod serve;
mod session;
mod supervisor;
mod transport;

use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use tokio::sync::{mpsc, oneshot};
use tracing::Instrument;

pub(crate) use self::config::{Config, IdleProbe};
use self::observers::ReplyObservers;
pub use self::observers::{RawReply, ReplyObservation};
use self::request::RequestQueue;
pub(crate) use self::request::{Request, Responder};
use self::supervisor::Supervisor;
use crate::port::AnyConnect;
use crate::state::Shared;
use crate::{Error, ErrorKind};

/// Number of queued requests before callers have to wait.
const QUEUE_CAPACITY: usize = 16;

/// Driver of one sensor: a future to spawn or poll. Its [`Sensor`](crate::Sensor) handles and
/// streams make no progress until you do.
///
/// Returns `Ok` after [`Sensor::close`](crate::Sensor::close), or when you have dropped the last
/// handle and stream. Returns the cause if the link is lost permanently. Drop the driver to close
/// the port; handles and streams then end with [`ErrorKind::Closed`]. If the driver panics, they
/// end with [`ErrorKind::Panicked`].
///
/// # Panics
///
/// Needs tokio's timer: without one, tokio panics when you first poll the driver. Poll it in one
/// runtime only. Its timers and its port belong to the runtime that first used them, and tokio
/// panics once that runtime has ended.
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

/// Sending end of the request queue. The driver runs while a clone exists.
#[derive(Debug, Clone)]
pub(crate) struct Client {
    sender: mpsc::Sender<Box<Request>>,
    pub(crate) shared: Arc<Shared>,
    /// Observers of all replies.
    pub(crate) observers: Arc<ReplyObservers>,
    /// Default depth of streams.
    pub(crate) depth: usize,
}

impl Client {
    /// Sends a request and waits for its answer. Dropping this future skips the request; if the
    /// command is on the wire already, its answer is read and dropped.
    pub(crate) async fn ask<T>(
        &self,
        request: impl FnOnce(Responder<T>) -> Request,
    ) -> Result<T, Error> {
        let (responder, answer) = oneshot::channel();
        if self.sender.send(Box::new(request(responder))).await.is_err() {
            return Err(self.shared.link.closed().await);
        }
        self.wait_for(answer).await
    }

    /// Waits for the answer to a queued request, or for the end of the driver. Waiting for the
    /// answer alone could hang: a request that another thread sends while the queue is dropped
    /// stays in the channel, unanswered, while a handle exists.
    async fn wait_for<T>(
        &self,
        mut answer: oneshot::Receiver<Result<T, ErrorKind>>,
    ) -> Result<T, Error> {
        let outcome = tokio::select! {
            biased;
            outcome = &mut answer => outcome.ok(),
            () = self.sender.closed() => answer.try_recv().ok(),
        };
        match outcome {
            Some(outcome) => outcome.map_err(|kind| self.shared.link.error(kind)),
            // The driver drops a request in progress before it stores the cause.
            None => Err(self.shared.link.closed().await),
        }
    }

    /// Tells the driver that a stream was dropped. If the queue is full, one of its requests does.
    pub(crate) fn report_dropped_stream(&self) {
        let _ = self.sender.try_send(Box::new(Request::StreamDropped));
    }
}

/// Creates a driver that is not running yet, and the first handle to it.
pub(crate) fn new(connect: Box<dyn AnyConnect>, mut config: Config) -> (Client, Driver) {
    let name = config.name.clone().or_else(|| connect.name().map(Arc::from));
    // At error level, so that every enabled message has it: a warning without a name is of little use.
    let span =
        tracing::error_span!("sensor", sensor = name.as_deref().map(tracing::field::display));
    let (sender, receiver) = mpsc::channel(QUEUE_CAPACITY);
    let shared = Arc::new(Shared::new(name));
    let depth = config.depth;
    let queue = RequestQueue::new(receiver, config.request_timeout);
    // A copy: a clone of the builder may create another driver, which must not share it.
    let observers = Arc::new(ReplyObservers::clone(&config.observers));
    config.observers = Arc::clone(&observers);
    // In its own block: a future keeps an argument twice, as it was passed and as it is used.
    let supervisor = Box::new(Supervisor::new(connect, config, queue, Arc::clone(&shared)));
    let client = Client { sender, shared, observers, depth };
    (client, Driver { run: Box::pin(supervisor.run().instrument(span)) })
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tokio::sync::oneshot;
    use tokio::time::timeout;

    use super::*;
    use crate::port::Port;

    #[tokio::test(start_paused = true)]
    async fn a_request_that_is_sent_while_the_queue_is_dropped_ends() {
        let no_sensor = std::future::pending::<Result<Box<dyn Port>, Error>>;
        let (client, driver) = new(Box::new(no_sensor), Config::default());
        let place = client.sender.clone().reserve_owned().await.unwrap();
        drop(driver);
        let (responder, answer) = oneshot::channel();
        place.send(Box::new(Request::Link(responder)));

        let outcome = timeout(Duration::from_secs(60), client.wait_for(answer)).await;
        assert!(matches!(outcome.unwrap().unwrap_err().kind(), ErrorKind::Closed));
    }
}
